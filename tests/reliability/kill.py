"""kill -9 at random moments: the same command must finish what it left.

It must not make, lose or spoil a finished file while it does.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gof.host.processes import python_command

MADE_ONCE = (
    "cameras/*/rgb/0*.png",
    "cameras/*/mask/0*.png",
    "cameras/*/exr/0*.exr",
    "static/*",
    "velocity.zarr/**/*",
    "dataset.json",
)
RESULT = ("result.npz", "result.ply", "plates/*.png")
Files = dict[str, tuple[int, str]]
"""By name: time of writing, ns; digest of the content."""


@dataclass(frozen=True)
class ResumableCommand:
    """A `gof` command: its arguments without --out, and the files that are finished once they have their name."""

    name: str
    arguments: tuple[str, ...]
    finished: tuple[str, ...]

    def start(self, out: Path) -> subprocess.Popen:
        out.parent.mkdir(parents=True, exist_ok=True)
        with open(out.with_suffix(".log"), "ab") as log:
            command = python_command("-m", "gof", *self.arguments, "--out", str(out))
            return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)

    def files(self, out: Path) -> Files:
        """What is finished."""
        found = {path for pattern in self.finished for path in out.glob(pattern)}
        finished = sorted(p for p in found if p.is_file() and not p.name.startswith(".") and complete(p))
        return {str(p.relative_to(out)): (p.stat().st_mtime_ns, digest(p)) for p in finished}


@dataclass
class Outcome:
    """What the campaign saw."""

    command: str
    length_s: float = 0.0
    """Of an uninterrupted run."""
    kills: int = 0
    finished_runs: int = 0
    kept: int = 0
    """Finished files that kills left, added up; each was looked at again after the next run."""
    rewritten: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    spoilt: list[str] = field(default_factory=list)
    """Files under their final name whose content is not that of the uninterrupted run."""
    failures: list[str] = field(default_factory=list)
    difference: float = 0.0
    """Largest difference of a result's values from the uninterrupted run's, relative to their spread; results only."""

    def faults(self) -> dict[str, list[str]]:
        return {name: getattr(self, name) for name in ("rewritten", "lost", "spoilt", "failures")}


def complete(path: Path) -> bool:
    """A picture is finished with its EXR, which is written last."""
    folder = path.parent.with_name("exr") if path.parent.name in ("rgb", "mask") else path.parent
    return path.suffix != ".png" or path.parent.name == "plates" or (folder / path.name).with_suffix(".exr").is_file()


def digest(path: Path) -> str:
    """Of the content as readers see it: pixels, arrays, JSON without provenance; "unreadable" where they cannot."""
    try:
        if path.suffix == ".exr":
            import OpenEXR

            with OpenEXR.File(str(path), separate_channels=True) as file:
                data = b"".join(np.ascontiguousarray(c.pixels).tobytes() for _, c in sorted(file.channels().items()))
        elif path.suffix == ".png":
            import cv2

            data = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).tobytes()
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                data = b"".join(arrays[name].tobytes() for name in sorted(arrays.files))
        else:
            data = path.read_bytes()
    except Exception:
        return "unreadable"
    return hashlib.sha256(data).hexdigest()[:16]


def campaign(command: ResumableCommand, kills: int, seed: int, folder: Path) -> Outcome:
    """Kill the command `kills` times, at moments spread over the length of an uninterrupted run."""
    rng = random.Random(seed)
    outcome = Outcome(command.name)
    whole = folder / command.name / "whole"
    outcome.length_s = _run_uninterrupted(command, whole)
    truth = command.files(whole)
    while outcome.kills < kills:
        out = folder / command.name / f"run{outcome.finished_runs}"
        _run_with_kills(command, out, truth, kills, rng, outcome)
        outcome.difference = max(outcome.difference, difference(whole, out))
        outcome.finished_runs += 1
    return outcome


def _run_uninterrupted(command: ResumableCommand, out: Path) -> float:
    begin = time.perf_counter()
    if command.start(out).wait():
        raise RuntimeError(f"{command.name}: the uninterrupted run failed, see {out.with_suffix('.log')}")
    return time.perf_counter() - begin


def _run_with_kills(
    command: ResumableCommand, out: Path, truth: Files, kills: int, rng: random.Random, outcome: Outcome
) -> None:
    """Start the command again until it ends by itself; look at its files after every kill."""
    files: Files = {}
    status = None
    while status is None:
        process = command.start(out)
        try:
            status = process.wait(rng.uniform(0, outcome.length_s) if outcome.kills < kills else None)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            outcome.kills += 1
        files = compare(command, out, files, truth, outcome)
        done = f"{outcome.kills} kills, {outcome.finished_runs} runs finished, {len(files)} files done"
        print(f"{command.name}: {done}", file=sys.stderr, flush=True)
    if status:
        last_words = out.with_suffix(".log").read_text(errors="replace")[-500:]
        outcome.failures.append(f"{out}: status {status}\n{last_words}")
    outcome.lost += [f"{out.name}/{name}" for name in truth.keys() - files.keys()]


def compare(command: ResumableCommand, out: Path, before: Files, truth: Files, outcome: Outcome) -> Files:
    """Add to the outcome what happened to the files that were there `before`; returns those that are there now."""
    now = command.files(out)
    outcome.kept += len(before)
    outcome.rewritten += [f"{out.name}/{name}" for name in before if name in now and now[name][0] != before[name][0]]
    outcome.lost += [f"{out.name}/{name}" for name in before if name not in now]
    for name, (_, content) in now.items():
        if name.endswith((".npz", ".ply")) or name.startswith("plates/"):
            continue  # compared as numbers
        if content != truth.get(name, (0, ""))[1] and f"{out.name}/{name}" not in outcome.spoilt:
            outcome.spoilt.append(f"{out.name}/{name}")
    return now


def difference(a: Path, b: Path) -> float:
    """Largest relative difference of two reconstructions' values.

    Of each array, the root mean square of the difference over its spread.
    """
    if not (a / "result.npz").is_file():
        return 0.0
    with np.load(a / "result.npz") as first, np.load(b / "result.npz") as second:
        names = [n for n in first.files if first[n].dtype.kind == "f"]
        if any(first[n].shape != second[n].shape for n in names):
            return float("inf")
        pairs = [(first[n].astype(float), second[n].astype(float)) for n in names]
    return max(float(np.sqrt(np.mean((x - y) ** 2)) / max(x.std(), 1e-12)) for x, y in pairs)


def commands(folder: Path) -> list[ResumableCommand]:
    """Generation of the toy scene, and the reconstruction of that dataset."""
    dataset = folder / "generate" / "whole"
    reconstruct = ("reconstruct", str(dataset), "--gaussians", "300", "--steps", "600", "--voxels", "16")
    return [
        ResumableCommand("generate", ("generate", "demo", "--preset", "toy"), MADE_ONCE),
        ResumableCommand("reconstruct", reconstruct, RESULT),
    ]


def report(outcome: Outcome) -> str:
    """A row of the table, and below it what went wrong."""
    counts = " | ".join(str(len(faults)) for faults in outcome.faults().values())
    row = (
        f"| {outcome.command} | {outcome.length_s:.0f} s | {outcome.kills} | {outcome.finished_runs} | "
        f"{outcome.kept} | {counts} | {outcome.difference:.2g} |"
    )
    faults = [f"{name}: {json.dumps(found[:20], indent=1)}" for name, found in outcome.faults().items() if found]
    return "\n".join([row, *faults])
