"""A toy scene, and scripts run in a Blender process of their own."""

import json
import os
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import numpy as np
import OpenEXR

from gof_blender.pure.spec import Domain, Render, SceneSpec
from gof_blender.pure.timing import Clip

TOY = SceneSpec(
    "toy",
    seed=3,
    clip=Clip(frames=5, fps=60.0, warm_up_frames=14),
    domain=Domain(resolution=20),
    render=Render(percentage=6, samples=1, plate_samples=2, denoise=False),
    background="studio",
)


ADDON = Path(__file__).resolve().parents[2] / "blender_addon"


def in_blender(script: str, *args, python: str = sys.executable) -> dict:
    """Run a script in its own Blender process, of this or of another Python; it puts its findings into ``result``."""
    code = "import json, sys, bpy\nfrom gof_blender.scene import mantaflow\nresult = {}\n" + textwrap.dedent(script)
    code += "\nprint('RESULT' + json.dumps(result))\nmantaflow.leave()"
    with tempfile.TemporaryDirectory() as folder:  # Mantaflow leaves files where it runs
        command, environment = [python, "-c", code, *map(str, args)], dict(os.environ)
        if python != sys.executable:
            (Path(folder) / "gof_blender").symlink_to(ADDON)
            command[1:1] = ["-W", "error::DeprecationWarning:gof_blender"]
            environment["PYTHONPATH"] = folder
        run = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)
    assert run.returncode == 0, run.stderr
    return json.loads(next(line for line in run.stdout.splitlines() if line.startswith("RESULT"))[6:])


def channels(path: Path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}
