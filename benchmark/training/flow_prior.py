"""Train the flow prior of `gof reconstruct` on simulated flames that are no scene of the benchmark.

    python -m gof_benchmark.training.flow_prior WORK [--out gof/reconstruct/flow_prior.npz]

Generates every spec in benchmark/flow_prior_scenes into WORK (resumable; about two minutes each on two cores), runs the
motion and fusion stages on each, prints what the prior does for a flame it has not seen (each flame left out in turn,
and the datasets given with --test), and writes the weights. Scores as in `gof_benchmark.evidence.flow_fusion`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

from gof.dataset import Dataset
from gof.evaluate import dve
from gof.files import atomic_path
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import WEIGHTS, FlowPrior, describe
from gof.reconstruct.observation import observe
from gof.reconstruct.presets import METHODS
from gof_benchmark.commands import generate
from gof_benchmark.evidence.flow_fusion import on_voxels

SPECS = Path(__file__).with_name("flow_prior_scenes")


@dataclass
class TrainConfig:
    """Train the flow prior; see the module's text."""

    work: tyro.conf.Positional[Path]
    """Folder for the training datasets, a few MB each."""
    out: Path = WEIGHTS
    """Where the weights go."""
    test: tuple[Path, ...] = ()
    """Datasets that are only scored, never trained on."""
    leave_one_out: bool = True
    """Score every training flame with a prior trained on the others."""


@dataclass(frozen=True)
class Flame:
    """One dataset as the prior sees it: the seen flow field, and the true velocity (F, V, 3) m/s on its voxels."""

    dataset: Dataset
    field: FlowField
    truth: np.ndarray

    @classmethod
    def of(cls, path: Path) -> Flame:
        dataset = Dataset.open(path)
        field = seen_flow_field(observe(dataset), METHODS["gof"], 72)
        truth = [dataset.velocity.at(frame.time_s).sample(field.voxels.center) for frame in field.frames]
        return cls(dataset, field, np.stack(truth))

    def score(self, field: FlowField) -> str:
        """L2, CosSim and speed ratio of a flow field of this dataset, mean over frames."""
        results = []
        for frame in field.frames:
            cloud = on_voxels(field.voxels, frame.velocity, frame.emission, frame.time_s)
            results.append(dve(cloud, self.dataset.velocity.at(frame.time_s), frame.time_s, order=1))
        return "  ".join(f"{x:.3f}" for x in np.mean([(r.l2, r.cos_sim, r.speed_ratio) for r in results], 0))


def train(
    flames: list[Flame], members: int = 4, hidden: int = 16, steps: int = 1000, cosine: float = 1.0, seed: int = 0
) -> FlowPrior:
    """Squared error of the velocity plus `cosine` times that of its direction, by AdamW with noise on the features.

    Every flame has the same weight; both errors are 1 for a velocity of zero.

    A voxel counts by its emission and by the root of it, half and half: the scores look at the former, the seeds sit at
    the latter.
    """
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    parts: list[tuple[np.ndarray, ...]] = []
    for flame in flames:
        features, vectors = describe(flame.field)
        e = flame.field.emission
        weight = e / e.sum() + np.sqrt(e) / np.sqrt(e).sum()
        weight /= weight.sum()
        energy = (weight[..., None] * flame.truth**2).sum()
        lit = np.flatnonzero(e)
        chosen = rng.choice(lit, min(60_000, len(lit)), replace=False)
        parts.append(
            (
                features.reshape(-1, features.shape[-1])[chosen],
                vectors.reshape(-1, *vectors.shape[2:])[chosen],
                flame.truth.reshape(-1, 3)[chosen],
                weight.ravel()[chosen] * len(lit) / len(flames),
                np.full(len(chosen), 1 / energy),
            )
        )
    x, vectors, truth, weight, scale = (
        torch.tensor(np.concatenate(p), dtype=torch.float32) for p in zip(*parts, strict=True)
    )
    mean, deviation = x.mean(0), x.std(0) + 1e-3
    x = (x - mean) / deviation
    sizes = [x.shape[1], hidden, hidden, vectors.shape[1]]
    layers = []
    for fan_in, fan_out in itertools.pairwise(sizes):
        spread = 0.1 if fan_out == sizes[-1] else 1.0
        layers.append((spread * torch.randn(members, fan_in, fan_out) / fan_in**0.5, torch.zeros(members, 1, fan_out)))
    parameters = [p.requires_grad_() for layer in layers for p in layer]
    optimiser = torch.optim.AdamW(parameters, lr=5e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        batch = torch.randint(0, len(x), (members, 4096))
        h = x[batch] + 0.1 * torch.randn(members, 4096, x.shape[1])
        for w, b in layers[:-1]:
            h = torch.tanh(h @ w + b)
        coefficients = h @ layers[-1][0] + layers[-1][1]
        velocity = torch.einsum("mbk,mbki->mbi", coefficients, vectors[batch])
        t = truth[batch]
        size = 0.02 / scale[batch].sqrt()  # below a fiftieth of the RMS speed a direction means little
        direction = (velocity * t).sum(-1) / ((velocity.norm(dim=-1) + size) * (t.norm(dim=-1) + size))
        error = weight[batch] * (scale[batch] * ((velocity - t) ** 2).sum(-1) + cosine * (1 - direction))
        optimiser.zero_grad()
        error.mean().backward()
        optimiser.step()
        schedule.step()
    arrays = [(w.detach().numpy(), b.detach().numpy()) for w, b in layers]
    return FlowPrior(mean.numpy(), deviation.numpy(), arrays)


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(TrainConfig, prog="python -m gof_benchmark.training.flow_prior", args=argv)
    flames = {}
    for spec in sorted(SPECS.glob("*.json")):
        if not (config.work / spec.stem / "dataset.json").exists():
            generate.main([str(spec), "--out", str(config.work / spec.stem)])
        flames[spec.stem] = Flame.of(config.work / spec.stem)
    print(f"{'flame not trained on':<28} {'seen: L2 CosSim speed':<24} {'with the prior':<22}")

    def show(name: str, flame: Flame, prior: FlowPrior) -> None:
        corrected = prior.correct(flame.field)
        print(f"{name:<28} {flame.score(flame.field):<24} {flame.score(corrected):<22}", flush=True)

    if config.leave_one_out:
        for name, flame in flames.items():
            show(name, flame, train([f for other, f in flames.items() if other != name]))
    prior = train(list(flames.values()))
    for path in config.test:
        show(str(path), Flame.of(path), prior)
    with atomic_path(config.out) as temporary:
        prior.save(temporary)
    print(f"weights -> {config.out}")


if __name__ == "__main__":
    main()
