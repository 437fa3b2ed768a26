"""The command line: teaches, is quick, prints named errors without a traceback, keeps to one-way imports."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from gof import cli
from gof.errors import GofError

ROOT = Path(__file__).parent.parent


def run(*arguments, **kwargs):
    return subprocess.run(
        [sys.executable, "-m", "gof", *map(str, arguments)], capture_output=True, text=True, timeout=120, **kwargs
    )


def test_help_names_every_command_and_loads_nothing_heavy():
    code = (
        "import sys; from gof.cli import main; main(['--help']);"
        "heavy = {'numpy', 'torch', 'drjit', 'mitsuba', 'bpy', 'cv2', 'tyro'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in cli.commands())


@pytest.mark.parametrize("command", cli.commands())
def test_every_command_explains_itself(command):
    done = run(command, "--help")
    assert done.returncode == 0, done.stderr
    assert f"gof {command}" in done.stdout
    assert "--json" in done.stdout or command == "view", "a window has no figures"


def test_unknown_command_and_wrong_option():
    done = run("recontruct")
    assert done.returncode == 2 and "no command 'recontruct'" in done.stderr
    assert run("reconstruct", "--iteration").returncode == 2


def test_named_error_without_traceback(tmp_path):
    done = run("reconstruct", tmp_path / "nothing", "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "no dataset.json" in done.stderr and "Traceback" not in done.stderr


def test_ctrl_c_is_reported_as_kept_work(monkeypatch, capsys):
    class Interrupted:
        @staticmethod
        def main(argv):
            raise KeyboardInterrupt

    monkeypatch.setattr(cli.importlib, "import_module", lambda name: Interrupted)
    assert cli.main(["demo"]) == 130
    assert "resumes" in capsys.readouterr().err


@pytest.mark.parametrize(
    "room, forbidden",
    [
        ("gof", {"bpy", "gof_blender", "gof_benchmark"}),
        ("blender_addon", {"gof", "gof_benchmark", "torch", "mitsuba", "drjit", "zarr"}),
        ("blender_addon/io", {"bpy", "mathutils"}),
    ],
)
def test_imports_point_one_way(room, forbidden):
    files = list((ROOT / room).rglob("*.py"))
    assert files
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            bad = {n.split(".")[0] for n in names} & forbidden
            assert not bad, f"{path.relative_to(ROOT)} imports {bad}"


def test_a_broken_machine_is_named(monkeypatch, capsys):
    from gof import checks
    from gof.commands import doctor

    few = [check for check in checks.CHECKS if check.name in ("Dr.Jit", "disk")]
    monkeypatch.setattr(doctor, "checks", lambda: few)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nothing/libLLVM.so")
    with pytest.raises(GofError, match=r"not ready: Dr\.Jit"):
        doctor.main([])
    assert "libLLVM was not found" in capsys.readouterr().out.replace("\n", " ")


def test_a_check_that_fails_is_a_finding():
    from gof.checks import Check, examine

    def fails():
        raise RuntimeError("no such thing")

    (finding,) = examine([Check("thing", "nothing", fails, 1)])
    assert finding.status == "broken" and finding.detail == "RuntimeError: no such thing"


def test_checks_of_other_packages_are_made_in_their_place():
    from gof.checks import checks

    names = [check.name for check in checks()]
    assert names[:8] == ["Python", "packages", "Dr.Jit", "OpenEXR", "Blender", "Mantaflow", "disk", "CUDA"]
    assert names[8:] == ["weights/depth_anything_v2", "weights/memfof", "weights/scores"]


def test_this_machine_is_fit(tmp_path):
    """The real checks, with a real 3-frame bake."""
    done = run("doctor", "--json", tmp_path / "d.json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 frames of fire baked" in done.stdout.replace("\n", " ") and (tmp_path / "d.json").exists()
