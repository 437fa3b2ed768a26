"""Damaged files through every reader: each must give a finite result or a named error, within its time and memory."""

from __future__ import annotations

import multiprocessing
import os
import resource
import tempfile
import traceback
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from zlib import crc32

import numpy as np

from gof_benchmark.evidence.reliability.damage import damaged
from gof_benchmark.evidence.reliability.formats import finite, formats

MEMORY = 2**30  # bytes beyond what the reader's libraries take
LIMIT_S = 10.0
START_S = 120.0
GOOD = ("accepted", "refused")


@dataclass
class Tally:
    """What became of the inputs of a format. failures: (number of the input, verdict, text)."""

    format: str
    verdicts: Counter = field(default_factory=Counter)
    failures: list[tuple[int, str, str]] = field(default_factory=list)


def verdict(format_name: str, folder: Path) -> tuple[str, str]:
    """Read a folder's sample.

    Returns:
        "accepted", "refused", or one of the failures "memory", "exception", "not finite", "unnamed"; and what was said.
    """
    form = formats()[format_name]
    try:
        result = form.read(folder)
    except form.refusals as e:
        if isinstance(e.__cause__ or e.__context__, MemoryError):
            return "memory", str(e)
        return ("refused", str(e)) if not form.named or str(folder) in str(e) else ("unnamed", traceback.format_exc())
    except MemoryError:
        return "memory", traceback.format_exc()
    except Exception:
        return "exception", traceback.format_exc()
    return ("accepted", "") if finite(result) else ("not finite", repr(result)[:2000])


def injury(format_name: str, folder: Path, seed: int, number: int) -> tuple[Path, bytes]:
    """The file of a good sample that input `number` damages, and its content then."""
    rng = np.random.default_rng([seed, crc32(format_name.encode()), number])
    form = formats()[format_name]
    files = sorted(p for p in folder.glob(form.damage) if p.is_file())
    file = files[rng.integers(len(files))]
    return file, damaged(str(file), file.read_bytes(), rng, form.injury)


def work(format_name: str, seed: int, numbers: range, connection) -> None:
    """Verdicts on some inputs, in a process of its own."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    with _scratch() as name:
        folder = Path(name)
        formats()[format_name].write(folder)
        state = verdict(format_name, folder)
        if state[0] != "accepted":
            connection.send(f"the good sample is {state}")
            return
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY,) * 2)
        connection.send("ready")
        for number in numbers:
            file, content = injury(format_name, folder, seed, number)
            good = file.read_bytes()
            file.write_bytes(content)
            state, words = verdict(format_name, folder)
            file.write_bytes(good)
            connection.send((state, "" if state in GOOD else words))


def examine(format_name: str, seed: int, numbers: range) -> Tally:
    """All inputs of a format; a process that dies or does not answer is a failure, and another takes over."""
    tally = Tally(format_name)
    context = multiprocessing.get_context("spawn")
    while numbers:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=work, args=(format_name, seed, numbers, theirs), daemon=True)
        process.start()
        theirs.close()
        state, words, answer = "hang", "", "its reader does not start"
        if not ours.poll(START_S) or (answer := ours.recv()) != "ready":
            raise RuntimeError(f"{format_name}: {answer}")
        try:
            while numbers and ours.poll(LIMIT_S):
                state, words = ours.recv()
                _count(tally, numbers[0], state, words)
                numbers, state = numbers[1:], "hang"
        except EOFError:
            process.join()
            state, words = "crash", f"the process ended with {process.exitcode}"
        if numbers:
            _count(tally, numbers[0], state, words)
            numbers = numbers[1:]
        process.kill()
        process.join()
    return tally


def campaign(count: int, seed: int, jobs: int = 2, only: tuple[str, ...] = ()) -> list[Tally]:
    """About `count` inputs over all formats (or those named), `jobs` at a time."""
    chosen = {name: form.share for name, form in formats().items() if not only or name in only}
    total = sum(chosen.values())
    with ThreadPoolExecutor(jobs) as pool:
        running = [
            pool.submit(examine, name, seed, range(max(1, round(count * share / total))))
            for name, share in chosen.items()
        ]
        return [job.result() for job in running]


def keep(tally: Tally, seed: int, folder: Path) -> None:
    """Write the inputs that failed to folder/FORMAT/NUMBER, the damaged file alone, with what was said."""
    for number, state, words in tally.failures:
        with _scratch() as name:
            formats()[tally.format].write(Path(name))
            file, content = injury(tally.format, Path(name), seed, number)
            kept = folder / tally.format.replace("/", "_") / str(number)
            kept.mkdir(parents=True, exist_ok=True)
            (kept / file.name).write_bytes(content)
            (kept / "verdict.txt").write_text(f"{state}\n{file.relative_to(name)}\n{words}\n", errors="replace")


def table(tallies: list[Tally]) -> str:
    """Markdown: inputs, accepted, refused and failures of each format."""
    rows = ["| format | inputs | accepted | refused | failures |", "|---|---|---|---|---|"]
    total = Counter()
    for tally in [*tallies, None]:
        seen = tally.verdicts if tally else total
        total += seen if tally else Counter()
        bad = ", ".join(f"{n} {state}" for state, n in sorted(seen.items()) if state not in GOOD) or "0"
        name = tally.format if tally else "**all**"
        rows.append(f"| {name} | {seen.total()} | {seen['accepted']} | {seen['refused']} | {bad} |")
    return "\n".join(rows)


def _count(tally: Tally, number: int, state: str, words: str) -> None:
    tally.verdicts[state] += 1
    if state not in GOOD:
        tally.failures.append((number, state, words))


def _scratch() -> tempfile.TemporaryDirectory:
    """A folder in memory where there is one."""
    return tempfile.TemporaryDirectory(prefix="gof-fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None)
