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

from gof.core.files import read_json, write_json
from tests.reliability import datasets, names, results, runs
from tests.reliability.damage import Instead, damaged, put
from tests.reliability.format import Format, finite

MEMORY = 2**30  # bytes beyond what the reader's libraries take
LIMIT_S = 10.0
START_S = 600.0  # of a machine at its limit
GOOD = ("accepted", "refused")
STEP = 100  # inputs after which a campaign writes down how far it is

# What most readers load: once, by the process that theirs are forked from. Nothing that starts a renderer's threads.
LOADED_ONCE = (
    "tests.reliability.fuzz",
    "gof.io.importers",
    "gof.evaluate.submission",
    "gof.look.report",
    "gof.look.boards",
    "gof.look.player.page",
    "gof.ingest.frame_times",
    "gof.reconstruct.captions",
    "gof.reconstruct.sanity",
    "gof_blender.pure.spec",
)


def formats() -> dict[str, Format]:
    """Return everything this software reads from outside, by name: small good samples, and their public readers."""
    return {**results.formats(), **datasets.formats(), **names.formats(), **runs.formats()}


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


def injury(format_name: str, files: list[Path], seed: int, number: int) -> tuple[Path, bytes | Instead]:
    """The one of a good sample's files that input `number` damages, and what is there then."""
    rng = np.random.default_rng([seed, crc32(format_name.encode()), number])
    file = files[rng.integers(len(files))]
    return file, damaged(str(file), file.read_bytes(), rng, formats()[format_name].injury)


def work(format_name: str, seed: int, numbers: range, connection) -> None:
    """Verdicts on some inputs, in a process of its own."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    form = formats()[format_name]
    with _scratch() as name:
        folder = Path(name)
        form.write(folder)
        files = form.files(folder)
        state = verdict(format_name, folder)
        if state[0] != "accepted":
            connection.send(f"the good sample is {state}")
            return
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY,) * 2)
        connection.send("ready")
        for number in numbers:
            file, content = injury(format_name, files, seed, number)
            good = file.read_bytes()
            put(file, content, folder)
            state, words = verdict(format_name, folder)
            changed = isinstance(content, Instead) or content != good
            put(file, good, folder)
            if state == "accepted" and changed and not form.believed:
                state, words = "believed", "what cannot be was accepted"
            connection.send((state, "" if state in GOOD else words))


def examine(format_name: str, seed: int, numbers: range, progress: Path | None = None) -> Tally:
    """All inputs of a format; a process that dies or does not answer is a failure, and another takes over.

    progress: a file to write after every `STEP` inputs, and to go on from.
    """
    tally = _tally_so_far(format_name, seed, progress)
    numbers = numbers[tally.verdicts.total() :]
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*LOADED_ONCE])
    while numbers:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=work, args=(format_name, seed, numbers, theirs), daemon=True)
        process.start()
        theirs.close()
        state, words, answer = "hang", "", "its reader does not start"
        if not ours.poll(START_S) or (answer := ours.recv()) != "ready":
            process.kill()
            raise RuntimeError(f"{format_name}: {answer}")
        try:
            while numbers and ours.poll(LIMIT_S):
                state, words = ours.recv()
                _count(tally, numbers[0], state, words)
                numbers, state = numbers[1:], "hang"
                if progress and tally.verdicts.total() % STEP == 0:
                    _write_down(tally, seed, progress)
        except EOFError:
            process.join()
            state, words = "crash", f"the process ended with {process.exitcode}"
        if numbers:
            _count(tally, numbers[0], state, words)
            numbers = numbers[1:]
        process.kill()
        process.join()
    if progress:
        _write_down(tally, seed, progress)
    return tally


def campaign(
    count: int, seed: int, jobs: int = 2, only: tuple[str, ...] = (), progress: Path | None = None
) -> list[Tally]:
    """About `count` inputs over all formats (or those named), `jobs` at a time.

    progress: a folder; a campaign of the same seed and count goes on from what one that was ended has left there.
    """
    chosen = {name: form.share for name, form in formats().items() if not only or name in only}
    total = sum(chosen.values())
    with ThreadPoolExecutor(jobs) as pool:
        running = [
            pool.submit(
                examine,
                name,
                seed,
                range(max(1, round(count * share / total))),
                progress and progress / f"{seed}-{crc32(name.encode()):08x}.json",
            )
            for name, share in chosen.items()
        ]
        return [job.result() for job in running]


def keep(tally: Tally, seed: int, folder: Path) -> None:
    """Write the inputs that failed to folder/FORMAT/NUMBER, the damaged file alone, with what was said."""
    for number, state, words in tally.failures:
        with _scratch() as name:
            form = formats()[tally.format]
            form.write(Path(name))
            file, content = injury(tally.format, form.files(Path(name)), seed, number)
            kept = folder / tally.format.replace("/", "_") / str(number)
            kept.mkdir(parents=True, exist_ok=True)
            (kept / file.name).write_bytes(content if isinstance(content, bytes) else repr(content).encode())
            (kept / "verdict.txt").write_text(f"{state}\n{file.relative_to(name)}\n{words}\n", errors="replace")


def _tally_so_far(format_name: str, seed: int, progress: Path | None) -> Tally:
    """What a campaign that was ended has counted."""
    if not progress or not progress.exists():
        return Tally(format_name)
    found = read_json(progress)
    if (found["format"], found["seed"]) != (format_name, seed):
        raise RuntimeError(f"{progress}: of another campaign; choose another --out")
    return Tally(format_name, Counter(found["verdicts"]), [tuple(failure) for failure in found["failures"]])


def _write_down(tally: Tally, seed: int, progress: Path) -> None:
    failures = [(number, state, words.encode(errors="replace").decode()) for number, state, words in tally.failures]
    write_json(progress, {"format": tally.format, "seed": seed, "verdicts": dict(tally.verdicts), "failures": failures})


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
