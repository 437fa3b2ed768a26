"""Child processes: they run nothing of the current folder, and die with their parent."""

import ast
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from gof.commands.cli import main
from gof.core.errors import GofError
from gof.host import processes
from tests.conftest import random_gaussians
from tools.import_graph import modules

# Of the standard library, of others, and ours: what a child imports early. A dataset folder may hold any of them.
NAMES = ("random", "json", "types", "numpy", "torch", "drjit", "pathlib", "argparse", "runpy", "struct", "bpy")
NAMES += ("gof", "gof_blender", "gof_benchmark", "benchmark", "sitecustomize", "usercustomize", "codecs")


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """The current folder, with modules of somebody else; gives those that were run."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / 'ran.txt')!r}, 'a').write('{name} ')\n")
    monkeypatch.chdir(folder)

    def ran() -> str:
        return (tmp_path / "ran.txt").read_text() if (tmp_path / "ran.txt").exists() else ""

    return ran


def test_the_trap_catches_python_as_it_is(hostile):
    subprocess.run([sys.executable, "-c", "import random"], check=True)
    assert hostile().split() == ["random"]


@pytest.mark.parametrize("older", [False, True], ids=["this Python", "3.10, which has no -P"])
def test_a_child_runs_nothing_of_the_current_folder(hostile, monkeypatch, older):
    if older:
        monkeypatch.setattr(sys, "version_info", (3, 10))
    code = "import random, json, runpy, sys; print(json.dumps(sys.argv[1:]))"
    done = processes.run(processes.python_command("-c", code, "a b", "-m"), stdout=subprocess.PIPE)
    assert json.loads(done.stdout) == ["a b", "-m"]
    module = processes.python_command("-m", "json.tool", "--no-such")
    assert ("-P" in module) is (sys.version_info >= (3, 11))
    done = processes.run(module, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and "usage" in done.stderr
    assert hostile() == ""


@pytest.mark.long
def test_doctor(hostile, capsys):
    main(["doctor"])
    assert "PyTorch" in capsys.readouterr().out
    assert hostile() == ""


@pytest.mark.blender
def test_import_and_generate(hostile, tiny_dataset, tmp_path):
    pytest.importorskip("bpy")
    result = random_gaussians(5).save(tmp_path / "result.npz")
    words = ["import", str(result), "--dataset", str(tiny_dataset), "--out", str(tmp_path / "x.blend")]
    assert main(words) == 0
    assert main([*words, "--overwrite"]) == 0  # which Blender has to hear of, too
    from gof_benchmark.generator import blender_process

    with pytest.raises(GofError):
        blender_process.run_stage("bake", tmp_path / "nothing")  # has no spec: the worker begins, and says so
    assert hostile() == ""


@pytest.mark.blender
def test_a_look_into_a_blend(hostile, tmp_path, capsys):
    """`gof generate --estimate` asks a Blender about a spec's own .blend."""
    pytest.importorskip("bpy")
    from gof_blender.pure import spec as scene_spec
    from gof_blender.pure.spec import BlendFile
    from tests.blender.runs import TOY

    (tmp_path / "room.blend").write_bytes(b"no scene of Blender")
    room = BlendFile(str(tmp_path / "room.blend"), "Fire")
    scene_spec.save(dataclasses.replace(TOY, background="blend_file", blend_file=room), tmp_path / "spec.json")
    assert main(["generate", str(tmp_path / "spec.json"), "--out", str(tmp_path / "out"), "--estimate"]) == 1
    assert "room.blend" in capsys.readouterr().err
    assert hostile() == ""


def test_a_stage_of_the_demo_and_a_row_of_a_study(hostile, tiny_dataset, tmp_path, monkeypatch):
    from gof.dataset import Dataset
    from gof_benchmark.commands import demo
    from gof_benchmark.studies import variants

    stage = demo.Stage("wrong", ["convert", tmp_path / "nothing.npz", tmp_path / "x.ply"], [], [tmp_path / "x.ply"])
    monkeypatch.setattr(demo, "stages_of", lambda config: [stage])
    with pytest.raises(GofError, match=r"nothing\.npz: no such file"):
        demo.run_stages(demo.DemoConfig(out=tmp_path))
    study = variants.VariantStudy(tiny_dataset, tmp_path / "study")
    with pytest.raises(GofError, match="--no-such"):
        variants.run_one(study, Dataset.open(tiny_dataset), "row", {"no_such": 1})
    assert hostile() == ""


@pytest.mark.long
def test_baseline_finds_the_modules_beside_the_script_and_nothing_here(hostile, tmp_path, capfd):
    pytest.importorskip("torch")
    checkout = tmp_path / "checkout"
    checkout.mkdir()
    (checkout / "scene.py").write_text("WHERE = 'beside the script'\n")
    (checkout / "train.py").write_text("import random, json, scene, sys\nprint(scene.WHERE, sys.path[0])\n")
    assert main(["baseline", "--method", "3dgs", str(checkout / "train.py")]) == 0
    assert f"beside the script {checkout}" in capfd.readouterr().out
    assert hostile() == ""


def test_there_is_one_way_to_start_python():
    """No other file takes `sys.executable`, and in the product none calls `subprocess` or starts others' programs."""
    python = {"gof.host.processes", "gof_blender.pure.child"}
    python |= {"gof_benchmark.evidence.baseline_rows"}  # the default of an option: whose Python others' code runs in
    start = {"gof.host.processes"} | {f"gof_blender.pure.{name}_process" for name in ("dataset", "look", "score")}
    calls = {"run", "Popen", "call", "check_call", "check_output", "getoutput", "getstatusoutput"}
    # of `os`: others' ways; of `multiprocessing` and `concurrent.futures`: spawned children look here first, too
    other = {"system", "popen", "execv", "execve", "execl", "execvp", "spawnv", "spawnl", "posix_spawn", "startfile"}
    wrong = []
    for name, path in modules().items():
        evidence = name.startswith("gof_benchmark.evidence")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            where = f"{path}:{getattr(node, 'lineno', 0)}"
            if _dotted(node) == ("sys", "executable") and name not in python:
                wrong.append(f"{where} sys.executable")
            if isinstance(node, ast.Call):
                owner, function = _dotted(node.func)
                if owner == "subprocess" and function in calls and name not in start and not evidence:
                    wrong.append(f"{where} subprocess.{function}")
                if owner == "os" and function in other:
                    wrong.append(f"{where} os.{function}")
            for imported in _imported(node):
                if imported.startswith(("multiprocessing", "concurrent.futures.Process", "pty")) and not evidence:
                    wrong.append(f"{where} imports {imported}")
                if imported in {"sys.executable"} | {f"subprocess.{call}" for call in calls}:
                    wrong.append(f"{where} imports {imported}")
    assert not wrong, "use gof.host.processes:\n" + "\n".join(wrong)


def _dotted(node: ast.AST) -> tuple[str, str]:
    """The two names of `a.b`."""
    plain = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    return (node.value.id, node.attr) if plain else ("", "")


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [name.name for name in node.names]
    return [f"{node.module or ''}.{name.name}" for name in node.names] if isinstance(node, ast.ImportFrom) else []


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="the Linux kernel sees to it")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_training_ends_with_gof_baseline(tmp_path, how):
    pytest.importorskip("torch")
    script = tmp_path / "train.py"
    script.write_text("import os, time\nopen('pid', 'w').write(str(os.getpid()) + ' ')\ntime.sleep(100)\n")
    command = processes.python_command("-m", "gof", "baseline", "--method", "3dgs", str(script))
    gof = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL)
    child = int(_word(tmp_path / "pid"))
    assert psutil.Process(child).ppid() == gof.pid
    os.kill(gof.pid, how)
    assert gof.wait() == -how
    assert _ends(child)


@pytest.mark.skipif(sys.platform != "linux", reason="the Linux kernel sees to it")
def test_a_look_ends_with_the_process_that_began_it(tmp_path):
    """The worker's own rule: it ends when its standard input closes, on every system."""
    pid = str(tmp_path / "pid")
    loop = f"import os, time; open({pid!r}, 'w').write(str(os.getpid()) + ' '); time.sleep(100)"
    worker = f"from gof_blender.worker.reporter import run_alone; run_alone(lambda argv: exec({loop!r}), [])"
    code = (
        "import sys; from pathlib import Path; from gof_blender.pure import dataset_process\n"
        f"dataset_process._run([sys.executable, '-c', {worker!r}], Path({str(tmp_path)!r}))"
    )
    parent = subprocess.Popen(processes.python_command("-c", code))
    child = int(_word(Path(pid)))
    parent.kill()
    parent.wait()
    assert _ends(child)


def _word(path: Path) -> str:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        if path.exists() and path.read_text().endswith(" "):
            return path.read_text()
        time.sleep(0.05)
    raise TimeoutError(path)


def _ends(pid: int) -> bool:
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        if not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return True
        time.sleep(0.05)
    return False
