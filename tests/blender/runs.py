"""A toy scene, and scripts run in a Blender process of their own."""

import json
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


def in_blender(script: str, *args) -> dict:
    """Run a script in its own Blender process; it puts its findings into ``result``."""
    code = "import json, sys, bpy\nfrom gof_blender.scene import mantaflow\nresult = {}\n" + textwrap.dedent(script)
    code += "\nprint('RESULT' + json.dumps(result))\nmantaflow.leave()"
    with tempfile.TemporaryDirectory() as folder:  # Mantaflow leaves files where it runs
        run = subprocess.run([sys.executable, "-c", code, *map(str, args)], capture_output=True, text=True, cwd=folder)
    assert run.returncode == 0, run.stderr
    return json.loads(next(line for line in run.stdout.splitlines() if line.startswith("RESULT"))[6:])


def channels(path: Path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}
