"""The meaning of files: `gof/core`, the same files under a name of the add-on's own, as Blender's Python has no `gof`.

An installed package and the add-on's zip hold those files here, in place of this one (setup.py, tools/build_addon.py).
In a checkout they stand beside the add-on, also where Blender opens it through a link.
"""

from pathlib import Path

__path__.append(str(Path(__file__).resolve().parents[2] / "gof" / "core"))
