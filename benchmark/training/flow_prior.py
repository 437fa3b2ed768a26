"""Train the flow prior of `gof reconstruct` on simulated flames that are no scene of the benchmark.

    python -m gof_benchmark.training.flow_prior WORK [--out gof/reconstruct/flow_prior.npz]

Generates every spec in benchmark/training/flow_prior_scenes into WORK (resumable; about two minutes each on two cores),
runs the motion and fusion stages on each, prints what the prior does for a flame it has not seen (each flame left out
in turn, and the datasets given with --test), and writes the weights. Scores as in
`gof_benchmark.evidence.flow_fusion`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro

from gof.dataset import Dataset
from gof.files import atomic_path
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import WEIGHTS, FlowPrior, describe
from gof.reconstruct.observation import observe
from gof.reconstruct.presets import METHODS
from gof_benchmark.commands import generate
from gof_benchmark.evidence.flow_fusion import score

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
        found = score(field, self.dataset)
        return f"{found.l2:.3f}  {found.cos_sim:.3f}  {found.speed_ratio:.3f}"


@dataclass(frozen=True)
class Samples:
    """Lit voxels of many flames, (N, ...) float32.

    Attributes:
        features, vectors: of `describe`.     truth: m/s.
        weight: how much the voxel counts; every flame has the same sum.     scale: 1 / its flame's mean square speed.
    """

    features: torch.Tensor
    vectors: torch.Tensor
    truth: torch.Tensor
    weight: torch.Tensor
    scale: torch.Tensor

    @classmethod
    def of(cls, flames: list[Flame], rng: np.random.Generator, most: int = 60_000) -> Samples:
        """At most so many voxels of each flame.

        A voxel counts by its emission and by the root of it, half and half: the scores look at the former, the seeds
        sit at the latter.
        """
        parts: list[tuple[np.ndarray, ...]] = []
        for flame in flames:
            features, vectors = describe(flame.field)
            e = flame.field.emission
            weight = e / e.sum() + np.sqrt(e) / np.sqrt(e).sum()
            weight /= weight.sum()
            energy = (weight[..., None] * flame.truth**2).sum()
            lit = np.flatnonzero(e)
            chosen = rng.choice(lit, min(most, len(lit)), replace=False)
            part = (
                features.reshape(-1, features.shape[-1])[chosen],
                vectors.reshape(-1, *vectors.shape[2:])[chosen],
                flame.truth.reshape(-1, 3)[chosen],
                weight.ravel()[chosen] * len(lit) / len(flames),
                np.full(len(chosen), 1 / energy),
            )
            parts.append(part)
        return cls(*(torch.tensor(np.concatenate(p), dtype=torch.float32) for p in zip(*parts, strict=True)))


Layers = list[tuple[torch.Tensor, torch.Tensor]]
"""Weights (members, in, out) and biases (members, 1, out) of an ensemble of small networks."""


def train(
    flames: list[Flame], members: int = 4, hidden: int = 16, steps: int = 1000, cosine: float = 1.0, seed: int = 0
) -> FlowPrior:
    """By AdamW with noise on the features; `cosine` is the weight of the direction's error (see `loss`)."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    samples = Samples.of(flames, rng)
    mean, deviation = samples.features.mean(0), samples.features.std(0) + 1e-3
    samples = replace(samples, features=(samples.features - mean) / deviation)
    layers = new_layers([samples.features.shape[1], hidden, hidden, samples.vectors.shape[1]], members)
    parameters = [p.requires_grad_() for layer in layers for p in layer]
    optimiser = torch.optim.AdamW(parameters, lr=5e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        batch = torch.randint(0, len(samples.features), (members, 4096))
        optimiser.zero_grad()
        loss(layers, samples, batch, cosine).backward()
        optimiser.step()
        schedule.step()
    arrays = [(w.detach().numpy(), b.detach().numpy()) for w, b in layers]
    return FlowPrior(mean.numpy(), deviation.numpy(), arrays)


def new_layers(sizes: list[int], members: int) -> Layers:
    """Random weights; the last layer's are small, so that the prior starts near zero."""
    layers = []
    for fan_in, fan_out in itertools.pairwise(sizes):
        spread = 0.1 if fan_out == sizes[-1] else 1.0
        layers.append((spread * torch.randn(members, fan_in, fan_out) / fan_in**0.5, torch.zeros(members, 1, fan_out)))
    return layers


def loss(layers: Layers, samples: Samples, batch: torch.Tensor, cosine: float) -> torch.Tensor:
    """Squared error of the velocity plus `cosine` times that of its direction, both 1 for a velocity of zero.

    Every flame has the same weight.

    Args:
        batch: (members, B) numbers of the samples that each network sees.
    """
    features = samples.features[batch]
    h = features + 0.1 * torch.randn(features.shape)
    for w, b in layers[:-1]:
        h = torch.tanh(h @ w + b)
    coefficients = h @ layers[-1][0] + layers[-1][1]
    velocity = torch.einsum("mbk,mbki->mbi", coefficients, samples.vectors[batch])
    truth, scale = samples.truth[batch], samples.scale[batch]
    small = 0.02 / scale.sqrt()  # below a fiftieth of the RMS speed a direction means little
    direction = (velocity * truth).sum(-1) / ((velocity.norm(dim=-1) + small) * (truth.norm(dim=-1) + small))
    squared = scale * ((velocity - truth) ** 2).sum(-1)
    return (samples.weight[batch] * (squared + cosine * (1 - direction))).mean()


def main(argv: list[str] | None = None) -> None:
    """Generate, score, train, save."""
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
