"""The built-in scenes: one folder each with its spec, and by name or by file to a checked `SceneSpec`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gof.core import ladder
from gof.core.errors import GofError
from gof.core.files import only_run_in
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from gof_blender.pure.presets import FORMER, PRESETS
from gof_blender.pure.spec import SceneSpec, SpecError

FOLDER = Path(__file__).parent


def built_in_scenes() -> list[str]:
    """Return names of the built-in scenes."""
    return sorted(path.parent.name for path in FOLDER.glob("*/spec.json"))


def load_scene(scene: str, preset: str | None = None) -> SceneSpec:
    """Return the spec of a file or of a built-in scene, with a cost preset applied.

    Raises:
        GofError: no such file or scene, a field of the spec is wrong, or the grids it burns are (names it).
    """
    path = FOLDER / scene / "spec.json" if scene in built_in_scenes() else Path(scene)
    if not path.is_file():
        raise GofError(f"'{scene}' is neither a spec file nor a built-in scene ({', '.join(built_in_scenes())})")
    try:
        spec = scene_spec.load(path)
        spec = spec.with_preset(_today(preset)) if preset else spec
        _ = spec.box  # opens what it burns
        return spec
    except SpecError as error:
        raise GofError(str(error)) from error


def _today(preset: str) -> str:
    """Return the name of a preset; says so where it is an old one. Raises GofError: there is none of that name."""
    return ladder.preset(preset, {name: name for name in PRESETS}, {name: name for name in FORMER})


def claim(layout: Layout, spec: SceneSpec) -> None:
    """Make the folder this spec's, or check that it is.

    Raises:
        GofError: the folder was made from another spec, or holds other things.
    """
    try:
        layout.claim(spec)
    except SpecError as error:
        raise GofError(f"{error} (--out)") from error


@contextmanager
def claimed(layout: Layout, spec: SceneSpec) -> Iterator[None]:
    """Hold the folder for this run, and claim it: in this order, or two first runs could both claim it.

    Raises:
        GofError: another run works there, or see `claim`; nothing is written into a folder that holds other things.
    """
    try:
        layout.require_free(spec)
    except SpecError as error:
        raise GofError(f"{error} (--out)") from error
    with only_run_in(layout.hidden):
        claim(layout, spec)
        yield
