"""Train the flow prior of `gof reconstruct` on the benchmark's dev fires, of two solvers.

    python -m gof_benchmark.fires WORK --split dev
    python -m gof_benchmark.training.flow_prior WORK [--out gof/reconstruct/flow_prior.npz]

Runs the motion and fusion stages on every dataset in WORK/dev, prints what the prior does for a flame it has not seen
(each fire left out in turn, and the datasets given with --test), and writes the weights. Scores as in
`gof_benchmark.field_score`; `within` is the share of the light whose velocity is within one standard deviation
of the truth, component by component (0.68 where errors are normal and the doubt is right).
"""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro

from gof.dataset import Dataset
from gof.files import atomic_path
from gof.progress import progress_bar
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import FEATURES, VECTORS, WEIGHTS, FlameDescriber, FlowPrior, Network, evaluate_network
from gof.reconstruct.observation import observe
from gof.reconstruct.presets import METHODS
from gof.reconstruct.shrink import shrink
from gof_benchmark.field_score import score

LONGEST_SIDE, VOXELS = 320, 72  # as `gof reconstruct --preset preview`


@dataclass
class TrainConfig:
    """Train the flow prior; see the module's text."""

    work: tyro.conf.Positional[Path]
    """Folder of the benchmark's fires; those in its folder dev are trained on."""
    out: Path = WEIGHTS
    """Where the weights go."""
    test: tuple[Path, ...] = ()
    """Datasets that are only scored, never trained on."""


@dataclass(frozen=True)
class Samples:
    """Lit voxels of one or many flames, (N, ...) float32.

    Attributes:
        features, vectors: of `FlameDescriber.describe`.     truth: m/s.
        weight: how much the voxel counts; every flame has the same sum.
        scale: 1 / its flame's mean square speed, s2/m2.     core: its flame's mean core speed, m/s.
    """

    features: torch.Tensor
    vectors: torch.Tensor
    truth: torch.Tensor
    weight: torch.Tensor
    scale: torch.Tensor
    core: torch.Tensor

    @classmethod
    def of(cls, field: FlowField, dataset: Dataset, rng: np.random.Generator, most: int = 40_000) -> Samples:
        """At most so many voxels of a flame.

        A voxel counts by its emission and by the root of it, half and half: the scores look at the former, the seeds
        sit at the latter.
        """
        describer = FlameDescriber.of(field)
        assert describer is not None, f"{dataset.path}: nothing moves"
        e = field.emission
        weight = e / e.sum() + np.sqrt(e) / np.sqrt(e).sum()
        weight /= weight.sum()
        share = min(1.0, most / np.count_nonzero(e))
        parts, energy = [], 0.0
        for f, frame in enumerate(field.frames):
            truth = dataset.velocity.at(frame.time_s).sample(field.voxels.center)
            energy += float((weight[f][:, None] * truth**2).sum())
            chosen = np.flatnonzero((frame.emission > 0) & (rng.random(len(frame.emission)) < share))
            features, vectors = describer.describe(f)
            parts.append((features[chosen], vectors[chosen], truth[chosen], weight[f][chosen] / share))
        features, vectors, truth, weight = (np.concatenate(p) for p in zip(*parts, strict=True))
        n = len(features)
        arrays = (features, vectors, truth, weight * n, np.full(n, 1 / energy), np.full(n, describer.core_mean))
        return cls(*(torch.tensor(array, dtype=torch.float32) for array in arrays))

    @classmethod
    def joined(cls, flames: list[Samples]) -> Samples:
        """Every flame counts alike, whatever it has of voxels."""
        mean = sum(len(flame) for flame in flames) / len(flames)
        parts = [replace(flame, weight=flame.weight * mean / len(flame)) for flame in flames]
        names = cls.__dataclass_fields__
        return cls(*(torch.cat([getattr(part, name) for part in parts]) for name in names))

    def __len__(self) -> int:
        return len(self.features)


@dataclass(frozen=True)
class Flame:
    """One dataset as the prior sees it.

    Attributes:
        burns: which fire it shows; two datasets may show the same grids of another solver.
    """

    burns: str
    dataset: Dataset
    field: FlowField
    samples: Samples

    @classmethod
    def of(cls, path: Path) -> Flame:
        dataset = shrink(Dataset.open(path), LONGEST_SIDE)
        field = seen_flow_field(observe(dataset), METHODS["gof"], VOXELS)
        fire = json.loads((path / "spec.json").read_text(encoding="utf-8"))["fire"]
        burns = Path(fire["grids"]).parent.name if "grids" in fire else path.name
        return cls(burns, dataset, field, Samples.of(field, dataset, np.random.default_rng(0)))

    def score(self, field: FlowField) -> str:
        """L2, CosSim and speed ratio of a flow field of this dataset, mean over frames."""
        found = score(field, self.dataset)
        return f"{found.l2:.3f}  {found.cos_sim:.3f}  {found.speed_ratio:.3f}"

    def within(self, field: FlowField) -> float:
        """Share of the light whose velocity is within one standard deviation of the truth, mean of the components."""
        inside = total = 0.0
        for frame in field.frames:
            truth = self.dataset.velocity.at(frame.time_s).sample(field.voxels.center)
            near = np.abs(frame.velocity - truth) <= frame.velocity_sd[:, None]
            inside += (frame.emission[:, None] * near).sum() / 3
            total += frame.emission.sum()
        return inside / total


Layers = list[tuple[torch.Tensor, torch.Tensor]]
"""Weights (members, in, out) and biases (members, 1, out) of an ensemble of small networks."""


@dataclass(frozen=True)
class Scaling:
    """Mean and deviation (K,) of the training features."""

    mean: torch.Tensor
    deviation: torch.Tensor

    @classmethod
    def of(cls, samples: Samples) -> Scaling:
        return cls(samples.features.mean(0), samples.features.std(0) + 1e-3)

    def __call__(self, features: torch.Tensor) -> torch.Tensor:
        return (features - self.mean) / self.deviation


def train_velocity(flames: list[Samples], seed: int = 0, members: int = 4, steps: int = 700) -> tuple[Scaling, Network]:
    """The ensemble that gives the velocity, by AdamW with noise on the features."""
    torch.manual_seed(seed)
    samples = Samples.joined(flames)
    scaling = Scaling.of(samples)
    layers = new_layers([len(FEATURES), 20, 20, VECTORS], members)

    def loss(batch: torch.Tensor) -> torch.Tensor:
        coefficients = forward(layers, scaling(samples.features[batch]))
        velocity = torch.einsum("mbk,mbki->mbi", coefficients, samples.vectors[batch])
        return velocity_loss(velocity, samples.truth[batch], samples.scale[batch], samples.weight[batch])

    descend(layers, loss, len(samples), steps)
    return scaling, plain(layers)


def velocity_loss(
    velocity: torch.Tensor, truth: torch.Tensor, scale: torch.Tensor, weight: torch.Tensor
) -> torch.Tensor:
    """Squared error of the velocity plus that of its direction, both 1 for a velocity of zero."""
    small = 0.02 / scale.sqrt()  # below a fiftieth of the RMS speed a direction means little
    direction = (velocity * truth).sum(-1) / ((velocity.norm(dim=-1) + small) * (truth.norm(dim=-1) + small))
    squared = scale * ((velocity - truth) ** 2).sum(-1)
    return (weight * (squared + 1 - direction)).mean()


def train_doubt(
    scaling: Scaling, flames: list[Samples], errors: list[torch.Tensor], seed: int = 0, steps: int = 500
) -> Network:
    """One network for the log of the standard deviation, over the core's speed, by maximum likelihood.

    Args:
        errors: per flame (N, 3) m/s, of ensembles that had not been trained on it: an ensemble is surer of what it
            knows than it may be of a new flame.
    """
    torch.manual_seed(seed)
    samples = Samples.joined(flames)
    variance = (torch.cat(errors) ** 2).mean(-1) / samples.core**2
    layers = new_layers([len(FEATURES), 12, 1], 1)

    def loss(batch: torch.Tensor) -> torch.Tensor:
        log_sd = forward(layers, scaling(samples.features[batch]))[..., 0].clamp(-6, 6)
        return (samples.weight[batch] * (log_sd + 0.5 * variance[batch] * torch.exp(-2 * log_sd))).mean()

    descend(layers, loss, len(samples), steps)
    return plain(layers)


def forward(layers: Layers, features: torch.Tensor, noise: float = 0.1) -> torch.Tensor:
    """(members, B, out) from features (members, B, K), which are shaken so that no flame is learned by heart."""
    h = features + noise * torch.randn(features.shape)
    for weight, bias in layers[:-1]:
        h = torch.tanh(h @ weight + bias)
    return h @ layers[-1][0] + layers[-1][1]


def new_layers(sizes: list[int], members: int) -> Layers:
    """Random weights; the last layer's are small, so that training starts near zero."""
    layers = []
    for i, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
        spread = 0.1 if i == len(sizes) - 2 else 1.0
        layers.append((spread * torch.randn(members, fan_in, fan_out) / fan_in**0.5, torch.zeros(members, 1, fan_out)))
    return layers


def descend(layers: Layers, loss, count: int, steps: int, batch: int = 2048) -> None:
    """Minimise loss(batch), batch (members, B) numbers of samples, each member its own."""
    parameters = [p.requires_grad_() for layer in layers for p in layer]
    optimiser = torch.optim.AdamW(parameters, lr=5e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        optimiser.zero_grad()
        loss(torch.randint(0, count, (len(layers[0][0]), batch))).backward()
        optimiser.step()
        schedule.step()


def plain(layers: Layers) -> Network:
    return [(weight.detach().numpy(), bias.detach().numpy()) for weight, bias in layers]


def held_out_error(scaling: Scaling, network: Network, samples: Samples) -> torch.Tensor:
    """(N, 3) m/s of an ensemble on a flame that it was not trained on."""
    coefficients = evaluate_network(network, scaling(samples.features).numpy()).mean(0)
    velocity = np.einsum("nk,nki->ni", coefficients, samples.vectors.numpy())
    return torch.tensor(velocity) - samples.truth


def prior_of(scaling: Scaling, velocity: Network, doubt: Network) -> FlowPrior:
    return FlowPrior(scaling.mean.numpy(), scaling.deviation.numpy(), velocity, doubt)


def main(argv: list[str] | None = None) -> None:
    """Read, train with each flame left out, score, train on all, save."""
    config = tyro.cli(TrainConfig, prog="python -m gof_benchmark.training.flow_prior", args=argv)
    torch.set_num_threads(1)  # the networks are too small to share
    paths = sorted(path.parent for path in (config.work / "dev").glob("*/dataset.json"))
    flames = []
    with progress_bar("motion") as progress:
        for path in paths:
            flames.append(Flame.of(path))
            progress(len(flames), len(paths))
    samples = [flame.samples for flame in flames]
    others = [[j for j, other in enumerate(flames) if other.burns != flame.burns] for flame in flames]
    without = [train_velocity([samples[j] for j in known]) for known in others]
    errors = [held_out_error(*ensemble, flame) for ensemble, flame in zip(without, samples, strict=True)]

    print(f"{'flame not trained on':<32} {'seen: L2 CosSim speed':<24} {'with the prior':<22} within")

    def show(name: str, flame: Flame, prior: FlowPrior) -> None:
        found = prior.correct(flame.field)
        print(
            f"{name:<32} {flame.score(flame.field):<24} {flame.score(found):<22} {flame.within(found):.2f}", flush=True
        )

    for i, flame in enumerate(flames):
        scaling, velocity = without[i]
        doubt = train_doubt(scaling, [samples[j] for j in others[i]], [errors[j] for j in others[i]])
        show(flame.dataset.path.name, flame, prior_of(scaling, velocity, doubt))
    scaling, velocity = train_velocity(samples)
    prior = prior_of(scaling, velocity, train_doubt(scaling, samples, errors))
    for path in config.test:
        show(str(path), Flame.of(path), prior)
    with atomic_path(config.out) as temporary:
        prior.save(temporary)
    print(f"weights -> {config.out}")


if __name__ == "__main__":
    main()
