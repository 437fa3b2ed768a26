"""kill -9 at random moments: the same command must finish what it left, without making, losing or spoiling a finished file."""

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

MADE_ONCE = (
    "cameras/*/rgb/0*.png",
    "cameras/*/mask/0*.png",
    "cameras/*/exr/0*.exr",
    "static/*",
    "velocity.zarr/**/*",
    "dataset.json",
)
RESULT = ("result.npz", "result.ply", "plates/*.png")


@dataclass(frozen=True)
class Job:
    """A command that resumes: its arguments without --out, and the files that are finished once they have their name."""

    name: str
    arguments: tuple[str, ...]
    finished: tuple[str, ...]

    def start(self, out: Path) -> subprocess.Popen:
        out.parent.mkdir(parents=True, exist_ok=True)
        with open(out.with_suffix(".log"), "ab") as log:
            command = [sys.executable, "-m", "gof", *self.arguments, "--out", str(out)]
            return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)

    def files(self, out: Path) -> dict[str, tuple[int, str]]:
        """(time of writing, digest of the content) of what is finished."""
        found = sorted(
            {
                p
                for pattern in self.finished
                for p in out.glob(pattern)
                if p.is_file() and not p.name.startswith(".") and complete(p)
            }
        )
        return {str(p.relative_to(out)): (p.stat().st_mtime_ns, digest(p)) for p in found}


@dataclass
class Record:
    """What the campaign saw."""

    job: str
    kills: int = 0
    finished_runs: int = 0
    kept: int = 0
    """Finished files that kills left, added up; each was looked at again after the next run."""
    rewritten: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    spoilt: list[str] = field(default_factory=list)
    """Files under their final name whose content is not that of the uninterrupted run."""
    difference: float = 0.0
    """Largest difference of a result's values from the uninterrupted run's, relative to their spread; results only."""
    failures: list[str] = field(default_factory=list)


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


def campaign(job: Job, kills: int, seed: int, folder: Path) -> tuple[Record, float]:
    """Kill the job `kills` times, at moments spread over the length of an uninterrupted run. Returns that length in s, too."""
    rng, record = random.Random(seed), Record(job.name)
    begin = time.perf_counter()
    whole = job.start(folder / job.name / "whole")
    if whole.wait():
        raise RuntimeError(f"{job.name}: the uninterrupted run failed, see {folder / job.name / 'whole.log'}")
    length = time.perf_counter() - begin
    truth = job.files(folder / job.name / "whole")
    while record.kills < kills:
        out, before = folder / job.name / f"run{record.finished_runs}", {}
        status = None
        while status is None:
            process = job.start(out)
            try:
                status = process.wait(rng.uniform(0, length) if record.kills < kills else None)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                record.kills += 1
            before = _compare(job, out, before, truth, record)
            print(
                f"{job.name}: {record.kills} kills, {record.finished_runs} runs finished, {len(before)} files done",
                file=sys.stderr,
                flush=True,
            )
        if status:
            record.failures.append(
                f"{out}: status {status}\n{out.with_suffix('.log').read_text(errors='replace')[-500:]}"
            )
        record.lost += [f"{out.name}/{name}" for name in truth.keys() - before.keys()]
        record.difference = max(record.difference, difference(folder / job.name / "whole", out))
        record.finished_runs += 1
    return record, length


def _compare(job: Job, out: Path, before: dict, truth: dict, record: Record) -> dict:
    now = job.files(out)
    record.kept += len(before)
    record.rewritten += [f"{out.name}/{name}" for name in before if name in now and now[name][0] != before[name][0]]
    record.lost += [f"{out.name}/{name}" for name in before if name not in now]
    for name, (_, content) in now.items():
        if name.endswith((".npz", ".ply")) or name.startswith("plates/"):
            continue  # compared as numbers
        if content != truth.get(name, (0, ""))[1] and f"{out.name}/{name}" not in record.spoilt:
            record.spoilt.append(f"{out.name}/{name}")
    return now


def difference(a: Path, b: Path) -> float:
    """Largest relative difference of two reconstructions' values: of each array, the root mean square of the difference over its spread."""
    if not (a / "result.npz").is_file():
        return 0.0
    with np.load(a / "result.npz") as first, np.load(b / "result.npz") as second:
        names = [n for n in first.files if first[n].dtype.kind == "f"]
        if any(first[n].shape != second[n].shape for n in names):
            return float("inf")
        pairs = [(first[n].astype(float), second[n].astype(float)) for n in names]
    return max(float(np.sqrt(np.mean((x - y) ** 2)) / max(x.std(), 1e-12)) for x, y in pairs)


def jobs(folder: Path) -> list[Job]:
    """Generation of the toy scene, and the reconstruction of that dataset."""
    dataset = folder / "generate" / "whole"
    reconstruct = ("reconstruct", str(dataset), "--gaussians", "300", "--iterations", "600", "--voxels", "16")
    return [
        Job("generate", ("generate", "demo", "--preset", "toy"), MADE_ONCE),
        Job("reconstruct", reconstruct, RESULT),
    ]


def report(record: Record, length: float) -> str:
    bad = {name: getattr(record, name) for name in ("rewritten", "lost", "spoilt", "failures")}
    lines = [
        f"| {record.job} | {length:.0f} s | {record.kills} | {record.finished_runs} | {record.kept} | "
        + " | ".join(str(len(v)) for v in bad.values())
        + f" | {record.difference:.2g} |"
    ]
    return "\n".join(lines + [f"{name}: {json.dumps(value[:20], indent=1)}" for name, value in bad.items() if value])
