"""The command line: teaches, is quick, prints named errors without a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gof.commands import cli
from gof.core.errors import GofError


def run(*arguments, **kwargs):
    return subprocess.run(
        [sys.executable, "-m", "gof", *map(str, arguments)], capture_output=True, text=True, timeout=120, **kwargs
    )


def test_help_names_every_command_and_loads_nothing_heavy():
    code = (
        "import sys; from gof.commands.cli import main; main(['--help']);"
        "heavy = {'numpy', 'torch', 'drjit', 'mitsuba', 'bpy', 'cv2', 'tyro'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in cli.commands())


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted as Linux lists them")
@pytest.mark.parametrize("asked, threads", [(None, 1), ("2", 2)])
def test_blas_has_one_thread_unless_the_user_asks_for_more(asked, threads):
    """Its threads wait by turning round, and keep the cores from frames that are worked on side by side."""
    script = "from gof.commands.cli import main; main(['--version']); import numpy as np, os; x = np.ones((500, 500))"
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    environment |= {} if asked is None else {"OPENBLAS_NUM_THREADS": asked}
    words = [sys.executable, "-c", f"{script}; x @ x; print(len(os.listdir('/proc/self/task')))"]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=True)
    assert int(done.stdout.split()[-1]) == min(threads, len(os.sched_getaffinity(0)))


@pytest.mark.parametrize("command", cli.commands())
@pytest.mark.long
def test_every_command_explains_itself(command):
    if command == "baseline":
        pytest.importorskip("torch")  # whose absence is what it says: tests/test_install.py
    done = run(command, "--help")
    assert done.returncode == 0, done.stderr
    assert f"gof {command}" in done.stdout


@pytest.mark.long
def test_unknown_command_and_wrong_option():
    done = run("recontruct")
    assert done.returncode == 2 and "no command 'recontruct'" in done.stderr
    assert run("reconstruct", "--iteration").returncode == 2


@pytest.mark.long
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


@pytest.mark.long
def test_the_old_name_of_ingest_still_works_and_says_the_new_one():
    old, new = run("static", "--help"), run("ingest", "--help")
    assert old.returncode == 0 and old.stdout == new.stdout
    assert "gof static is now gof ingest" in old.stderr and not new.stderr


@pytest.mark.long
def test_study_explains_and_names_every_study():
    done = run("study", "--help")
    assert done.returncode == 0, done.stderr
    for name in ("score", "generate", "reconstruct", "ablations"):
        assert f"gof study {name}" in done.stdout
        one = run("study", name, "--help")
        assert one.returncode == 0 and f"usage: gof study {name}" in one.stdout
    wrong = run("study", "speed")
    assert wrong.returncode == 2 and "no part 'speed'" in wrong.stderr and "gof study --help" in wrong.stderr


def test_a_broken_machine_is_named(monkeypatch, capsys):
    from gof.commands import doctor
    from gof.host import checks

    few = [check for check in checks.CHECKS if check.name in ("Dr.Jit", "disk")]
    monkeypatch.setattr(doctor, "checks", lambda: few)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nothing/libLLVM.so")
    with pytest.raises(GofError, match=r"not ready: Dr\.Jit"):
        doctor.main([])
    said = " ".join(capsys.readouterr().out.split())
    assert "DRJIT_LIBLLVM_PATH is '/nothing/libLLVM.so', which does not exist" in said, "what is set is blamed first"


def test_a_check_that_fails_is_a_finding():
    from gof.host.checks import Check, examine

    def fails():
        raise RuntimeError("no such thing")

    (finding,) = examine([Check("thing", "nothing", fails, 1)])
    assert finding.status == "broken" and finding.detail == "RuntimeError: no such thing"


def test_checks_of_other_packages_are_made_in_their_place():
    from gof.host.checks import checks

    names = [check.name for check in checks()]
    assert names[:8] == ["Python", "system", "packages", "extras", "Dr.Jit", "renderer", "PyTorch", "OpenEXR"]
    assert names[8:12] == ["Blender", "Mantaflow", "disk", "CUDA"]
    assert names[12:] == ["weights/depth_anything_v2", "weights/memfof", "weights/scores"]


@pytest.mark.blender
def test_this_machine_is_fit(tmp_path):
    """The real checks, with a real 3-frame bake."""
    done = run("doctor", "--json", tmp_path / "d.json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 frames of fire baked" in done.stdout.replace("\n", " ") and (tmp_path / "d.json").exists()
