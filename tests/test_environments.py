"""What a user's machine, terminal and environment can do: a sentence and a status, never a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gof.commands import cli, no_such
from gof.host.checks import check_drjit
from gof.host.processes import python_command
from tests.conftest import random_gaussians

posix = pytest.mark.skipif(os.name != "posix", reason="as Unix has it")


@pytest.fixture
def folder(tmp_path):
    random_gaussians(30).save(tmp_path / "result.npz")
    return tmp_path


def run(folder, *words, shell="", variables=None, **options):
    """gof as users have it; `shell` is done first in the same process; a variable that is None is taken away."""
    changed = {"GOF_DEBUG": None} | (variables or {})
    environment = {k: v for k, v in (os.environ | changed).items() if v is not None}
    command = python_command("-m", "gof", *map(str, words))
    if shell:
        command = ["bash", "-c", f'{shell}; exec "$@"', "bash", *command]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, **options)


def is_named(done, *said):
    assert done.returncode in (1, 2), (done.returncode, done.stderr)
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr, done.stderr
    for words in said:
        assert words in done.stderr, done.stderr


SHARE = ("share", "result.npz", "--out", "s.html", "--overwrite")


# ---------------------------------------------------------------- variables


FAULTS = {"/nothing/libLLVM.so": "does not exist", "a folder": "is a folder", "text.so": "cannot be loaded"}
FAULTS["another"] = "is another library than LLVM"


def wrong_llvm(folder, path) -> str:
    """A path of that kind; "another" is a library that is not LLVM."""
    (folder / "text.so").write_text("no library")
    if path == "another":
        return pytest.importorskip("_ctypes").__file__
    return {"a folder": str(folder), "text.so": str(folder / "text.so")}.get(path, path)


def is_blamed(said, path):
    said = " ".join(said.split())
    assert "DRJIT_LIBLLVM_PATH is" in said and FAULTS[path] in said and "unset it" in said
    assert "apt-get install libllvm" not in said, "it is installed"


@pytest.mark.parametrize(
    "words, path", [*((SHARE, path) for path in FAULTS), (("doctor",), "another")], ids=lambda given: str(given)[:12]
)
@pytest.mark.long
@posix
def test_a_wrong_path_of_llvm_is_blamed_first(folder, path, words):
    pytest.importorskip("drjit")
    done = run(folder, *words, variables={"DRJIT_LIBLLVM_PATH": wrong_llvm(folder, path)})
    assert done.returncode == 1 and "Traceback" not in done.stderr + done.stdout
    is_blamed(done.stderr + done.stdout, path)


@pytest.mark.parametrize("path", FAULTS)
@pytest.mark.long
@posix
def test_a_wrong_path_of_llvm_is_broken_for_the_doctor(folder, path, monkeypatch):
    """By the one check of its that looks there; all of them run above."""
    pytest.importorskip("drjit")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", wrong_llvm(folder, path))
    status, said = check_drjit()
    assert status == "broken" and "Traceback" not in said
    is_blamed(said, path)


@pytest.mark.parametrize(
    "name, value",
    [
        ("OMP_NUM_THREADS", "abc"),
        ("OMP_NUM_THREADS", "0"),
        ("OMP_NUM_THREADS", "-3"),
        ("OMP_NUM_THREADS", "1.5"),
        ("NUMBA_NUM_THREADS", "abc"),
        ("NUMBA_NUM_THREADS", "0"),
        ("GOF_RENDER_KERNELS", "fast"),
        ("GOF_RENDER_BACKEND", "vulkan"),
    ],
)
@pytest.mark.long
def test_a_wrong_variable_is_named(folder, name, value):
    pytest.importorskip("drjit")
    is_named(run(folder, *SHARE, variables={name: value}), name, f"'{value}'")


@pytest.mark.long
def test_cuda_without_cuda_is_named(folder):
    dr = pytest.importorskip("drjit")
    if dr.has_backend(dr.JitBackend.CUDA):
        pytest.skip("there is a GPU")
    is_named(run(folder, *SHARE, variables={"GOF_RENDER_BACKEND": "cuda"}), "GOF_RENDER_BACKEND is 'cuda'", "unset it")


@pytest.mark.long
@posix
def test_empty_and_odd_variables_are_no_obstacle(folder):
    pytest.importorskip("drjit")
    for variables in (
        {"DRJIT_LIBLLVM_PATH": "", "OMP_NUM_THREADS": "", "NUMBA_NUM_THREADS": ""},
        {
            "OMP_NUM_THREADS": "2,1",
            "HOME": None,
            "LC_ALL": "tr_TR.UTF-8",
            "TZ": "Mars/Olympus",
            "TMPDIR": "/nonexistent",
        },
        {
            "HOME": "/proc",
            "XDG_CACHE_HOME": "/proc",
            "PYTHONWARNINGS": "error",
            "COLUMNS": "0",
            "GOF_RENDER_KERNELS": "drjit",  # native ones compiled anew without a folder: tests/render/test_backend.py
        },
    ):
        done = run(folder, *SHARE, variables=variables)
        assert done.returncode == 0 and "Traceback" not in done.stderr, (variables, done.stderr)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")
@pytest.mark.parametrize("kilobytes", [500_000, 600_000, 900_000, 1_100_000])
def test_too_little_memory_is_named(folder, kilobytes):
    pytest.importorskip("drjit")
    done = run(folder, *SHARE, shell=f"ulimit -v {kilobytes}")
    assert "Traceback" not in done.stderr
    if done.returncode:
        assert done.returncode == 1 and "memory" in done.stderr, done.stderr


# ---------------------------------------------------------------- the current folder, and what is said where


@posix
@pytest.mark.parametrize(
    "words, status",
    [(["--help"], 0), (["convert", "--help"], 0), (["help", "convert"], 0), (["--version"], 0), (SHARE, 1)],
)
def test_a_folder_that_has_been_deleted(folder, words, status):
    """Help needs none, and everything else says so."""
    (folder / "gone").mkdir()
    done = run(folder, *words, shell="cd gone; rmdir ../gone")
    assert done.returncode == status and "Traceback" not in done.stderr, done.stderr
    assert status == 0 or "the current folder has been deleted" in done.stderr


@posix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
@pytest.mark.parametrize(
    "words", [["--help"], ["help", "convert"], ["convert", "--help"], ["--version"], ["convert", "result.npz", "x.ply"]]
)
def test_standard_output_that_is_full(folder, words):
    done = run(folder, *words, shell="exec > /dev/full")
    is_named(done, "standard output: No space left on device")
    assert "again" not in done.stderr, "the same command would be refused, as its file is there"
    assert words[0] != "convert" or "--help" in words or (folder / "x.ply").exists()


@posix
@pytest.mark.parametrize("closed", ["exec <&-", "exec >&-", "exec 2>&-", "exec <&- >&- 2>&-"])
def test_standard_streams_that_are_closed(folder, closed):
    done = run(folder, "convert", "result.npz", "x.ply", shell=closed)
    assert done.returncode == 0 and "Traceback" not in done.stderr and (folder / "x.ply").exists()


# ---------------------------------------------------------------- faults of ours


class Faulty:
    @staticmethod
    def main(argv):
        raise ZeroDivisionError("of\nours \x1b[31m")


def test_a_fault_of_ours_is_one_line_with_what_to_report(monkeypatch, capsys):
    monkeypatch.setattr(cli.importlib, "import_module", lambda name: Faulty)
    monkeypatch.delenv("GOF_DEBUG", raising=False)
    assert cli.main(["convert", "a", "b"]) == 70
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "\x1b" not in said
    for words in ("gof convert", "ZeroDivisionError", "test_environments.py", "of ours", "GOF_DEBUG=1", "gof doctor"):
        assert words in said


def test_developers_see_its_traceback(monkeypatch):
    assert os.environ["GOF_DEBUG"], "tests/conftest.py sets it"
    monkeypatch.setattr(cli.importlib, "import_module", lambda name: Faulty)
    with pytest.raises(ZeroDivisionError):
        cli.main(["convert"])


# ---------------------------------------------------------------- words that name nothing


def test_help_of_a_command_and_what_was_meant(monkeypatch, capsys):
    called = []
    monkeypatch.setattr(cli, "run", lambda name, argv: called.append((name, argv)) or 0)
    cli.main(["help", "evaluate"])
    cli.main(["help", "capture", "sync"])
    assert called == [("evaluate", ["--help"]), ("capture", ["sync", "--help"])]
    for words in (["evalute"], ["help", "evalute"], ["Evaluate"]):
        assert cli.main(words) == 2
        assert "did you mean evaluate?" in capsys.readouterr().err
    assert cli.main(["qqqq"]) == 2
    said = capsys.readouterr().err
    assert "did you mean" not in said and "there are: " in said and "evaluate" in said


@pytest.mark.parametrize(
    "words, meant",
    [
        (["capture", "snyc"], "sync"),
        (["benchmark", "scroe"], "score"),
        (["study", "ablation"], "ablations"),
        (["figure", "polts"], ""),
    ],
)
def test_parts_say_what_was_meant(words, meant, capsys):
    assert cli.main(words) in (1, 2)
    said = capsys.readouterr().err
    assert f"'{words[1]}'" in said and (f"did you mean {meant}?" in said if meant else "here are: " in said)


def test_the_nearest_is_named_and_all():
    assert no_such("part", "x", ["ab", "cd"]) == "no part 'x'; there are: ab, cd"
    assert no_such("part", "abc", ["abd", "q"]) == "no part 'abc', did you mean abd? There are: abd, q"


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "nothing.npz", "--dataset", "tiny"],
        ["evaluate", "result.npz", "--dataset", "nothing"],
        ["share", "nothing.npz"],
        ["video", "nothing.npz"],
        ["report", "nothing", "--dataset", "tiny"],
        ["pack", "nothing"],
        ["unpack", "nothing.tar"],
        ["depth", "nothing"],
        ["background", "nothing"],
        ["reconstruct", "nothing", "--out", "out"],
        ["ingest", "nothing.mp4", "--out", "out"],
    ],
)
def test_what_is_not_there_is_said_without_a_progress_bar(folder, tiny_dataset, words, monkeypatch, capsys):
    """In this process, where a traceback would come through as the error itself."""
    monkeypatch.chdir(folder)
    monkeypatch.delenv("GOF_DEBUG")
    assert cli.main(words) in (1, 2)
    said = capsys.readouterr().err
    assert said and "Traceback" not in said and "0/" not in said and "\u2501" not in said, said


def test_a_bar_is_seen_from_its_first_update_on(capsys):
    from gof.host.terminal import progress_bar

    with progress_bar("work"):
        pass
    assert capsys.readouterr().err == ""
    with progress_bar("work") as update:
        update(1, 2)
        update(2, 2)
    said = capsys.readouterr().err
    assert "work: 1/2" in said and "work: 2/2" in said and "\u2501" in said
