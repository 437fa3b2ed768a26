"""A look into a spec's .blend by a Blender process of its own, before anything is made of it."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

from ..core.checked_json import SpecError
from . import spec as scene_spec
from .child import JobError, code
from .spec import SceneSpec

WRONG = 2  # exit status of the worker where the spec or its .blend is wrong


def notes(spec: SceneSpec, python: list[str]) -> list[str]:
    """What the maker of the scene should know of its objects (`pure.bodies`); nothing without a .blend.

    Args:
        python: a command that runs the Python code given as its next argument, in a Blender without a window.
    Raises:
        SpecError: the .blend cannot be the surroundings, and why.
        JobError: the process failed.
    """
    if not spec.blend_file:
        return []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spec.json"
        scene_spec.save(spec, path)
        command = [*python, code("look", ["--spec", str(path)])]
        status, out, errors = _run(command, Path(folder))
    last = (errors if status else out).strip().splitlines()[-1:] or [""]
    if status == WRONG:
        raise SpecError(last[0])
    if status:
        raise JobError(f"looking into {spec.blend_file.path} failed with status {status}: {last[0]}")
    said = [line for line in out.splitlines() if line.startswith('{"notes"')]
    return json.loads(said[-1])["notes"]


def _run(command: list[str], folder: Path) -> tuple[int, str, str]:
    """Status, output and errors. The process ends with its standard input, hence with this one; a folder for files."""
    with (folder / "out").open("wb") as out, (folder / "errors").open("wb") as errors:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out, stderr=errors) as process:
            process.wait()
    texts = ((folder / name).read_text(encoding="utf-8", errors="replace") for name in ("out", "errors"))
    return process.returncode, *texts
