"""OpenUSD files with Gaussian splats that move (`gof.io.usd`), by anybody's exporter, through OpenUSD's own library.

Ours say their closed form. From other files the state at every time sample is taken, of all prims that pictures show,
in their world: with the transforms above them, Z up, in metres. Arrays are interpolated as OpenUSD does it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gof.core.datum import Datum
from gof.core.errors import DataFormatError
from gof.core.gaussians import FILLED_IN, TransientGaussians
from gof.core.harmonics import C0
from gof.core.trajectory import Trajectory
from gof.io import usd as u
from gof.io.importers import usd_stage
from gof.io.importers.ply_sequence import difference_notes
from gof.io.importers.source import Imported, ImportOptions, Source, require_unit

OPTIONS = ("time_unit_s", "time_zero_s")
SUFFIXES = (*u.SUFFIXES, ".usd", ".usdz")
MOST_STATES = 100_000_000  # samples times Gaussians: some gigabytes
LARGE = 0.3  # relative L2 between stored velocities and differences of places, from which on a note says so


def matches(source: Source) -> bool:
    return source.path.is_file() and source.path.suffix.lower() in SUFFIXES


def read(source: Source, options: ImportOptions) -> Imported:
    u.library(f"{source.path}: reading OpenUSD")
    with usd_stage.open_stage(source.path) as stage:
        prims, notes = usd_stage.find_splats(stage)
        codes = usd_stage.find_samples(prims)
        places = [usd_stage.to_world(stage, prim, codes) for prim in prims]
        layer = stage.GetRootLayer().customLayerData
        own, aside = _closed_form(stage, prims, codes, places, layer)
        emissive = len(prims) == 1 and layer.get(u.EMISSIVE) is True
        if own is not None:
            if options.time_unit_s is not None:
                raise DataFormatError("--time-unit would change nothing here: the file says its seconds; leave it out")
            own = replace(own, t_mu=own.t_mu + options.time_zero_s, emissive=emissive)
            method = str(layer.get(u.SOURCE, "")).partition(": ")[0] or "usd"
            return Imported(own, method, source.path, notes)
        clock = _Clock.of(stage, codes, options)
        if len(codes) > 1:
            require_unit(clock.times_s - options.time_zero_s, options, source.path)
        trajectory, motion_notes = _trajectory(prims, places, clock)
        trajectory = replace(trajectory, emissive=emissive)
        return Imported(
            trajectory,
            "usd",
            source.path,
            [*clock.notes, usd_stage.world_in_words(stage), *aside, *notes, *motion_notes],
        )


@dataclass(frozen=True)
class _Clock:
    """The samples' times. codes: (T,) of the file.   times_s: (T,) of the dataset.   stretch: seconds of the dataset to
    one of the file, 1 but where the options have a time unit."""

    codes: np.ndarray
    times_s: np.ndarray
    stretch: float
    notes: list[str]

    @classmethod
    def of(cls, stage: Any, codes: np.ndarray, options: ImportOptions) -> _Clock:
        rate = stage.GetTimeCodesPerSecond()
        if not 0 < rate < np.inf:
            raise DataFormatError(f"says that a second has {rate} time codes (timeCodesPerSecond); correct that")
        unit = options.time_unit_s or 1 / rate
        start = stage.GetStartTimeCode() if stage.HasAuthoredMetadata("startTimeCode") else (*codes, 0.0)[0]
        note = f"its time code {start:g} taken as {options.time_zero_s:g} s, and {1 / unit:g} codes as a second"
        notes = [f"{note} (else gof convert RESULT --time-zero, --time-unit)"]
        return cls(codes, options.time_zero_s + unit * (codes - start), unit * rate, notes)


# ----------------------------------------------------------------
# Our own files.


def _closed_form(
    stage: Any, prims: list[Any], codes: np.ndarray, places: list[np.ndarray], layer: dict[str, Any]
) -> tuple[TransientGaussians | None, list[str]]:
    """Return the Gaussians of a file of ours on its clock; None with a note where it has been changed; None.

    Other programs may have moved or retimed it, or put it into a scene: then its samples count.
    """
    prim = prims[0]
    if any(not prim.GetAttribute(f"primvars:{name}") for name in u.CLOSED_FORM):
        return None, []
    aside = [f"{prim.GetPath()}: gof's closed form is left aside, since "]
    if u.START not in layer or len(prims) > 1 or not len(codes) or np.ptp(places[0], axis=0).any():
        return None, [f"{aside[0]}it stands in another scene now; its samples are read"]
    first, start_s = stage.GetStartTimeCode(), float(layer[u.START])
    state: dict[str, Any] = {k: usd_stage.read_values(prim, k, first) for k in ("position", "scale", "rotation")}
    count = 0 if state["position"] is None else len(state["position"])
    read: list[Any] = [
        usd_stage.read_array(prim, f"primvars:{name}", 3 if "velocity" in name else 1, first, count)
        for name in (*u.CLOSED_FORM, "gas_velocity", "v_sd", "is_dynamic")
    ]
    if any(values is None for values in (*state.values(), *read[: len(u.CLOSED_FORM)])):
        return None, [f"{aside[0]}places, sizes, turns or parts of it are absent"]
    velocity, t_mu, t_sigma, opacity, gas, spread, moves = read
    color = usd_stage.read_colour(prim, first, count)
    dynamic = (t_sigma > 0) | velocity.any(1) if moves is None else moves > 0.5
    g = TransientGaussians(
        position=state["position"] + np.where(dynamic, t_mu - start_s, 0)[:, None] * velocity.astype(np.float64),
        velocity=velocity,
        t_mu=t_mu,
        t_sigma=np.where(t_sigma > 0, t_sigma, np.inf),
        scale=state["scale"],
        rotation=np.roll(state["rotation"], 1, axis=1),
        opacity=opacity,
        color=color if color.shape[1] > 1 else 0.5 + C0 * color[:, 0],
        dynamic=dynamic,
        gas_velocity=gas,
        velocity_sd=FILLED_IN if spread is None else np.where(spread < 0, np.inf, spread),
    )
    for code in codes:
        position, fade = g.at(start_s + (code - first) / stage.GetTimeCodesPerSecond())
        shown, seen = (usd_stage.read_values(prim, kind, code, count) for kind in ("position", "opacity"))
        near = 1e-5 * (1 + np.abs(position).max())
        if shown is None or seen is None or np.abs(shown - position).max() > near or np.abs(seen - fade).max() > 0.01:
            return None, [f"{aside[0]}it says something else than its samples, which are read: has it been changed?"]
    if np.abs(places[0][0] - np.eye(4)).max() > 1e-12:
        g = g.transformed(places[0][0])
    return replace(g, datum=Datum.from_numbers(layer[u.DATUM], "it")) if u.DATUM in layer else g, []


# ----------------------------------------------------------------
# Everybody's files: states at the samples.


@dataclass
class _States:
    """The Gaussians of a prim at T times; a row is one Gaussian, at all of them.

    position, velocity: (T, N, 3).   opacity: (T, N).   scale: (T or 1, N, 3).   rotation: (T or 1, N, 4).   color: (N,
    K, 3) harmonics.   present: (T, N) bool, whether the file says anything of it then.
    """

    position: np.ndarray
    opacity: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray
    color: np.ndarray
    velocity: np.ndarray | None
    present: np.ndarray

    @property
    def moves(self) -> bool:
        moved = (self.position != self.position[:1]).any() or not self.present.all()
        return bool(moved or (self.velocity is not None and self.velocity.any()))


def _trajectory(prims: list[Any], places: list[np.ndarray], clock: _Clock) -> tuple[Trajectory, list[str]]:
    """Return all prims' Gaussians at the samples, and notes. Raises DataFormatError: nothing moves."""
    parts, paths, notes = [], [], []
    for prim, matrices in zip(prims, places, strict=True) if len(clock.codes) > 1 else ():
        part, prim_notes = _states(prim, matrices, clock)
        notes += [f"{prim.GetPath()}: {words}" for words in prim_notes]
        if part is not None:
            parts.append(part)
            paths.append(str(prim.GetPath()))
    moves = [part.moves for part in parts]
    if not any(moves):
        raise DataFormatError(
            f"{', '.join(str(prim.GetPath()) for prim in prims[:3])}: stands still, and so has no velocities; author "
            f"time samples of positions{usd_stage.INSTEAD}"
        )
    velocities: list[np.ndarray] = []
    if any(part.velocity is not None for part in parts):  # one for all: differences where a prim has none
        velocities = [part.velocity if part.velocity is not None else _differences(part, clock) for part in parts]
    degree = max(part.color.shape[1] for part in parts)
    colors = [np.pad(part.color, ((0, 0), (0, degree - part.color.shape[1]), (0, 0))) for part in parts]
    color = np.concatenate(colors)
    trajectory = Trajectory(
        clock.times_s,
        position=_together([part.position for part in parts]),
        opacity=_together([part.opacity for part in parts]),
        scale=_together([part.scale for part in parts]),
        rotation=_together([part.rotation for part in parts]),
        velocity=np.concatenate(velocities, 1) if velocities else None,
        color=color if degree > 1 else 0.5 + C0 * color[:, 0],
        dynamic=np.repeat(moves, [part.position.shape[1] for part in parts]),
    )
    still = [path for path, moving in zip(paths, moves, strict=True) if not moving]
    notes += [f"{', '.join(still[:3])}: stands still, taken as background"] if still else []
    return trajectory, [*difference_notes(trajectory), *notes]


def _together(arrays: list[np.ndarray]) -> np.ndarray:
    """Return prims' arrays as one: (N, ...) where none of them changes, else (T, N, ...)."""
    steps = max(len(array) for array in arrays)
    whole = np.concatenate([np.broadcast_to(array, (steps, *array.shape[1:])) for array in arrays], 1)
    return whole[0] if steps == 1 else whole


def _differences(part: _States, clock: _Clock) -> np.ndarray:
    """Return (T, N, 3) m/s by the differences that a trajectory takes."""
    own = Trajectory(clock.times_s, part.position, part.opacity, part.scale[0], part.rotation[0])
    return np.stack([own.state_at(time_s).velocity for time_s in clock.times_s])


def _states(prim: Any, matrices: np.ndarray, clock: _Clock) -> tuple[_States | None, list[str]]:
    """Return what a prim says at all samples, and what had to be assumed; None where it never has a Gaussian."""
    position, rows, velocity, notes = _ways(prim, clock)
    steps, count = len(clock.codes), max((row.max(initial=-1) for row in rows), default=-1) + 1
    if not count:
        return None, [*notes, "holds no Gaussian"]
    if steps * count > MOST_STATES:
        raise DataFormatError(
            f"{prim.GetPath()}: {count:,} Gaussians at {steps} samples are more than gof reads; split the file in time"
        )
    whole = all(len(row) == count for row in rows)
    turns = np.ptp(matrices, axis=0).any() or not all(np.array_equal(row, rows[0]) for row in rows)
    varies = {kind: turns or usd_stage.may_vary(prim, kind) for kind in usd_stage.NAMES}
    part = _States(
        position=np.zeros((steps, count, 3), np.float32),
        opacity=np.zeros((steps, count), np.float32),
        scale=np.zeros((steps if varies["scale"] else 1, count, 3), np.float32),
        rotation=np.zeros((steps if varies["rotation"] else 1, count, 4), np.float32),
        color=np.zeros((count, 1, 3), np.float32),
        velocity=None if velocity is None else np.zeros((steps, count, 3), np.float32),
        present=np.zeros((steps, count), bool),
    )
    drifts = np.zeros_like(matrices)  # of the prim's space itself, per second
    if np.ptp(matrices, axis=0).any():
        drifts = np.gradient(matrices, clock.times_s, axis=0, edge_order=2 if steps > 2 else 1)
    brightest = np.full(count, -1.0)
    for k, (code, places, row) in enumerate(zip(clock.codes, position, rows, strict=True)):
        if not len(row):
            continue
        colored = not k or varies["harmonics"] or varies["colour"]
        state = usd_stage.read_state(prim, code, matrices[k], places, colored)
        part.present[k, row] = True
        part.position[k, row], part.opacity[k, row] = state["position"], state["opacity"]
        for name in ("scale", "rotation"):
            array = getattr(part, name)
            array[k if len(array) > 1 else 0, row] = state[name]
        if velocity is not None and part.velocity is not None:
            linear, drift = matrices[k, :3, :3] / clock.stretch, drifts[k]
            own = velocity[k] @ linear.T
            part.velocity[k, row] = own + places @ drift[:3, :3].T + drift[:3, 3]
        if colored:
            part.color = _brightest(part.color, brightest, row, state)
    notes += usd_stage.list_unsaid(prim, clock.codes[0])
    if not whole:
        part, dropped = _filled(part, clock.times_s)
        notes += dropped
    return part, [*notes, *_doubted(part, clock.times_s)]


def _ways(prim: Any, clock: _Clock) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray] | None, list[str]]:
    """Return places (n, 3) in the prim's space at every sample, the row (n,) of each, velocities (n, 3), and notes.

    Gaussians are followed by their ids; without ids by their order, where all samples hold as many. Where they do not,
    velocities must be there, and every sample has Gaussians of its own.

    Raises:
        DataFormatError: there are no places, an id occurs twice, or nothing says which Gaussian is which.
    """
    found = [usd_stage.read_values(prim, "position", code) for code in clock.codes]
    if all(values is None for values in found):
        raise DataFormatError(f"{prim.GetPath()}: has no 'positions'; export the splats again")
    position = [np.zeros((0, 3)) if values is None else values for values in found]
    sizes = [len(values) for values in position]
    samples, notes = list(zip(clock.codes, sizes, strict=True)), []
    stored = _at_all(prim, "velocity", samples, np.zeros((0, 3)))
    ids = _at_all(prim, "id", samples, np.zeros(0, np.int64))
    moved = len(set(sizes)) > 1 or any((values != position[0]).any() for values in position)
    if stored is not None and moved and not any(values.any() for values in stored):
        stored, notes = None, ["its velocities are all 0 although places change, and are left aside"]
    if ids is not None:
        rows = np.unique(np.concatenate(ids), return_inverse=True)[1].reshape(-1)
        parts = np.split(rows, np.cumsum(sizes)[:-1])
        for code, part in zip(clock.codes, parts, strict=True):
            if len(np.unique(part)) < len(part):
                raise DataFormatError(
                    f"{prim.GetPath()}: an id occurs twice at time code {code:g}; number the Gaussians"
                )
        return position, parts, stored, [*notes, "Gaussians followed by their ids"]
    if len(set(sizes)) == 1:
        return position, [np.arange(sizes[0])] * len(sizes), stored, notes
    problem = f"its samples hold {min(sizes)} to {max(sizes)} Gaussians and no ids"
    if stored is None:
        raise DataFormatError(
            f"{prim.GetPath()}: {problem}; differences need to know which is which: author 'primvars:id' or "
            "'velocities', or export the same Gaussians at all times, with opacity 0 where they are not seen"
        )
    starts = np.cumsum([0, *sizes[:-1]])
    return (
        position,
        [k + np.arange(n) for k, n in zip(starts, sizes, strict=True)],
        stored,
        [f"{problem}: new ones in each"],
    )


def _at_all(prim: Any, kind: str, samples: list[tuple[float, int]], none: np.ndarray) -> list[np.ndarray] | None:
    """Return what a prim says at each (time code, count), `none` where it has no Gaussian; None: not at all of them."""
    found = [usd_stage.read_values(prim, kind, code, count) if count else none for code, count in samples]
    known = [values for values in found if values is not None]
    return known if len(known) == len(found) else None


def _brightest(color: np.ndarray, brightest: np.ndarray, row: np.ndarray, state: dict[str, np.ndarray]) -> np.ndarray:
    """Return colours with those of rows that are more opaque in this state than before, whose opacities are noted."""
    fresh = state["color"]
    if color.shape[1] != fresh.shape[1]:
        color = np.zeros((len(color), *fresh.shape[1:]), np.float32)
    better = state["opacity"] > brightest[row]
    color[row[better]] = fresh[better]
    brightest[row[better]] = state["opacity"][better]
    return color


def _filled(part: _States, times_s: np.ndarray) -> tuple[_States, list[str]]:
    """Return places of Gaussians that a sample leaves out, with opacity 0: velocities where they are stay theirs.

    They go on as they went between the two samples nearest to it, or with their velocity there; in a gap, evenly.
    Those of one sample without a velocity are left out: nothing says how they move.
    """
    notes = []
    if part.velocity is None and (lonely := part.present.sum(0) < 2).any():
        notes = [f"{lonely.sum()} Gaussians of a single sample have no velocity, and are left out"]
        keep = np.flatnonzero(~lonely)
        arrays = {f: getattr(part, f)[:, keep] for f in ("position", "opacity", "scale", "rotation", "present")}
        part = replace(part, **arrays, color=part.color[keep])
    steps, rows = len(times_s), np.arange(part.position.shape[1])
    index = np.where(part.present, np.arange(steps)[:, None], -1)
    before = np.maximum.accumulate(index, 0)
    after = np.minimum.accumulate(np.where(part.present, np.arange(steps)[:, None], steps)[::-1], 0)[::-1]
    sampled = part.position.copy()
    for k in range(steps):
        for inner, edge in ((before, True), (after, False)):  # after the last sample; before the first
            at = np.flatnonzero((after[k] == steps) if edge else (before[k] < 0))
            near = inner[k, at]
            if part.velocity is not None:
                slope = part.velocity[near, at]
            else:
                far = before[np.maximum(near - 1, 0), at] if edge else after[np.minimum(near + 1, steps - 1), at]
                slope = (sampled[near, at] - sampled[far, at]) / (times_s[near] - times_s[far])[:, None]
            part.position[k, at] = sampled[near, at] + slope * (times_s[k] - times_s[near])[:, None]
        gap = np.flatnonzero(~part.present[k] & (before[k] >= 0) & (after[k] < steps))
        low, high = before[k, gap], after[k, gap]
        share = ((times_s[k] - times_s[low]) / (times_s[high] - times_s[low]))[:, None]
        part.position[k, gap] = (1 - share) * sampled[low, gap] + share * sampled[high, gap]
    nearest = np.where(before >= 0, before, after)
    for name in ("scale", "rotation", "velocity"):
        array = getattr(part, name)
        if array is not None and len(array) > 1:
            setattr(part, name, array[nearest, rows])
    return part, notes


def _doubted(part: _States, times_s: np.ndarray) -> list[str]:
    """Return a note where velocities that are stored say another thing than the places."""
    k = len(times_s) // 2
    first, last = max(k - 1, 0), min(k + 1, len(times_s) - 1)
    both = (part.present[[first, k, last]]).all(0)
    if part.velocity is None or not both.any():
        return []
    change = (part.position[last] - part.position[first])[both] / (times_s[last] - times_s[first])
    stored = part.velocity[k][both]
    longest = max(float(np.linalg.norm(change)), float(np.linalg.norm(stored)), 1e-12)
    off = np.linalg.norm(stored - change) / longest
    return (
        [f"its velocities differ from its places' differences by {off:.0%}, as those of gas may"] if off > LARGE else []
    )
