"""What each clue of a flame's pace is worth, on fires of kinds that a line has not seen.

    python -m gof_benchmark.fires WORK --split dev
    python -m gof_benchmark.training.pace_line WORK --fires 60

Fires come from two places: the datasets in WORK/dev, and the factory, which bakes new ones by the generator and films
them without Cycles. What is kept of each is one small file in WORK/pace, so that the same command goes on where it was
stopped. Printed are, all as RMS (and mean) of the log of estimated over true pace: a learning curve (lines through some
fires, asked about the others), and tables of kinds, sources and emission laws that a line had not seen. Nothing of the
product is changed: the shipped line is fitted by `flow_prior`, and a clue that wins here may be added to it.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import only_run_in, read_json, write_json
from gof.dataset import Dataset
from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.log_light import LogLight
from gof.reconstruct.observation import observe
from gof.reconstruct.pace import USUAL, Pace, PaceClues
from gof.reconstruct.several_flames import alone, several_flames
from gof_benchmark.training.factory.draws import Draw
from gof_benchmark.training.factory.fire import PoorFireError, Recording, make_fire
from gof_benchmark.training.field_score import mean_speed, open_small, preview_field

DRAWS = 20  # random choices of fires for a point of the learning curve
SMALLEST, LEAST_LEFT = 4, 4  # fires of the curve's first point, and left to ask about at its last


@dataclass
class PaceConfig:
    """Make the factory's fires and ask of them and the dev fires what clues are worth; see the module's text."""

    work: tyro.conf.Positional[Path]
    """Folder of the benchmark's fires; what is kept goes into its folder pace."""
    fires: int = 60
    """How many fires of the factory; numbers 0 to N - 1."""


@dataclass(frozen=True)
class SeenFire:
    """What is kept of a fire.

    Attributes:
        name: of its file.    source: "dev" or "factory".    kind: of `draws.KINDS`, or "openfoam".
        law: of `light.LAWS`; "cycles" of a dataset.
        clues, paces: of each of its flames; true paces, m/s.
    """

    name: str
    source: str
    kind: str
    law: str
    clues: tuple[PaceClues, ...]
    paces: tuple[float, ...]

    @classmethod
    def read(cls, path: Path) -> SeenFire | None:
        """Return a fire that `keep` wrote; None when it was poor."""
        kept = read_json(path)
        if "poor" in kept:
            return None
        flames = kept["flames"]
        clues = tuple(PaceClues(**flame["clues"]) for flame in flames)
        paces = tuple(flame["pace"] for flame in flames)
        return cls(path.stem, kept["source"], kept["kind"], kept["law"], clues, paces)


def keep(path: Path, traits: dict[str, str], opened: Callable[[], Recording | Dataset]) -> str:
    """Run the product's stages on a fire, keep its clues and true paces; return a line about it."""
    began = time.process_time(), children_s()
    kept = dict(traits)
    try:
        kept["flames"] = seen(opened())
    except GofError as e:
        kept["poor"] = str(e)
    kept["cpu_s"] = round(time.process_time() - began[0] + children_s() - began[1], 2)
    write_json(path, kept)
    found = ", ".join(f"{flame['pace']:.2f} m/s" for flame in kept.get("flames", ()))
    return f"{path.stem} {traits['kind']}, {traits['law']}: {kept.get('poor', found)} ({kept['cpu_s']} CPU s)"


def children_s() -> float:
    """Return the CPU seconds of the processes that this one started and that ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def kind_of(spec: dict) -> str:
    """Return the kind of fire that a dataset's spec.json describes."""
    fire = spec["fire"]
    if "grids" in fire:
        return "openfoam"
    if any(effect["name"] == "wind" for effect in spec.get("effects", ())):
        return "wind"
    if fire.get("jet_speed"):
        return "jet"
    return {"sphere": "ball", "logs": "logs"}.get(fire.get("shape", "disc"), "pool")


def seen(fire: Recording | Dataset) -> list[dict]:
    """Return clues and true pace of every flame of a fire.

    Raises:
        GofError: the stages find no flame, or nothing that moves.
    """
    field = preview_field(observe(fire))
    truth = np.stack([fire.velocity.at(frame.time_s).sample(field.voxels.center) for frame in field.frames])
    own = several_flames(field)
    flames = []
    for part in (alone(field, own == k) for k in range(own.max() + 1)):
        axis, pace = FlameAxis.of(part), mean_speed(truth, part.emission)
        if axis is not None and pace > 0:
            flames.append({"clues": asdict(PaceClues.of(axis, LogLight.of(part))), "pace": pace})
    if not flames:
        raise PoorFireError("nothing is seen to move")
    return flames


# ---- Lines ----------------------------------------------------------------------------------------------------------

SHIPPED = FlowPrior.load().pace


def errors(line: Pace, fire: SeenFire) -> np.ndarray:
    """Return the log of estimated over true pace of each flame."""
    return np.log(line.side_by_side(fire.clues)) - np.log(fire.paces)


def with_metric(*weights: float) -> Pace:
    """Return a line of these weights, metres known or not."""
    return Pace(*[np.array(weights)] * 2)


def anew(fires: Sequence[SeenFire]) -> Pace:
    """Return the line through these fires alone."""
    return Pace.fit([c for fire in fires for c in fire.clues], [pace for fire in fires for pace in fire.paces])


def moved(fires: Sequence[SeenFire]) -> Pace:
    """Return the shipped line with the constant that these fires ask for."""
    constant, *slopes = SHIPPED.metric
    return with_metric(constant - np.mean(np.concatenate([errors(SHIPPED, fire) for fire in fires])), *slopes)


LINES: dict[str, Callable[[Sequence[SeenFire]], Pace]] = {
    "shipped": lambda fires: SHIPPED,
    "without unsteadiness": lambda fires: with_metric(*SHIPPED.metric[:5], 0),
    "buoyancy": lambda fires: with_metric(np.log(USUAL[0]), 1, 0, 0, 0, 0),
    "anew": anew,
    "shipped, moved": moved,
}
"""What may be done with fires whose pace is known; the first three learn nothing from them."""


def rms(values: Iterable[np.ndarray]) -> float:
    """Return the root mean square of arrays joined."""
    return float(np.sqrt(np.mean(np.square(np.concatenate(list(values))))))


# ---- Tables ---------------------------------------------------------------------------------------------------------


def learning_curve(fires: Sequence[SeenFire]) -> str:
    """Return Markdown: RMS on the fires left, by how many were learned from, means of random choices."""
    lines = [f"| fires | {' | '.join(LINES)} |", "|---|" + "---|" * len(LINES)]
    count = SMALLEST
    while count <= len(fires) - LEAST_LEFT:
        off = {name: [] for name in LINES}
        for draw in range(DRAWS):
            order = np.random.default_rng(draw).permutation(len(fires))
            known, left = ([fires[i] for i in part] for part in (order[:count], order[count:]))
            for name, line in LINES.items():
                fitted = line(known)
                off[name].append(rms(errors(fitted, fire) for fire in left))
        lines.append(f"| {count} | {' | '.join(f'{np.mean(off[name]):.3f}' for name in LINES)} |")
        count *= 2
    return "\n".join(lines)


def left_out(fires: Sequence[SeenFire], trait: Callable[[SeenFire], str]) -> str:
    """Return Markdown: RMS (and mean) of each group of fires by lines that no fire of that group was fitted to."""
    lines = [f"| left out | fires | {' | '.join(LINES)} |", "|---|---|" + "---|" * len(LINES)]
    everything = {name: [] for name in LINES}
    for group in sorted({trait(fire) for fire in fires}):
        mine, others = [f for f in fires if trait(f) == group], [f for f in fires if trait(f) != group]
        if not others:
            continue
        cells = []
        for name, line in LINES.items():
            fitted = line(others)
            off = [errors(fitted, fire) for fire in mine]
            everything[name] += off
            cells.append(f"{rms(off):.3f} ({np.mean(np.concatenate(off)):+.2f})")
        lines.append(f"| {group} | {len(mine)} | {' | '.join(cells)} |")
    if all(everything.values()):
        lines.append(f"| all | {len(fires)} | {' | '.join(f'{rms(everything[name]):.3f}' for name in LINES)} |")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    """Make what is missing, fit, print."""
    config = tyro.cli(PaceConfig, prog="python -m gof_benchmark.training.pace_line", args=argv)
    cv2.setNumThreads(1)  # a fire is too small to share
    folder = config.work / "pace"
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with only_run_in(folder):
        for dataset in sorted(path.parent for path in (config.work / "dev").glob("*/dataset.json")):
            paths.append(folder / f"{dataset.name}.json")
            if not paths[-1].exists():
                traits = {"source": "dev", "kind": kind_of(read_json(dataset / "spec.json")), "law": "cycles"}
                print(keep(paths[-1], traits, partial(open_small, dataset)), flush=True)
        for draw in map(Draw.of, range(config.fires)):
            paths.append(folder / f"{draw.spec.name}.json")
            if not paths[-1].exists():
                traits = {"source": "factory", "kind": draw.kind, "law": draw.law}
                print(keep(paths[-1], traits, partial(make_fire, draw)), flush=True)
    report(paths)


def report(paths: list[Path]) -> None:
    """Print the tables of the fires kept at paths, without poor ones."""
    kept = [SeenFire.read(path) for path in paths]
    fires = [fire for fire in kept if fire is not None]
    cost = np.mean([read_json(path)["cpu_s"] for path in paths])
    print(f"{len(fires)} fires, {len(kept) - len(fires)} poor ones left away; {cost:.1f} CPU s each")
    tables = [left_out(fires, trait) for trait in (lambda f: f.kind, lambda f: f.source, lambda f: f.law)]
    print(learning_curve(fires), *tables, sep="\n\n")


if __name__ == "__main__":
    main()
