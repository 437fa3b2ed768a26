"""Train the flow prior of `gof reconstruct` on the benchmark's dev fires, of two solvers.

    python -m gof_benchmark.fires WORK --split dev
    python -m gof_benchmark.training.flow_prior WORK [--out gof/reconstruct/flow_prior.npz]

Runs the motion and fusion stages on every dataset in WORK/dev, prints what the prior does for a flame it has not seen
(each fire left out in turn, and the datasets given with --test), and writes the weights. Scores and trivial baselines
as in
`field_score`, means over frames of DVE's figures (speed is its least-squares gain); `pace` is the estimated mean speed
over the true one; `within` is the share of the light whose velocity is within one standard deviation of the truth,
component by component (0.68 where errors are normal and the uncertainty is right). `--without SOLVER` shows what is
left when a solver's fires are not trained on.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro

from gof.core.errors import GofError
from gof.core.files import atomic_path, read_json
from gof.dataset import Dataset
from gof.host.terminal import progress_bar
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FEATURES, VECTORS, WEIGHTS, FlameDescriber, FlowPrior, Network, evaluate_network
from gof.reconstruct.mean_speed import MeanSpeed, SpeedClues, stands
from gof.reconstruct.observation import observe
from gof.reconstruct.several_flames import alone, several_flames
from gof_benchmark.training.field_score import (
    best_constant,
    buoyant_law,
    fluctuation_cos_sim,
    mean_per_height,
    mean_speed,
    open_small,
    preview_field,
    score,
    within,
)


@dataclass
class TrainConfig:
    """Train the flow prior; see the module's text."""

    work: tyro.conf.Positional[Path]
    """Folder of the benchmark's fires; those in its folder dev are trained on."""
    out: Path = WEIGHTS
    """Where the weights go."""
    test: tuple[Path, ...] = ()
    """Datasets that are only scored, never trained on."""
    without: Literal["nothing", "openfoam", "mantaflow"] = "nothing"
    """A solver whose fires are only scored, never trained on."""


@dataclass(frozen=True)
class LitVoxels:
    """Lit voxels of one or many flames, (N, ...) float32.

    Attributes:
        features, vectors: of `FlameDescriber.describe`.
        truth: true velocity over its flame's true pace.
        weight: how much the voxel counts; every flame has the same sum.
        scale: 1 / its flame's mean square of `truth`.
    """

    features: torch.Tensor
    vectors: torch.Tensor
    truth: torch.Tensor
    weight: torch.Tensor
    scale: torch.Tensor

    @classmethod
    def of(
        cls, describer: FlameDescriber, truth: np.ndarray, rng: np.random.Generator, most: int = 30_000
    ) -> LitVoxels:
        """Return at most so many voxels of a flame.

        Args:
            truth: (F, V, 3) true velocity over its pace.

        A voxel counts by its emission and by the root of it, half and half: the scores look at the former, the seeds
        sit at the latter.
        """
        e = describer.field.emission
        weight = e / e.sum() + np.sqrt(e) / np.sqrt(e).sum()
        weight /= weight.sum()
        share = min(1.0, most / np.count_nonzero(e))
        energy = float((weight[..., None] * truth.astype(np.float64) ** 2).sum())
        parts = []
        for f, frame in enumerate(describer.field.frames):
            chosen = np.flatnonzero((frame.emission > 0) & (rng.random(len(frame.emission)) < share))
            features, vectors = describer.describe(f)
            parts.append((features[chosen], vectors[chosen], truth[f][chosen], weight[f][chosen] / share))
        features, vectors, chosen_truth, weight = (np.concatenate(p) for p in zip(*parts, strict=True))
        n = len(features)
        arrays = (features, vectors, chosen_truth, weight * n, np.full(n, 1 / energy))
        return cls(*(torch.tensor(array, dtype=torch.float32) for array in arrays))

    @classmethod
    def joined(cls, flames: list[LitVoxels]) -> LitVoxels:
        """Return every flame counts alike, whatever it has of voxels."""
        mean = sum(len(flame) for flame in flames) / len(flames)
        parts = [replace(flame, weight=flame.weight * mean / len(flame)) for flame in flames]
        names = cls.__dataclass_fields__
        return cls(*(torch.cat([getattr(part, name) for part in parts]) for name in names))

    def __len__(self) -> int:
        return len(self.features)


@dataclass(frozen=True)
class TrainingFlame:
    """One flame as the prior sees it.

    Attributes:
        pace: true mean speed of its gas, weighted by light, m/s.
        stands: whether it stands; the pace of one that lies in the wind is not learned from.
    """

    clues: SpeedClues
    pace: float
    samples: LitVoxels
    stands: bool

    @classmethod
    def of(cls, field: FlowField, truth: np.ndarray) -> TrainingFlame:
        """From a field with no other flame's light, and its true velocity (F, V, 3). Raises GofError: nothing moves."""
        describer = FlameDescriber.of(field)
        if describer is None:
            raise GofError("a flame in which nothing moves cannot be trained on")
        pace = mean_speed(truth, field.emission)
        samples = LitVoxels.of(describer, truth / pace, np.random.default_rng(0))
        return cls(SpeedClues.of(describer.axis, describer.log_light), pace, samples, stands(describer.axis))


@dataclass(frozen=True)
class TrainingClip:
    """One dataset: a flame, or several side by side.

    Attributes:
        burns: which fire it shows; two datasets may show the same grids of another solver.
        solver: "openfoam" or "mantaflow".
    """

    burns: str
    solver: str
    dataset: Dataset
    field: FlowField
    flames: tuple[TrainingFlame, ...]

    @classmethod
    def of(cls, path: Path) -> TrainingClip:
        dataset = open_small(path)
        field = preview_field(observe(dataset))
        fire = read_json(path / "spec.json")["fire"]
        solver = "openfoam" if "grids" in fire else "mantaflow"
        burns = Path(fire["grids"]).parent.name if "grids" in fire else path.name
        truth = np.stack([dataset.velocity.at(frame.time_s).sample(field.voxels.center) for frame in field.frames])
        own = several_flames(field)
        flames = tuple(TrainingFlame.of(alone(field, own == k), truth) for k in range(own.max() + 1))
        return cls(burns, solver, dataset, field, flames)


HEADER = """\
| fire, not trained on | as seen: L2, CosSim, speed | with the prior: the same, fluctuation | pace | within \
| mean per height: L2, CosSim | constant | law |
|---|---|---|---|---|---|---|---|"""


@dataclass(frozen=True)
class FlameErrors:
    """A flame's figures before and after the prior, and its trivial baselines'.

    Attributes:
        seen, found: L2, CosSim, speed; fluctuation CosSim (found only).
        pace: estimated over true, of several flames the geometric mean.
        within: share of the light within a standard deviation.
        trivial_baselines: L2, CosSim of the mean per height, the best constant, the buoyant law.
    """

    seen: tuple[float, ...]
    found: tuple[float, ...]
    pace: float
    within: float
    trivial_baselines: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, clip: TrainingClip, prior: FlowPrior) -> FlameErrors:
        seen, dataset = clip.field, clip.dataset
        found = prior.correct(seen)
        trivial_baselines = mean_per_height(seen, dataset), best_constant(seen, dataset), buoyant_law(seen)
        return cls(
            astuple(score(seen, dataset)),
            (*astuple(score(found, dataset)), fluctuation_cos_sim(found, dataset)),
            float(np.exp(np.mean(pace_error(clip, prior.pace)))),
            within(found, dataset),
            tuple(astuple(score(trivial_baseline, dataset))[:2] for trivial_baseline in trivial_baselines),
        )

    @classmethod
    def mean(cls, rows: list[FlameErrors]) -> FlameErrors:
        def of(name: str) -> np.ndarray:
            return np.mean([getattr(row, name) for row in rows], axis=0)

        return cls(of("seen"), of("found"), of("pace"), of("within"), of("trivial_baselines"))

    def __str__(self) -> str:
        def listed(values: Sequence[float]) -> str:
            return ", ".join(f"{value:.3f}" for value in values)

        own = f"{listed(self.seen)} | {listed(self.found)} | {self.pace:.2f} | {self.within:.2f}"
        return f"{own} | {' | '.join(map(listed, self.trivial_baselines))}"


def pace_error(clip: TrainingClip, pace: MeanSpeed, metres: bool = True) -> np.ndarray:
    """Log of estimated over true pace of each flame."""
    found = pace.side_by_side([flame.clues for flame in clip.flames], metres)
    return np.log(found) - np.log([flame.pace for flame in clip.flames])


Layers = list[tuple[torch.Tensor, torch.Tensor]]
"""Weights (members, in, out) and biases (members, 1, out) of an ensemble of small networks."""


@dataclass(frozen=True)
class Scaling:
    """Mean and deviation (K,) of the training features."""

    mean: torch.Tensor
    deviation: torch.Tensor

    @classmethod
    def of(cls, samples: LitVoxels) -> Scaling:
        return cls(samples.features.mean(0), samples.features.std(0) + 1e-3)

    def __call__(self, features: torch.Tensor) -> torch.Tensor:
        return (features - self.mean) / self.deviation


def train_velocity(
    flames: list[LitVoxels], seed: int = 0, members: int = 4, steps: int = 700
) -> tuple[Scaling, Network]:
    """Return the ensemble that gives the velocity over the pace, by AdamW with noise on the features."""
    torch.manual_seed(seed)
    samples = LitVoxels.joined(flames)
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


def train_uncertainty(
    scaling: Scaling, flames: list[LitVoxels], errors: list[torch.Tensor], seed: int = 0, steps: int = 500
) -> Network:
    """Return one network for the log of the standard deviation, over the pace, by maximum likelihood.

    Args:
        errors: per flame (N, 3), over the pace, of ensembles and lines that had not been fitted to it: they are surer
            of what they know than they may be of a new flame.
    """
    torch.manual_seed(seed)
    samples = LitVoxels.joined(flames)
    variance = (torch.cat(errors) ** 2).mean(-1)
    layers = new_layers([len(FEATURES), 12, 1], 1)

    def loss(batch: torch.Tensor) -> torch.Tensor:
        log_sd = forward(layers, scaling(samples.features[batch]))[..., 0].clamp(-6, 6)
        return (samples.weight[batch] * (log_sd + 0.5 * variance[batch] * torch.exp(-2 * log_sd))).mean()

    descend(layers, loss, len(samples), steps)
    return plain(layers)


def forward(layers: Layers, features: torch.Tensor, noise: float = 0.1) -> torch.Tensor:
    """Return (members, B, out) from features (members, B, K), which are shaken so that no flame is learned by heart."""
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


def held_out_error(scaling: Scaling, network: Network, samples: LitVoxels, pace: float = 1.0) -> torch.Tensor:
    """Return (N, 3) of an ensemble on a flame that it was not trained on, over the pace that was estimated for it.

    Args:
        pace: estimated over true one.
    """
    coefficients = evaluate_network(network, scaling(samples.features).numpy()).mean(0)
    velocity = np.einsum("nk,nki->ni", coefficients, samples.vectors.numpy())
    return torch.tensor(velocity) - samples.truth / pace


def prior_of(scaling: Scaling, velocity: Network, uncertainty: Network, pace: MeanSpeed) -> FlowPrior:
    return FlowPrior(scaling.mean.numpy(), scaling.deviation.numpy(), velocity, uncertainty, pace)


def main(argv: list[str] | None = None) -> None:
    """Read, train with each flame left out, score, train on all, save."""
    config = tyro.cli(TrainConfig, prog="python -m gof_benchmark.training.flow_prior", args=argv)
    torch.set_num_threads(1)  # the networks are too small to share
    paths = sorted(path.parent for path in (config.work / "dev").glob("*/dataset.json"))
    everything = []
    with progress_bar("motion") as progress:
        for path in paths:
            everything.append(TrainingClip.of(path))
            progress(len(everything), len(paths))
    clips = [clip for clip in everything if clip.solver != config.without]

    print(HEADER)
    rows = []

    def show(name: str, clip: TrainingClip, prior: FlowPrior) -> None:
        rows.append(FlameErrors.of(clip, prior))
        print(f"| `{name}` | {rows[-1]} |", flush=True)

    others = [[other for other in clips if other.burns != clip.burns] for clip in clips]
    without = [LeftOut.of(clip, known) for clip, known in zip(clips, others, strict=True)]
    errors = {clip.dataset.path: left.errors for clip, left in zip(clips, without, strict=True)}

    def uncertainty_of(known: list[TrainingClip], scaling: Scaling) -> Network:
        return train_uncertainty(
            scaling, samples_of(known), [error for clip in known for error in errors[clip.dataset.path]]
        )

    for clip, known, left in zip(clips, others, without, strict=True):
        uncertainty = uncertainty_of(known, left.scaling)
        show(clip.dataset.path.name, clip, prior_of(left.scaling, left.velocity, uncertainty, left.pace))
    print(f"| mean | {FlameErrors.mean(rows)} |")
    for metres in (True, False):
        off = [pace_error(clip, left.pace, metres) for clip, left in zip(clips, without, strict=True)]
        unit = "in metres" if metres else "unit unknown"
        spread = np.sqrt(np.mean(np.square(np.concatenate(off))))
        print(f"pace of flames left out, {unit}: {spread:.0%} off (RMS of the log)")
    scaling, velocity = train_velocity(samples_of(clips))
    prior = prior_of(scaling, velocity, uncertainty_of(clips, scaling), fitted_pace(clips))
    for clip in everything:
        if clip.solver == config.without:
            show(clip.dataset.path.name, clip, prior)
    for path in config.test:
        show(str(path), TrainingClip.of(path), prior)
    with atomic_path(config.out) as temporary:
        prior.save(temporary)
    print(f"pace: metric {prior.pace.metric.round(2)}, unitless {prior.pace.unitless.round(2)}")
    print(f"weights -> {config.out}")


def samples_of(clips: list[TrainingClip]) -> list[LitVoxels]:
    return [flame.samples for clip in clips for flame in clip.flames]


def fitted_pace(clips: list[TrainingClip]) -> MeanSpeed:
    flames = [flame for clip in clips for flame in clip.flames if flame.stands]
    return MeanSpeed.fit([flame.clues for flame in flames], [flame.pace for flame in flames])


@dataclass(frozen=True)
class LeftOut:
    """A clip's prediction learned from others alone, and its error there; errors as `held_out_error`, by flame."""

    pace: MeanSpeed
    scaling: Scaling
    velocity: Network
    errors: tuple[torch.Tensor, ...]

    @classmethod
    def of(cls, clip: TrainingClip, others: list[TrainingClip]) -> LeftOut:
        pace = fitted_pace(others)
        scaling, velocity = train_velocity(samples_of(others))
        ratios = np.exp(pace_error(clip, pace))
        pairs = zip(clip.flames, ratios.tolist(), strict=True)
        errors = tuple(held_out_error(scaling, velocity, flame.samples, ratio) for flame, ratio in pairs)
        return cls(pace, scaling, velocity, errors)


if __name__ == "__main__":
    main()
