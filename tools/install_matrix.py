"""Prove that the package installs: build the wheel, install it in fresh environments, run its tests there.

    python tools/install_matrix.py python3.10 python3.13 --numpy "<2" --numpy ">=2"
    python tools/install_matrix.py python3.11 --sizes           what each extra adds, in MB and seconds

The tests run beside the wheel, without the sources, so what they import is what was installed. Prints the tables of
docs/install.md. Needs pip's ways to its packages, and some GB of disk in the folder for temporary files.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NAME = "gaussians-on-fire"
# The evaluator, the importers, the renderer, files, the command line: what `pip install gaussians-on-fire` is for.
PARTS = ["evaluate", "render", "io", "look", "test_cli.py", "test_dataset.py", "test_fields.py", "test_gaussians.py"]
PARTS += ["test_install.py", "test_names.py", "test_ply.py", "test_portable.py", "test_zarr_array.py"]
TOOLS = [
    "pytest",
    "pytest-timeout",
    "pytest-xdist",
    "hypothesis",
    "mitsuba>=3.9,<3.10",
]
MARKS = "not slow and not blender and not gpu and not checkout"


def tracked() -> list[str]:
    """Return the files that git has, or would have; those of today, whatever was committed."""
    done = run(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT)
    return sorted(line for line in done.splitlines() if (ROOT / line).is_file())


def build(folder: Path) -> tuple[Path, Path]:
    """Wheel and sdist of a copy of the tracked files: nothing that lies about here gets in."""
    source = folder / "source"
    for line in tracked():
        (source / line).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / line, source / line)
    code = f"import setuptools.build_meta as b; b.build_sdist({str(folder)!r}); b.build_wheel({str(folder)!r})"
    run([sys.executable, "-c", code], cwd=source)
    shutil.rmtree(source)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def environment(folder: Path, python: str) -> Path:
    """Return the Python of a fresh environment with a new pip."""
    run([python, "-m", "venv", str(folder)])
    inside = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    run([str(inside), "-m", "pip", "install", "--quiet", "--upgrade", "pip>=24"])
    return inside


def install(python: Path, *requirements: str) -> float:
    """Return seconds that pip took."""
    start = time.perf_counter()
    run([str(python), "-m", "pip", "install", "--quiet", *requirements])
    return time.perf_counter() - start


def size_mb(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) / 2**20


def matrix(wheel: Path, folder: Path, pythons: list[str], numpys: list[str]) -> None:
    print("| Python | numpy | scipy | OpenCV | what the tests said |\n|---|---|---|---|---|")
    for number, (python, numpy) in enumerate((p, n) for p in pythons for n in numpys):
        place = folder / f"environment{number}"
        inside = environment(place, python)
        install(inside, str(wheel), f"numpy{numpy}", *TOOLS)
        print(f"| {' | '.join([*versions(inside), tests(inside, folder / f'tests{number}')])} |", flush=True)
        shutil.rmtree(place)


def versions(python: Path) -> list[str]:
    code = "import platform, numpy, scipy, cv2; print(platform.python_version(), numpy.__version__, scipy.__version__, "
    return run([str(python), "-c", code + "cv2.__version__)"]).split()


def tests(python: Path, folder: Path) -> str:
    """Return the last line of pytest, without its time; all of its output is beside the tests."""
    shutil.copytree(ROOT / "tests", folder / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy2(ROOT / "pyproject.toml", folder)
    parts = [f"tests/{name}" for name in PARTS if (ROOT / "tests" / name).exists()]
    command = [str(python), "-m", "pytest", "-q", "-m", MARKS, "-n", "2", "--dist", "loadfile", *parts]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    (folder / "output.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    last = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()][-1]
    return re.sub(r" in .*", "", last.strip("= ")) + ("" if done.returncode == 0 else f" ({folder / 'output.txt'})")


def sizes(wheel: Path, folder: Path, python: str, extras: list[str]) -> None:
    """Print how much an extra adds to an environment that has the package without extras."""
    print("| extra | MB | seconds | packages |\n|---|---|---|---|")
    for extra in ["", *extras]:
        inside = environment(folder / "environment", python)
        empty = size_mb(folder / "environment"), count(inside)
        seconds = install(inside, str(wheel))
        if extra:
            empty = size_mb(folder / "environment"), count(inside)
            seconds = install(inside, f"{wheel}[{extra}]")
        added = size_mb(folder / "environment") - empty[0], count(inside) - empty[1]
        print(f"| {extra or '(none)'} | {added[0]:.0f} | {seconds:.0f} | {added[1]} |", flush=True)
        shutil.rmtree(folder / "environment")


def count(python: Path) -> int:
    return len(run([str(python), "-m", "pip", "list", "--format", "freeze"]).split())


def extras_of(wheel: Path) -> list[str]:
    import zipfile

    with zipfile.ZipFile(wheel) as archive:
        metadata = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return re.findall(r"^Provides-Extra: (.*)$", archive.read(metadata).decode(), re.MULTILINE)


def run(command: list[str], cwd: Path | None = None) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("python", nargs="+", help="Pythons to install for")
    parser.add_argument("--numpy", action="append", help='a demand on numpy, as "<2"; can be given several times')
    parser.add_argument("--sizes", action="store_true", help="sizes of the extras, instead of tests")
    parser.add_argument("--out", type=Path, help="a folder to work in, that is kept")
    args = parser.parse_args()
    folder = args.out or Path(tempfile.mkdtemp(prefix="install_matrix_"))
    folder.mkdir(parents=True, exist_ok=True)
    wheel, _ = build(folder)
    if args.sizes:
        sizes(wheel, folder, args.python[0], extras_of(wheel))
    else:
        matrix(wheel, folder, args.python, args.numpy or [""])
    if not args.out:
        shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
