"""Worker that looks into a spec's .blend before anything is made of it.

    python -m gof_blender.worker.look --spec spec.json

Its last line on standard output is ``{"notes": [...]}``: what the maker of the scene should know (`pure.bodies`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..core.checked_json import SpecError
from ..pure import spec as scene_spec
from .reporter import exit_status, leave, run_alone


def main(argv: list[str] | None = None) -> int:
    """Look, and say what there is; returns the exit status, 2 where the spec or its .blend is wrong."""
    parser = argparse.ArgumentParser(prog="python -m gof_blender.worker.look", description=__doc__.split("\n")[0])
    parser.add_argument("--spec", type=Path, required=True, help="scene spec (JSON)")
    args = parser.parse_args(argv)

    def work() -> None:
        print(json.dumps({"notes": look(scene_spec.load(args.spec))}), flush=True)

    return exit_status(work, SpecError)


def look(spec: scene_spec.SceneSpec) -> list[str]:
    """Return notes on the surroundings, which are built as a dataset has them. Raises SpecError: see
    `build`."""
    import bpy
    from mathutils import Matrix

    from ..scene import bodies
    from ..scene.backgrounds import blend_file

    bpy.ops.wm.read_factory_settings(use_empty=True)
    collection = bpy.data.collections.new("Background")
    bpy.context.scene.collection.children.link(collection)
    blend_file.build(spec, collection)
    graph = bpy.context.evaluated_depsgraph_get()
    return bodies.notes(spec, graph, set(collection.objects), Matrix())


def run(argv: list[str]) -> None:
    """Run one look as the only work of this process, which ends when its parent does."""
    run_alone(main, argv)


if __name__ == "__main__":
    leave(main())
