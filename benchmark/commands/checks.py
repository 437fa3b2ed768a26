"""Checks of Blender and its fire. The entry point `gof.checks` brings them into `gof doctor`."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import tempfile
from pathlib import Path

from gof.host import extras
from gof.host.checks import Check, Outcome, child, last_line
from gof_blender.pure import spec
from gof_blender.pure.spec import Domain, SceneSpec
from gof_blender.pure.timing import Clip

GENERATE = f"for `gof generate` and `gof demo`: {extras.command('blender')}"
SMALLEST = SceneSpec("doctor", clip=Clip(frames=1, warm_up_frames=2), domain=Domain(resolution=16), background="studio")


def check_openexr() -> Outcome:
    """Write and read back a small EXR."""
    if importlib.util.find_spec("OpenEXR") is None:
        return "missing", GENERATE
    import numpy as np
    import OpenEXR

    with tempfile.TemporaryDirectory() as folder:
        path, pixels = f"{folder}/a.exr", np.arange(12, dtype=np.float32).reshape(3, 4)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Z": pixels}).write(path)
        with OpenEXR.File(path) as file:
            same = np.array_equal(file.channels()["Z"].pixels, pixels)
    if not same:
        return "broken", "a written picture reads back differently; reinstall OpenEXR"
    return "ok", f"round trip exact (OpenEXR {importlib.metadata.version('OpenEXR')})"


def check_blender() -> Outcome:
    done = child("-c", "import bpy, os; print(bpy.app.version_string, flush=True); os._exit(0)")
    if done.returncode:
        why = last_line(done.stderr)
        if "No module named" in why:
            return "missing", GENERATE
        return (
            "broken",
            f"import bpy fails: {why}. A missing lib*.so comes from apt-get install (see tools/system_packages.sh)",
        )
    return "ok", f"Blender {done.stdout.strip().splitlines()[-1]} as a Python module"


def check_mantaflow() -> Outcome:
    """Return a real bake of three frames in a throw-away folder, with the worker that the generator uses."""
    if importlib.util.find_spec("bpy") is None:
        return "missing", GENERATE
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spec.json"
        spec.save(SMALLEST, path)
        done = child("-m", "gof_blender.worker.generate", "--spec", str(path), "--out", folder, "--stage", "bake")
    if done.returncode:
        why = last_line(done.stdout + done.stderr)
        return "broken", f"a 3-frame fire bake failed with status {done.returncode}: {why}"
    return "ok", "3 frames of fire baked"


CHECKS = (
    Check("OpenEXR", "linear pictures and depth of datasets", check_openexr, 40),
    Check("Blender", "scenes, cameras, rendering", check_blender, 50),
    Check("Mantaflow", "fire simulation and its velocities", check_mantaflow, 60),
)
