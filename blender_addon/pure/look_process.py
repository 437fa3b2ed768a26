"""A look into a spec's .blend by a Blender process of its own, before anything is made of it."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

from . import spec as scene_spec
from .checked_json import SpecError
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
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", stdin=subprocess.DEVNULL)
    last = (done.stderr if done.returncode else done.stdout).strip().splitlines()[-1:] or [""]
    if done.returncode == WRONG:
        raise SpecError(last[0])
    if done.returncode:
        raise JobError(f"looking into {spec.blend_file.path} failed with status {done.returncode}: {last[0]}")
    said = [line for line in done.stdout.splitlines() if line.startswith('{"notes"')]
    return json.loads(said[-1])["notes"]
