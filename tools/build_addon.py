"""Build the add-on's zip: dist/gaussians_on_fire-VERSION.zip, the same bytes from the same sources.

    python tools/build_addon.py [--out DIR]

One top-level folder, as Blender's extensions (4.2 on) and its legacy add-ons (before) both take it.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "blender_addon"
CORE = ROOT / "gof" / "core"  # goes into the folder `core`, in place of what stands for it in a checkout
NAME = "gaussians_on_fire"
KINDS = {".py", ".toml"}
BESIDE = {"LICENSE"}
# The page that the add-on's Help opens, and the owner of the files of `core`.
ELSEWHERE = {ROOT / "docs" / "addon.md": "documentation.md", ROOT / "LICENSE": "core/LICENSE"}
EPOCH = (1980, 1, 1, 0, 0, 0)  # the first time a zip can hold


def constant(path: Path, name: str):
    """Return value of a module's top-level constant, without running the module."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and any(getattr(target, "id", None) == name for target in node.targets):
            return ast.literal_eval(node.value)
    raise SystemExit(f"{path}: no constant {name}")


def version() -> str:
    """Return the project's version, if all that name one agree. Raises SystemExit that says which does not."""
    manifest = (SOURCE / "blender_manifest.toml").read_text(encoding="utf-8")
    project = constant(ROOT / "gof" / "__init__.py", "__version__")
    named = {
        "blender_manifest.toml: version": re.search(r'^version = "(.*)"$', manifest, re.MULTILINE)[1],
        "__init__.py: bl_info['version']": ".".join(map(str, constant(SOURCE / "__init__.py", "bl_info")["version"])),
        "worker/generate.py: GENERATOR_VERSION": constant(SOURCE / "worker" / "generate.py", "GENERATOR_VERSION"),
    }
    for where, other in named.items():
        if other != project:
            raise SystemExit(f"blender_addon/{where} is {other}, gof.__version__ is {project}; make them agree")
    return project


def files() -> dict[Path, str]:
    """Return everything that belongs into the zip, and its name there. Raises SystemExit for a file of an unknown
    kind."""
    named = {
        path: path.relative_to(SOURCE).as_posix() for path in SOURCE.rglob("*") if SOURCE / "core" not in path.parents
    }
    named |= {path: f"core/{path.relative_to(CORE).as_posix()}" for path in CORE.rglob("*")}
    found = {path: name for path, name in named.items() if path.is_file() and "__pycache__" not in path.parts}
    strange = [path for path in found if path.suffix not in KINDS and path.name not in BESIDE]
    if strange:
        raise SystemExit(f"{strange[0]} is no file of the add-on; remove it, or add its kind to tools/build_addon.py")
    return found | ELSEWHERE


def build(folder: Path) -> Path:
    """Write the zip into `folder`; returns its path."""
    path = folder / f"{NAME}-{version()}.zip"
    folder.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    with zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, name in sorted(files().items(), key=lambda pair: Path(pair[1])):
            entry = zipfile.ZipInfo(f"{NAME}/{name}", EPOCH)
            entry.external_attr, entry.compress_type = 0o644 << 16, zipfile.ZIP_DEFLATED
            archive.writestr(entry, file.read_bytes())
    draft.replace(path)
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zip")
    path = build(parser.parse_args().out)
    print(f"{path} ({path.stat().st_size / 1000:.0f} kB, {len(files())} files)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
