"""Learn how fast flames are as a whole from the factory's fires, and say what each clue is worth.

    python -m gof_benchmark.training.pace_line WORK --fires 300

Makes the fires that WORK does not hold yet, one file each, so that the same command goes on where it was stopped; then
fits lines in logarithms to them and prints, all as RMS of the log of estimated over true pace: a learning curve (lines
through some fires, asked about the others), and tables of kinds and of emission laws that the line had not seen. Lines
have the four clues that are shipped, or one or two more; beside them stand the shipped line and the buoyant clue alone,
which learned nothing here. No weights of the product are written.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import only_run_in, read_json, write_json
from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.log_light import LogLight
from gof.reconstruct.observation import observe
from gof.reconstruct.pace import STIFFNESS, PaceClues
from gof.reconstruct.several_flames import alone, several_flames
from gof_benchmark.training.factory.draws import Draw
from gof_benchmark.training.factory.fire import PoorFireError, Recording, make_fire
from gof_benchmark.training.field_score import best_constant, mean_speed, preview_field, score

DRAWS = 20  # random choices of fires for a point of the learning curve
SMALLEST, LEAST_LEFT = 10, 5  # fires of the curve's first point, and left to ask about at its last


@dataclass
class PaceConfig:
    """Make the factory's fires and fit the pace to them; see the module's text."""

    work: tyro.conf.Positional[Path]
    """Folder of the fires' clues; made if it is not there."""
    fires: int = 300
    """How many fires; numbers 0 to N - 1."""


@dataclass(frozen=True)
class BurntFire:
    """What is kept of a fire.

    Attributes:
        number, kind, law: as of `Draw`.    clues, paces: of each of its flames; true paces, m/s.
    """

    number: int
    kind: str
    law: str
    clues: tuple[PaceClues, ...]
    paces: tuple[float, ...]

    @classmethod
    def read(cls, path: Path) -> BurntFire | None:
        """Return a fire that `keep` wrote; None when it was poor."""
        kept = read_json(path)
        if "poor" in kept:
            return None
        flames = kept["flames"]
        clues = tuple(PaceClues(**flame["clues"]) for flame in flames)
        return cls(kept["number"], kept["kind"], kept["law"], clues, tuple(flame["pace"] for flame in flames))


def keep(number: int, path: Path) -> str:
    """Burn and film a fire, run the product's stages on it, keep its clues and true paces; return a line about it."""
    began = time.process_time()
    draw = Draw.of(number)
    kept = {"number": number, "kind": draw.kind, "law": draw.law}
    try:
        recording = make_fire(draw)
        made = time.process_time() - began
        kept |= seen(recording) | {"made_cpu_s": round(made, 2)}
    except GofError as e:
        kept["poor"] = str(e)
    kept["cpu_s"] = round(time.process_time() - began, 2)
    write_json(path, kept)
    found = ", ".join(f"{flame['pace']:.2f} m/s" for flame in kept.get("flames", ()))
    return f"{number:5d} {draw.kind}, {draw.law}: {kept.get('poor', found)} ({kept['cpu_s']} CPU s)"


def seen(recording: Recording) -> dict:
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

CLUE_SETS: dict[str, tuple[str, ...]] = {
    "four": (),
    "+ seen_fluct": ("seen_fluct",),
    "+ unknown": ("unknown",),
    "+ both": ("seen_fluct", "unknown"),
}
Line = Callable[[PaceClues], float]
"""Log of the pace over the seen speed, from clues."""


def fitted(fires: Iterable[BurntFire], more: tuple[str, ...]) -> Line:
    """Return the line through fires by ridge regression: the four shipped clues, and more of these names."""
    clues = [c for fire in fires for c in fire.clues]
    paces = np.array([pace for fire in fires for pace in fire.paces])
    added = np.array([[getattr(c, name) for name in more] for c in clues]).reshape(len(clues), len(more))
    middle, spread = added.mean(0), added.std(0) + 1e-3

    def row(c: PaceClues, values: np.ndarray) -> np.ndarray:
        return np.concatenate([[1], c.logs, np.clip((values - middle) / spread, -3, 3)])

    design = np.stack([row(c, values) for c, values in zip(clues, added, strict=True)])
    factor = np.log(paces / [c.seen for c in clues])
    penalty = STIFFNESS * np.diag([1e-6] + [1] * (design.shape[1] - 1))
    weights = np.linalg.solve(design.T @ design + penalty, design.T @ factor)
    return lambda c: float(weights @ row(c, np.array([getattr(c, name) for name in more])))


def buoyancy_alone(c: PaceClues) -> float:
    """Return the log of what buoyancy would make of a flame over its seen speed: nothing is fitted."""
    return float(np.log(max(c.buoyant, 1e-9) / c.seen))


def errors(line: Line, fire: BurntFire) -> np.ndarray:
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


def learning_curve(fires: list[BurntFire]) -> str:
    """Return Markdown: RMS on the fires left, by how many were learned from, means of random choices."""
    lines = [f"| fires | {' | '.join(CLUE_SETS)} |", "|---|" + "---|" * len(CLUE_SETS)]
    count = SMALLEST
    while count <= len(fires) - LEAST_LEFT:
        off = {name: [] for name in CLUE_SETS}
        for draw in range(DRAWS):
            order = np.random.default_rng(draw).permutation(len(fires))
            known, left = ([fires[i] for i in part] for part in (order[:count], order[count:]))
            for name, more in CLUE_SETS.items():
                line = fitted(known, more)
                off[name].append(rms(errors(line, fire) for fire in left))
        lines.append(f"| {count} | {' | '.join(f'{np.mean(off[name]):.3f}' for name in CLUE_SETS)} |")
        count *= 2
    return "\n".join(lines)


def left_out(fires: list[BurntFire], trait: Callable[[BurntFire], str]) -> str:
    """Return Markdown: RMS (and mean) of each group of fires by lines that no fire of that group was fitted to."""
    shipped = FlowPrior.load().pace
    columns = ["shipped", "buoyant alone", *CLUE_SETS]
    lines = [f"| left out | fires | {' | '.join(columns)} |", "|---|---|" + "---|" * len(columns)]
    everything = {name: [] for name in columns}
    for group in sorted({trait(fire) for fire in fires}):
        mine, others = [f for f in fires if trait(f) == group], [f for f in fires if trait(f) != group]
        if not others:
            continue
        known = {"shipped": lambda c: float(np.log(shipped.of(c) / c.seen)), "buoyant alone": buoyancy_alone}
        known |= {name: fitted(others, more) for name, more in CLUE_SETS.items()}
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
    config.work.mkdir(parents=True, exist_ok=True)
    paths = [config.work / f"{number:05d}.json" for number in range(config.fires)]
    with only_run_in(config.work):
        for number, path in enumerate(paths):
            if not path.exists():
                print(keep(number, path), flush=True)
    report(paths)


def report(paths: list[Path]) -> None:
    """Print the tables of the fires kept at paths."""
    kept = [BurntFire.read(path) for path in paths]
    fires = [fire for fire in kept if fire is not None]
    cost = np.mean([read_json(path)["cpu_s"] for path in paths])
    print(f"{len(fires)} fires, {len(kept) - len(fires)} poor ones left away; {cost:.1f} CPU s each")
    print(learning_curve(fires), left_out(fires, lambda f: f.kind), left_out(fires, lambda f: f.law), sep="\n\n")


if __name__ == "__main__":
    main()
