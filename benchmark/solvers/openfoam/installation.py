"""Where OpenFOAM is installed, and how to start its programs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from gof.core.errors import MissingDependencyError
from gof.host.processes import run

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
        """Path of a program. Raises MissingDependencyError when this OpenFOAM lacks it."""
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
    """The OpenFOAM of this shell (WM_PROJECT_DIR), or else the one whose fireFoam is on PATH.

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
