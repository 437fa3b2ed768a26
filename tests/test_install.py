"""What an installation is: cheap to start, of what it says, with what it needs and nothing more."""

import ast
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

import gof
from gof.core.errors import MissingDependencyError
from gof.host import extras

ROOT = Path(__file__).parents[1]
NAME = "gaussians-on-fire"
# Where a package's import name is not its own.
IMPORTS = {"cv2": "opencv-contrib-python-headless", "PIL": "pillow", "serial": "pyserial"}
IMPORTS |= {"flip_evaluator": "flip-evaluator"}


# ---------------------------------------------------------------- cheap


@pytest.mark.skipif(os.name != "posix", reason="counts the seconds of a child")
@pytest.mark.parametrize("code", ["import gof", "from gof.commands.cli import main; main(['--help'])"])
def test_starting_takes_little_beside_python_itself(code):
    """In the CPU seconds of a bare Python, the least of five in turn: a second is not as long on every machine."""
    ask = "import resource\n{}\nprint(sum(resource.getrusage(resource.RUSAGE_SELF)[:2]))"
    seconds = {"pass": [], code: []}
    for _ in range(5):
        for what, taken in seconds.items():
            run = subprocess.run([sys.executable, "-c", ask.format(what)], capture_output=True, text=True, check=True)
            taken.append(float(run.stdout.splitlines()[-1]))
    assert min(seconds[code]) < 7 * min(seconds["pass"])


def test_an_absent_library_is_named_with_its_extra():
    with pytest.raises(
        MissingDependencyError, match=r'a picture needs nowhere: pip install "gaussians-on-fire\[view\]"'
    ):
        extras.load("nowhere.at_all", "view", "a picture")
    assert extras.load("json", "view", "a picture") is json


def test_extras_know_what_they_lack(monkeypatch):
    needs = ["numpy>=1", "nothing-here>=1; extra == 'a'", "numpy; extra == 'b'", 'numpy[x]<9; extra == "a"']
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: needs)
    assert extras.missing() == {"a": ["nothing-here"], "b": []}


def _checkpoint(folder):
    from gof.io.importers import read_result

    (folder / "chkpnt7.pth").write_bytes(b"PK")
    read_result(folder / "chkpnt7.pth")


def _flip(folder):
    from gof.evaluate.image import flip

    flip(np.zeros((40, 40, 3)), np.zeros((40, 40, 3)))


def _lpips(folder):
    from gof.evaluate.image import lpips

    lpips(np.zeros((40, 40, 3)), np.zeros((40, 40, 3)), folder)


def _disparity(folder):
    from gof.ingest.depth import monocular

    (folder / "config.json").write_text("{}")
    monocular(np.zeros((8, 8, 3), np.uint8), folder)


def _board(folder):
    from gof.capture.controller import candidate_ports

    candidate_ports()


def _poses(folder):
    from gof.ingest.sfm import solve

    solve([([], [])], [], [])


def _witness(folder):
    from gof.render.mitsuba_scene import render_mitsuba
    from tests.conftest import arc, random_gaussians

    render_mitsuba(random_gaussians(3), arc(1)[0], 0.0)


def _workers(folder):
    from gof_benchmark.generator.workers import workers_for

    with workers_for("tcp://127.0.0.1:9", 1):
        pass


@pytest.mark.parametrize(
    ("use", "module", "extra"),
    [
        (_checkpoint, "torch", "torch"),
        (_lpips, "torch", "torch"),
        (_disparity, "torch", "torch"),
        (_flip, "flip_evaluator", "scores"),
        (_board, "serial", "capture"),
        (_poses, "pycolmap", "views"),
        (_witness, "mitsuba", "mitsuba"),
        (_workers, "distributed", "cluster"),
    ],
)
def test_whoever_lacks_an_extra_is_told_its_command(use, module, extra, tmp_path, monkeypatch):
    """Each extra that a command or a function can ask for; `fast` has its own test, in tests/render/test_backend.py."""
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=rf'needs .*pip install "gaussians-on-fire\[{extra}\]"'):
        use(tmp_path)


def test_whoever_lacks_blender_is_told_before_anything_begins(tmp_path, monkeypatch, capsys):
    from gof.commands.cli import main

    monkeypatch.setattr(extras.importlib.util, "find_spec", lambda name: None)
    assert main(["generate", "demo", "--preset", "toy", "--out", str(tmp_path / "out")]) == 1
    assert (
        'making a dataset needs bpy: pip install "gaussians-on-fire[blender]" with Python 3.11 or 3.13'
        in capsys.readouterr().err
    )


def test_whoever_lacks_pytorch_is_told_before_other_methods_code_begins(monkeypatch, capsys):
    from gof.commands.cli import main

    monkeypatch.setattr(extras.importlib.util, "find_spec", lambda name: None)
    assert main(["baseline", "--help"]) == 1
    said = capsys.readouterr().err
    assert 'other methods\' training code needs torch: pip install "gaussians-on-fire[torch]"' in said


def test_a_library_that_does_not_load_is_told_from_one_that_is_not_there(tmp_path, monkeypatch):
    (tmp_path / "broken_library.py").write_text("raise ImportError('libx.so.1: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        MissingDependencyError, match=r"is installed but does not load \(libx.so.1: cannot open.*\[view\]"
    ):
        extras.load("broken_library", "view", "a picture")


@pytest.mark.checkout
def test_no_message_names_an_extra_by_hand():
    """One place writes the command, in the quotes that every system's command line knows."""
    for path in [*(ROOT / "gof").rglob("*.py"), *(ROOT / "benchmark").rglob("*.py")]:
        if path.name != "extras.py":
            assert "gaussians-on-fire[" not in path.read_text(encoding="utf-8"), path


# ---------------------------------------------------------------- as it says


def test_the_installed_version_is_that_of_the_code():
    assert importlib.metadata.version(NAME) == gof.__version__


@pytest.mark.checkout
def test_every_place_has_the_version():
    assert f"\nversion: {gof.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {gof.__version__} " in (ROOT / "CHANGELOG.md").read_text()
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md"))
    assert set(re.findall(r"\bgaussians_on_fire\w*-([\d.]+\d)", pages)) == {gof.__version__}


def needed(extra=None):
    """Names that the metadata ask for, without extras or with one."""
    lines = importlib.metadata.requires(NAME)
    if extra is None:
        return {re.match(r"[\w.-]+", line)[0] for line in lines if "extra ==" not in line}
    return {re.match(r"[\w.-]+", line)[0] for line in lines if re.search(rf"extra == .{extra}\b", line)}


def unguarded(tree):
    """Imported names with their lines; not those in `try: ... except ImportError` (a missing one is answered there)."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Try) and any("Error" in ast.dump(h.type) for h in node.handlers if h.type):
            caught = " ".join(ast.dump(handler.type) for handler in node.handlers)
            if "ImportError" in caught or "ModuleNotFoundError" in caught:
                continue
        if isinstance(node, ast.If) and getattr(node.test, "id", None) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name.split(".")[0], node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.split(".")[0], node.lineno
        yield from unguarded(node)


# Files of `gof` that open with a question whether an extra's library is there: their other imports of it are safe.
NATIVE = ROOT / "gof" / "render" / "native"  # imported where `backend.kernels` says that numba is there
ON_CPU = ROOT / "gof" / "on_cpu"  # a process of its own, which only who trains with torch begins
ASKED = {
    "torch": (
        "gof/evaluate/image.py",
        "gof/ingest/depth.py",
        "gof/io/importers/source.py",
    )
    + ("gof/reconstruct/optical_flow.py", "gof/render/torch_api.py", "gof/render/gsplat.py")
    + tuple(f"gof/on_cpu/{p.name}" for p in ON_CPU.glob("*.py")),
    "torchvision": ("gof/evaluate/image.py",),
    "torchmetrics": ("gof/evaluate/image.py",),
    "gsplat": ("gof/on_cpu/baseline_methods.py",),
    "transformers": ("gof/ingest/depth.py",),
    "memfof": ("gof/reconstruct/optical_flow.py",),
    "pyserial": ("gof/capture/controller.py",),
    **dict.fromkeys(("numba", "llvmlite"), tuple(f"gof/render/native/{p.name}" for p in NATIVE.glob("*.py"))),
}


@pytest.mark.checkout
def test_gof_imports_what_an_installation_without_extras_has():
    """A method's author scores with it in the environment that trained, where no extra is installed."""
    base, wrong = needed(), []
    for path in sorted((ROOT / "gof").rglob("*.py")):
        for name, line in unguarded(ast.parse(path.read_text(encoding="utf-8"))):
            place = path.relative_to(ROOT).as_posix()
            package = IMPORTS.get(name, name)
            if name in sys.stdlib_module_names or name == "gof" or package in base or place in ASKED.get(package, ()):
                continue
            wrong.append(f"{place}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.checkout
def test_what_is_needed_is_imported_somewhere():
    """A dependency that nobody imports costs every installation for nothing."""
    imported = set()
    for path in (ROOT / "gof").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
        names += [n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module]
        imported |= {IMPORTS.get(name.split(".")[0], name.split(".")[0]) for name in names}
    assert not needed() - imported


def test_blenders_pins_belong_to_its_extra():
    lines = {re.match(r"[\w.-]+", line)[0]: line for line in importlib.metadata.requires(NAME) if "extra" not in line}
    assert "bpy" not in lines and "<3" in lines["numpy"] and "<5" in lines["opencv-contrib-python-headless"]
    assert {"bpy", "opencv-contrib-python-headless"} <= needed("blender")
    assert importlib.metadata.metadata(NAME)["Requires-Python"] == ">=3.10"


@pytest.mark.checkout
@pytest.mark.long
def test_nothing_is_newer_than_the_oldest_python(tmp_path):
    """Syntax, modules, names and arguments, by vermin; that it says no is shown with what it found before 0.2.0."""
    pytest.importorskip("vermin")
    command = [sys.executable, "-c", "import vermin; vermin.main()", "--no-tips", "--violations", "-t=3.10-"]
    done = subprocess.run([*command, "gof", "benchmark", "tools"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    newer = ("from typing import Self", "import tomllib", "import warnings\nwarnings.catch_warnings(action='ignore')")
    for code in newer:
        (tmp_path / "newer.py").write_text(code)
        assert subprocess.run([*command, str(tmp_path)], capture_output=True).returncode == 1, code


# ---------------------------------------------------------------- what is in the files

FOLDERS = {"gof": "gof", "benchmark": "gof_benchmark", "blender_addon": "gof_blender"}
CORE = "gof/core/", "gof_blender/core/"  # installed under both names
INFO = {"METADATA", "RECORD", "WHEEL", "entry_points.txt", "top_level.txt", "licenses/LICENSE"}
INFO |= {"licenses/blender_addon/LICENSE"}
MADE = {"PKG-INFO", "setup.cfg"} | {
    f"gaussians_on_fire.egg-info/{name}"
    for name in ("PKG-INFO", "SOURCES.txt", "dependency_links.txt", "entry_points.txt", "requires.txt", "top_level.txt")
}


@pytest.mark.checkout
@pytest.mark.long
def test_wheel_and_sdist_hold_the_tracked_files_and_no_others(tmp_path):
    from tools import install_matrix

    if not (ROOT / ".git").exists():
        pytest.skip("asks git which files are ours")
    stray = ROOT / "gof" / "__pycache__" / "stray.pyc"
    stray.parent.mkdir(exist_ok=True)
    stray.write_bytes(b"of this machine")
    wheel, sdist = install_matrix.build(tmp_path)
    stray.unlink()
    tracked = set(install_matrix.tracked())
    with zipfile.ZipFile(wheel) as archive:
        found = set(archive.namelist())
    ours = {tuple(path.split("/", 1)) for path in tracked if "/" in path}
    expected = {f"{FOLDERS[folder]}/{path}" for folder, path in ours if folder in FOLDERS}
    expected = {path for path in expected if path.split("/")[1] not in ("evidence", "training")}
    expected |= {path.replace(*CORE) for path in expected if path.startswith(CORE[0])}
    expected |= {f"gaussians_on_fire-{gof.__version__}.dist-info/{name}" for name in INFO}
    assert found == expected
    with tarfile.open(sdist) as archive:
        found = {member.name.split("/", 1)[1] for member in archive if member.isfile()}
    assert found == {path for path in tracked if not path.startswith(".")} | MADE


@pytest.mark.checkout
@pytest.mark.long
def test_a_release_holds_what_the_page_names(tmp_path):
    """Its check runs as printed, and sees a file that was tampered with; the flame is where the tutorial has it."""
    if not ((ROOT / ".git").exists() and shutil.which("sha256sum")):
        pytest.skip("needs the checkout's git, and sha256sum")
    made = [sys.executable, "tools/dist.py", "--out", str(tmp_path)]
    subprocess.run(made, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    page = (ROOT / "docs/install.md").read_text(encoding="utf-8")
    page = page.split("\n## Without a checkout\n")[1].split("\n## ")[0]
    named = re.findall(r"^\| `(gaussians_on_fire\S*)`", page, re.MULTILINE)
    check = re.search(r"^sha256sum .*$", page, re.MULTILINE)[0]
    assert len(named) == 3 and {"SHA256SUMS", *named} <= {path.name for path in tmp_path.iterdir()}
    addon, sample, _ = (tmp_path / name for name in named)
    assert "gaussians_on_fire/blender_manifest.toml" in zipfile.ZipFile(addon).namelist()
    assert "result/result.npz" in zipfile.ZipFile(sample).namelist()
    for name in {path.name for path in tmp_path.iterdir()} - {"SHA256SUMS", addon.name, sample.name}:
        (tmp_path / name).unlink()  # who takes two files only
    assert subprocess.run(check, shell=True, cwd=tmp_path).returncode == 0
    with sample.open("ab") as file:
        file.write(b"tampered")
    assert subprocess.run(check, shell=True, cwd=tmp_path).returncode != 0


# ---------------------------------------------------------------- the lock


def locked() -> dict[str, str]:
    lines = [line for line in (ROOT / "requirements.lock").read_text().splitlines() if not line.startswith("#")]
    found = [re.fullmatch(r"([a-z0-9.-]+)==(\S+) --hash=sha256:[0-9a-f]{64}", line) for line in lines]
    assert all(found), "a version and a hash on every line"
    assert len({match[1] for match in found}) == len(found), "each package once"
    return {match[1]: match[2] for match in found}


@pytest.mark.checkout
def test_the_lock_has_what_is_asked_for_in_versions_that_are_allowed():
    """As the Makefile installs; torch itself is left out, and what its CUDA builds bring."""
    requirements = pytest.importorskip("packaging.requirements")
    lock, wanted = locked(), needed() | needed("blender") | needed("dev")
    assert "torch" not in lock and ".[blender,torch,dev,fast]" in (ROOT / "tools/setup.sh").read_text()
    assert {name.lower() for name in wanted} - {NAME} <= set(lock)
    for line in importlib.metadata.requires(NAME):
        one = requirements.Requirement(line)
        extra = re.search(r"extra == .([\w-]+)", line)
        at = {"python_version": "3.11", "extra": extra[1] if extra else ""}
        if (one.marker is None or one.marker.evaluate(at)) and one.name.lower() in lock:
            assert one.specifier.contains(lock[one.name.lower()]), line
    assert {"pip", "setuptools"} <= set(lock), "what installs the others"
    assert lock["numpy"].startswith("1.26"), "bpy needs it"


BACKEND = """
import zipfile
def get_requires_for_build_editable(settings=None): return []
def prepare_metadata_for_build_editable(folder, settings=None): raise NotImplementedError
del prepare_metadata_for_build_editable
def build_editable(folder, settings=None, metadata=None):
    with zipfile.ZipFile(f"{folder}/ours-1-py3-none-any.whl", "w") as wheel: write(wheel, "ours")
    return "ours-1-py3-none-any.whl"
def write(wheel, name):
    wheel.writestr(f"{name}.py", "")
    wheel.writestr(f"{name}-1.dist-info/METADATA", f"Metadata-Version: 2.1\\nName: {name}\\nVersion: 1\\n")
    tags = "Wheel-Version: 1.0\\nGenerator: x\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n"
    wheel.writestr(f"{name}-1.dist-info/WHEEL", tags)
    wheel.writestr(f"{name}-1.dist-info/RECORD", "")
"""


@pytest.fixture
def source(tmp_path):
    """A source folder with the Makefile and the rule's script of ours, a project of one file, and wheels beside it."""
    for name in ("Makefile", "tools/setup.sh"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text())
    (tmp_path / "tools/system_packages.sh").write_text("")  # asks the system's package manager
    (tmp_path / "backend.py").write_text(BACKEND)
    system = 'requires = []\nbuild-backend = "backend"\nbackend-path = ["."]'
    (tmp_path / "pyproject.toml").write_text(f'[build-system]\n{system}\n[project]\nname = "ours"\nversion = "1"\n')
    (tmp_path / "wheels").mkdir()
    made = {}
    exec(BACKEND, made)
    for name in ("locked", "torch"):
        with zipfile.ZipFile(tmp_path / f"wheels/{name}-1-py3-none-any.whl", "w") as wheel:
            made["write"](wheel, name)
    return tmp_path


def make(source, python=sys.executable, **variables):
    alone = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(source / "wheels"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PIP_", "MAKE", "VIRTUAL_ENV"))} | alone
    command = ["make", "setup", f"PYTHON={python}", "TORCH=torch==1", *(f"{k}={v}" for k, v in variables.items())]
    return subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True)


needs_make = pytest.mark.skipif(not (shutil.which("make") and shutil.which("bash")), reason="make and bash")
needs_3_11 = pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="make needs Python 3.11")


@needs_make
@needs_3_11
@pytest.mark.long
@pytest.mark.checkout
@pytest.mark.skipif(sys.platform != "linux" or platform.machine() != "x86_64", reason="where the lock is for")
@pytest.mark.parametrize("good", [False, True])
def test_make_setup_ends_where_a_hash_is_wrong(source, good):
    wheel = (source / "wheels/locked-1-py3-none-any.whl").read_bytes()
    digest = hashlib.sha256(wheel if good else wheel + b"tampered").hexdigest()
    (source / "requirements.lock").write_text(f"locked==1 --hash=sha256:{digest}\n")
    done = make(source)
    found = {path.name.split("-")[0] for path in source.glob(".venv/lib/python3*/site-packages/*.dist-info")}
    if good:
        assert done.returncode == 0, done.stderr
        assert {"locked", "torch", "ours"} <= found and (source / ".venv/.ready").exists()
    else:
        assert done.returncode != 0 and "hashes do not match" in done.stderr and "newest" not in done.stdout
        assert not found & {"locked", "torch", "ours"} and not (source / ".venv/.ready").exists()


@needs_make
@pytest.mark.checkout
def test_make_says_which_python_it_needs(source):
    """Asked with a Python that says of itself that it is 3.12."""
    other = source / "python3.12"
    other.write_text("#!/bin/sh\necho 3.12\n")
    other.chmod(0o755)
    (source / "requirements.lock").write_text("")
    done = make(source, other)
    assert done.returncode != 0 and "3.11" in done.stderr and "Python 3.12" in done.stderr
    assert not (source / ".venv").exists()
    done = make(source, source / "no-such-python")
    assert done.returncode != 0 and "does not run" in done.stderr
