"""Learn how fast flames are as a whole, and say what each clue is worth.

    python -m gof_benchmark.fires WORK --split dev
    python -m gof_benchmark.training.pace_line WORK --fires 60 [--out gof/reconstruct/flow_prior.npz]

Fires come from two places: the datasets in WORK/dev, and the factory, which bakes new ones by the generator and films
them without Blender. What is kept of each is one small file in WORK/pace, so that the same command goes on where it was
stopped. Lines in logarithms are fitted to them and printed, all as RMS (and mean) of the log of estimated over true
pace: a learning curve (lines through some fires, asked about the others), and tables of kinds, of sources and of
emission laws that a line had not seen. Lines are held near the shipped one, which dozens of fires have taught, by
STIFFNESS; they correct its four clues, or weigh one or two more. With --out the best known set of clues is fitted to
all of them and written into the flow prior's weights; its networks stay as they are.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable
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
from gof.reconstruct.pace import STIFFNESS, Pace, PaceClues
from gof.reconstruct.several_flames import alone, several_flames
from gof_benchmark.training.factory.draws import Draw
from gof_benchmark.training.factory.fire import PoorFireError, Recording, make_fire
from gof_benchmark.training.field_score import best_constant, mean_speed, open_small, preview_field, score

DRAWS = 20  # random choices of fires for a point of the learning curve
SMALLEST, LEAST_LEFT = 6, 5  # fires of the curve's first point, and left to ask about at its last


@dataclass
class PaceConfig:
    """Make the factory's fires and fit the pace to them and to the dev fires; see the module's text."""

    work: tyro.conf.Positional[Path]
    """Folder of the benchmark's fires; clues go into its folder pace."""
    fires: int = 60
    """How many fires of the factory; numbers 0 to N - 1."""


@dataclass(frozen=True)
class SeenFire:
    """What is kept of a fire.

    Attributes:
        name: of its file.    source: "dev" or "factory".    kind: of `draws.KINDS`, or "openfoam".
        law: of `light.LAWS`; "cycles" of a dataset.    clues, paces: of each of its flames; true paces, m/s.
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
        kept |= seen(opened())
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


def seen(recording: Recording | Dataset) -> dict:
    """Return clues and true pace of every flame, and scores of the seen field and of the best constant.

    Raises:
        GofError: the stages find no flame, or nothing that moves.
    """
    field = preview_field(observe(recording))
    truth = np.stack([recording.velocity.at(frame.time_s).sample(field.voxels.center) for frame in field.frames])
    own = several_flames(field)
    flames = []
    for part in (alone(field, own == k) for k in range(own.max() + 1)):
        axis, pace = FlameAxis.of(part), mean_speed(truth, part.emission)
        if axis is not None and pace > 0:
            flames.append({"clues": asdict(PaceClues.of(axis, LogLight.of(part))), "pace": pace})
    if not flames:
        raise PoorFireError("nothing is seen to move")
    constant = score(best_constant(field, recording), recording)
    scores = {"seen": asdict(score(field, recording)), "constant": asdict(constant)}
    return {"flames": flames, "scores": scores}


# ---- Lines ----------------------------------------------------------------------------------------------------------

NEAR = 1.0  # stiffness of what is held near the shipped line: as much as a fire that says "it is right"


@dataclass(frozen=True)
class Recipe:
    """How a line is fitted.

    Attributes:
        more: names of clues beside the shipped four.    stiffness: of the fit, as `pace.STIFFNESS`.
        near: whether the fit is held near the shipped line, not near 0.
    """

    more: tuple[str, ...] = ()
    stiffness: float = NEAR
    near: bool = True


RECIPES = {
    "four, anew": Recipe(stiffness=STIFFNESS, near=False),
    "shipped, constant": Recipe(stiffness=1e6),
    "near shipped": Recipe(),
    "+ seen_fluct": Recipe(("seen_fluct",)),
    "+ unknown": Recipe(("unknown",)),
    "+ both": Recipe(("seen_fluct", "unknown")),
}
Line = Callable[[PaceClues], float]
"""Log of the pace over the seen speed, from clues."""


def fitted(fires: Iterable[SeenFire], recipe: Recipe, shipped: Pace) -> Line:
    """Return the line through fires by ridge regression; its constant is free."""
    clues = [c for fire in fires for c in fire.clues]
    paces = np.array([pace for fire in fires for pace in fire.paces])
    added = np.array([[getattr(c, name) for name in recipe.more] for c in clues]).reshape(len(clues), -1)
    middle, spread = added.mean(0), added.std(0) + 1e-3

    def row(c: PaceClues) -> np.ndarray:
        values = np.array([getattr(c, name) for name in recipe.more])
        return np.concatenate([[1], c.logs, np.clip((values - middle) / spread, -3, 3)])

    design = np.stack([row(c) for c in clues])
    begin = np.zeros(design.shape[1])
    if recipe.near:
        begin[: len(shipped.metric)] = shipped.metric
    factor = np.log(paces / [c.seen for c in clues]) - design @ begin
    penalty = recipe.stiffness * np.diag([1e-6 / recipe.stiffness] + [1] * (design.shape[1] - 1))
    weights = begin + np.linalg.solve(design.T @ design + penalty, design.T @ factor)
    return lambda c: float(weights @ row(c))


def buoyancy_alone(c: PaceClues) -> float:
    """Return the log of what buoyancy would make of a flame over its seen speed: nothing is fitted."""
    return float(np.log(max(c.buoyant, 1e-9) / c.seen))


def errors(line: Line, fire: SeenFire) -> np.ndarray:
    """Return the log of estimated over true pace of each flame; flames side by side share a multiple of buoyancy.

    The same joining as `Pace.side_by_side`, for any line.
    """
    apart = np.array([np.log(c.seen) + line(c) for c in fire.clues])
    buoyant = np.log([c.buoyant for c in fire.clues])
    if len(apart) > 1 and np.isfinite(buoyant).all():
        apart = buoyant + np.average(apart - buoyant, weights=[c.energy for c in fire.clues])
    return apart - np.log(fire.paces)


def rms(values: Iterable[np.ndarray]) -> float:
    """Return the root mean square of arrays joined."""
    return float(np.sqrt(np.mean(np.square(np.concatenate(list(values))))))


# ---- Tables ---------------------------------------------------------------------------------------------------------


def learning_curve(fires: list[SeenFire], shipped: Pace) -> str:
    """Return Markdown: RMS on the fires left, by how many were learned from, means of random choices."""
    lines = [f"| fires | {' | '.join(RECIPES)} |", "|---|" + "---|" * len(RECIPES)]
    count = SMALLEST
    while count <= len(fires) - LEAST_LEFT:
        off = {name: [] for name in RECIPES}
        for draw in range(DRAWS):
            order = np.random.default_rng(draw).permutation(len(fires))
            known, left = ([fires[i] for i in part] for part in (order[:count], order[count:]))
            for name, recipe in RECIPES.items():
                line = fitted(known, recipe, shipped)
                off[name].append(rms(errors(line, fire) for fire in left))
        lines.append(f"| {count} | {' | '.join(f'{np.mean(off[name]):.3f}' for name in RECIPES)} |")
        count *= 2
    return "\n".join(lines)


def left_out(fires: list[SeenFire], trait: Callable[[SeenFire], str], shipped: Pace) -> str:
    """Return Markdown: RMS (and mean) of each group of fires by lines that no fire of that group was fitted to."""
    columns = ["shipped", "buoyant alone", *RECIPES]
    lines = [f"| left out | fires | {' | '.join(columns)} |", "|---|---|" + "---|" * len(columns)]
    everything = {name: [] for name in columns}
    for group in sorted({trait(fire) for fire in fires}):
        mine, others = [f for f in fires if trait(f) == group], [f for f in fires if trait(f) != group]
        if not others:
            continue
        known = {"shipped": lambda c: float(np.log(shipped.of(c) / c.seen)), "buoyant alone": buoyancy_alone}
        known |= {name: fitted(others, recipe, shipped) for name, recipe in RECIPES.items()}
        cells = []
        for name in columns:
            off = [errors(known[name], fire) for fire in mine]
            everything[name] += off
            cells.append(f"{rms(off):.3f} ({np.mean(np.concatenate(off)):+.2f})")
        lines.append(f"| {group} | {len(mine)} | {' | '.join(cells)} |")
    if all(everything.values()):
        lines.append(f"| all | {len(fires)} | {' | '.join(f'{rms(everything[name]):.3f}' for name in columns)} |")
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
    """Print the tables of the fires kept at paths."""
    kept = [SeenFire.read(path) for path in paths]
    fires = [fire for fire in kept if fire is not None]
    cost = np.mean([read_json(path)["cpu_s"] for path in paths])
    shipped = FlowPrior.load().pace
    print(f"{len(fires)} fires, {len(kept) - len(fires)} poor ones left away; {cost:.1f} CPU s each")
    tables = [left_out(fires, trait, shipped) for trait in (lambda f: f.kind, lambda f: f.source, lambda f: f.law)]
    print(learning_curve(fires, shipped), *tables, sep="\n\n")


if __name__ == "__main__":
    main()
