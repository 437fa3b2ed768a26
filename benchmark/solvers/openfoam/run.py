"""Baking a fire: coarse mesh until the flame has developed, mapped to the fine mesh, a while to settle, then the clip.

    <out>/fire.json            the description, as baked
          coarse/, fine/       OpenFOAM cases; `log` in each holds what its programs said
          steps/               one empty file per finished step: a bake that was stopped goes on where it was
          grids/               what is handed over (`gof_benchmark.solvers.grids`)

The solver writes every field at every frame of the clip, so that a killed run goes on from the last whole frame.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gof.core.errors import DataFormatError, GofError, MissingDependencyError
from gof.core.files import only_run_in
from gof.core.records import read_record, write_record
from gof.host.processes import run, start
from gof.host.terminal import progress_bar
from gof_benchmark.solvers.grids import FireGrids
from gof_benchmark.solvers.openfoam.case import draught, write_case, write_control, write_fields
from gof_benchmark.solvers.openfoam.chemistry import species_of
from gof_benchmark.solvers.openfoam.dictionaries import END
from gof_benchmark.solvers.openfoam.fields import add_to_internal, grids_of
from gof_benchmark.solvers.openfoam.foam_fire import FoamFire

TIME = re.compile(r"^Time = (\S+)")
CPU = re.compile(r"^ExecutionTime = (\S+) s")


def bake(fire: FoamFire, out: Path, keep_raw: bool = False) -> FireGrids:
    """Bake a fire, or go on with it; returns its grids.

    Args:
        out: folder of this one bake.
        keep_raw: keep OpenFOAM's own fields of the clip (about 1 GB) when the grids are written.
    Raises:
        MissingDependencyError: OpenFOAM is not installed.
        DataFormatError: the folder holds another fire.
        GofError: a program of OpenFOAM failed (names its log), or another run works in the folder.
    """
    installation = find_installation()
    with only_run_in(out):
        _claim(fire, out)
        coarse, fine = out / "coarse", out / "fine"
        frame = 1 / fire.frame_rate_hz
        steps: list[tuple[str, Callable[[], None]]] = [
            ("coarse mesh", lambda: _mesh(installation, fire, coarse, "coarse")),
            ("warm-up", lambda: _solve(installation, fire, coarse, fire.warm_up_s, fire.warm_up_s / 20, "warm-up", 3)),
            ("fine mesh", lambda: _mesh(installation, fire, fine, "fine")),
            ("mapping", lambda: _map(installation, fire, coarse, fine)),
            ("settling", lambda: _solve(installation, fire, fine, fire.start_s, fire.settle_s / 10, "settling", 3)),
            ("clip", lambda: _solve(installation, fire, fine, fire.end_s, frame, "clip", 0)),
            ("grids", lambda: _hand_over(installation, fire, out)),
        ]  # fmt: skip
        for number, (name, work) in enumerate(steps):
            done = out / "steps" / f"{number}_{name.replace(' ', '_')}"
            if not done.exists():
                print(f"{fire.name}: {name}", file=sys.stderr, flush=True)
                work()
                done.parent.mkdir(exist_ok=True)
                done.touch()
        if not keep_raw:
            for folder in times_of(fine):
                shutil.rmtree(fine / folder)
        return FireGrids.open(out / "grids")


def _claim(fire: FoamFire, out: Path) -> None:
    """Write the description into the folder, or check that the one there is the same."""
    path = out / "fire.json"
    if path.exists() and read_record(FoamFire, path) != fire:
        raise DataFormatError(f"{path}: another fire was begun there; choose another --out, or remove the folder")
    write_record(path, fire)


def _mesh(installation: Installation, fire: FoamFire, case: Path, level: str) -> None:
    shutil.rmtree(case, ignore_errors=True)
    write_case(fire, case, level)
    write_control(case, fire, end_s=fire.warm_up_s, write_every_s=fire.warm_up_s)
    _run(installation, case, "blockMesh")
    _run(installation, case, "topoSet")
    _run(installation, case, "createPatch", "-overwrite")
    write_fields(fire, case, level)


def _map(installation: Installation, fire: FoamFire, coarse: Path, fine: Path) -> None:
    """Interpolate the developed flame to the fine mesh, at the same time of the solver's clock."""
    source = times_of(coarse)[-1]
    if abs(float(source) - fire.warm_up_s) > 1e-6:
        raise GofError(f"{coarse}: ends at {source} s, expected {fire.warm_up_s} s; remove the folder and its steps")
    for folder in times_of(fine):
        shutil.rmtree(fine / folder)
    shutil.copytree(fine / "0", fine / source)  # boundaries as written; the insides come from the coarse flame
    _run(installation, fine, "mapFields", "../coarse", "-consistent", "-sourceTime", source)
    # The coarse flame is too smooth to start swaying by itself; what shakes it is gone when the clip starts.
    add_to_internal(fine / source / "U", draught(fire, "fine"))


def _solve(
    installation: Installation, fire: FoamFire, case: Path, end_s: float, every_s: float, title: str, keep: int
) -> None:
    """Run fireFoam from the latest whole time to `end_s`, with a bar of simulated milliseconds."""
    drop_torn_times(fire, case)
    times = times_of(case)
    if not times and case.name == "fine":  # from 0 it would be another fire
        raise GofError(f"{case}: no whole time is left; remove the folders fine and steps/2* to steps/5* beside it")
    if times and float(times[-1]) > end_s - 1e-6:
        return
    write_control(case, fire, end_s, every_s, keep)
    with progress_bar(f"{fire.name} {title} (ms)", ticking=True) as update:
        for line in _lines(installation, case, "fireFoam"):
            if found := TIME.match(line):
                update(round(1e3 * float(found.group(1))), round(1e3 * end_s))


def _hand_over(installation: Installation, fire: FoamFire, out: Path) -> None:
    cpu_s = {level: round(cpu_seconds(out / level / "log"), 1) for level in ("coarse", "fine")}
    grids_of(fire, out, f"OpenFOAM {installation.version()} fireFoam", cpu_s)


def times_of(case: Path) -> list[str]:
    """Return names of a case's time folders after 0, in order."""
    names = [d.name for d in case.glob("*") if d.is_dir() and re.fullmatch(r"\d+(\.\d+)?(e-\d+)?", d.name)]
    return sorted((n for n in names if float(n) > 0), key=float)


def drop_torn_times(fire: FoamFire, case: Path) -> None:
    """Remove the last time folders as long as a kill left files of them out, or cut off."""
    needed = {"U", "T", "p", "p_rgh", "k", "nut", "alphat", "Qdot", *species_of(fire.gas)}
    for name in reversed(times_of(case)):
        files = [f for f in (case / name).iterdir() if f.is_file()]
        if needed <= {f.name for f in files} and all(map(_whole, files)):
            return
        shutil.rmtree(case / name)


def cpu_seconds(log: Path) -> float:
    """Return the CPU seconds of all runs of the solver that wrote to a case's log, also those that were killed."""
    total = last = 0.0
    for line in open(log, errors="replace") if log.exists() else ():
        if found := CPU.match(line):
            now = float(found.group(1))
            total, last = total + (now - last if now >= last else now), now
    return total


def _whole(file: Path) -> bool:
    with open(file, "rb") as stream:
        stream.seek(max(0, file.stat().st_size - 200))
        return END[:4].encode() in stream.read()


def _run(installation: Installation, case: Path, program: str, *arguments: str) -> None:
    for _ in _lines(installation, case, program, *arguments):
        pass


def _lines(installation: Installation, case: Path, program: str, *arguments: str):
    """Run a program of OpenFOAM in a case; yields its lines, and appends them to the case's log.

    Raises:
        GofError: it failed; the message holds its last lines.
    """
    log, last = case / "log", []
    child = start(
        [installation.program(program), *arguments],
        cwd=case,
        env=installation.environment(case),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    try:
        with open(log, "a", encoding="utf-8") as file:
            for line in child.stdout:
                file.write(line)
                last = [*last[-30:], line]
                yield line
        status = child.wait()
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()
    if status:
        raise GofError(f"{program} in {case} ended with status {status} (whole log: {log}):\n{''.join(last)}")


# ----------------------------------------------------------------
# Where OpenFOAM is installed, and how to start its programs.

HINT = (
    "fireFoam of OpenFOAM (com) is needed to bake this fire: on Debian or Ubuntu `apt-get install openfoam`; "
    "elsewhere source OpenFOAM's etc/bashrc first (it sets PATH and WM_PROJECT_DIR)"
)


@dataclass(frozen=True)
class Installation:
    """Programs and data of one OpenFOAM.

    Args:
        programs: folder of blockMesh, fireFoam and the others.
        project: folder that holds `etc/controlDict`, what OpenFOAM calls WM_PROJECT_DIR.
    """

    programs: Path
    project: Path

    def program(self, name: str) -> str:
        """Return path of a program. Raises MissingDependencyError when this OpenFOAM lacks it."""
        path = self.programs / name
        if not path.exists():
            raise MissingDependencyError(f"{path}: this OpenFOAM has no {name}. {HINT}")
        return str(path)

    def environment(self, folder: Path) -> dict[str, str]:
        """Variables of a program that is started in `folder`; the distribution's package sets none by itself."""
        return os.environ | {"WM_PROJECT_DIR": str(self.project), "PWD": str(folder.resolve())}

    def version(self) -> str:
        """For example "1912 (patch=200626)"; "unknown" when the solver's help does not say."""
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
        text = run([self.program("fireFoam"), "-help"], env=self.environment(Path()), **pipes).stdout
        found = re.search(r"Using: OpenFOAM\S* \(([^)]*)\)", text), re.search(r"Build: *(\S.*)", text)
        return " ".join(m.group(1).strip() for m in found if m) or "unknown"


def find_installation() -> Installation:
    """Return the OpenFOAM of this shell (WM_PROJECT_DIR), or else the one whose fireFoam is on PATH.

    Raises:
        MissingDependencyError: none is installed, or its data cannot be found; says what to install.
    """
    fire_foam = shutil.which("fireFoam")
    if not fire_foam:
        raise MissingDependencyError(f"fireFoam is not on PATH. {HINT}")
    programs = Path(fire_foam).parent
    sourced = os.environ.get("WM_PROJECT_DIR")
    # The distribution keeps the data beside the programs: <prefix>/bin and <prefix>/share/openfoam.
    candidates = ([Path(sourced)] if sourced else []) + [programs.parent / "share" / "openfoam"]
    for project in candidates:
        if (project / "etc" / "controlDict").exists():
            return Installation(programs, project)
    raise MissingDependencyError(f"{candidates[0]}: no etc/controlDict of OpenFOAM there. {HINT}")
