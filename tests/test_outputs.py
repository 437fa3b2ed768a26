"""Where an output goes that is a device, a pipe, a link or a folder already. Never tried on /dev's own nodes."""

import ast
import json
import os
import stat
import subprocess
import threading

import pytest

from gof.commands.cli import main
from gof.commands.completion import leaves
from gof.commands.declared import config_of, options_of
from gof.commands.read import FOLDERS
from gof.core.files import atomic_path, write_json
from gof.host.processes import python_command
from tests.conftest import random_gaussians
from tools.import_graph import modules

RENAMES = {"rename", "renames"}

pytestmark = pytest.mark.skipif(os.name != "posix", reason="devices, pipes and links as Unix has them")


@pytest.fixture
def result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    random_gaussians(30).save(tmp_path / "result.npz")
    return "result.npz"


@pytest.fixture
def node(tmp_path):
    """A device of our own that takes everything, as /dev/null does."""
    path = tmp_path / "mynull"
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices")
    with open(path, "w") as file:  # some containers make nodes that nobody may open
        file.write("x")
    return path


def test_a_device_stays_one(result, node, capsys):
    assert main(["share", result, "--out", "z.html", "--json", str(node)]) == 0
    assert main(["share", result, "--out", str(node)]) == 0
    assert stat.S_ISCHR(os.stat(node).st_mode)
    assert (os.stat(node).st_rdev, os.listdir(".").count("z.html")) == (os.makedev(1, 3), 1)
    for left in os.listdir("."):
        assert "partial" not in left


def test_a_pipe_stays_one_and_gets_all(result, tmp_path):
    os.mkfifo("pipe.json")
    got = []
    reader = threading.Thread(target=lambda: got.append((tmp_path / "pipe.json").read_bytes()))
    reader.start()
    assert main(["share", result, "--out", "z.html", "--json", "pipe.json"]) == 0
    reader.join(timeout=20)
    assert json.loads(got[0]) and stat.S_ISFIFO(os.stat("pipe.json").st_mode)


@pytest.mark.parametrize("equals", [False, True])
@pytest.mark.parametrize("target", ["disk/x.json", "disk/new.json"])
def test_a_link_that_the_user_names_leads_to_the_file(result, tmp_path, target, equals):
    (tmp_path / "disk").mkdir()
    write_json(tmp_path / "disk/x.json", {"film": "older figures"})
    (tmp_path / "link.json").symlink_to(target)
    words = ["--json=link.json"] if equals else ["--json", "link.json"]
    assert main(["share", result, "--out", "z.html", *words]) == 0
    assert os.readlink("link.json") == target
    assert json.loads((tmp_path / target).read_text())


def test_a_link_that_nobody_names_is_not_written_through(result, tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "share.html").symlink_to("precious")  # where the page goes without --out
    assert main(["share", result]) == 0
    assert (tmp_path / "precious").read_text() == "precious" and not (tmp_path / "share.html").is_symlink()


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "link"])
def test_standard_output_gets_it_after_what_was_said(result, tmp_path, name):
    (tmp_path / "link").symlink_to("/dev/stdout")
    command = python_command("-m", "gof", "share", result, "--out", "z.html", "--json", name)
    if name == "/proc/self/fd/1" and not os.path.exists(name):
        pytest.skip("not here")
    with open("said.txt", "w") as file:  # a plain file, which is where a replaced one would show
        assert subprocess.run(command, stdout=file).returncode == 0
    said = (tmp_path / "said.txt").read_text()
    assert "z.html" in said and json.loads(said[said.index("{") : said.rindex("}") + 1])
    assert name != "link" or (tmp_path / "link").is_symlink()


def test_a_folder_and_a_circle_are_named(result, tmp_path, capsys):
    (tmp_path / "folder").mkdir()
    assert main(["share", result, "--out", "z.html", "--json", "folder"]) == 1
    assert "--json folder: is a folder" in capsys.readouterr().err and not os.path.exists("z.html")
    (tmp_path / "circle.json").symlink_to("circle.json")
    assert main(["share", result, "--out", "y.html", "--json", "circle.json"]) == 1
    assert "circle.json" in capsys.readouterr().err and (tmp_path / "circle.json").is_symlink()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cam_0.mp4", b"\0\0\0\x18ftypmp42"),
        ("result.npz", b"PK\3\4"),
        ("flame.ply", b"ply\nformat ascii 1.0\n"),
        ("points.json", b'{"points": [[0, 0]]}\n'),  # as people write it
        ("dataset.json", b'{\n "schema": "gof-dataset",\n "version": 1\n}\n'),
        ("spec.json", b'{\n  "schema": "gof-scene"\n}\n'),
        ("settings.json", b'{\n "schema": "gof-reconstruction-settings"\n}\n'),
        ("scores.json", b'{\n "schema": "gof-scores"\n}\n'),  # of another command
        ("notes.txt", b"[not JSON"),
        ("empty", b""),
    ],
)
def test_figures_replace_nothing_but_figures(result, tmp_path, name, content, capsys):
    """A forgotten name behind --json would take the next word: a film, say."""
    own = tmp_path / "mine" / name
    own.parent.mkdir()
    own.write_bytes(content)
    words = ["share", result, "--out", "z.html", "--json", str(own)]
    assert main(words) == 1
    said = capsys.readouterr().err
    assert f"--json {own}: is there already" in said and "--overwrite" in said
    assert own.read_bytes() == content and not os.path.exists("z.html"), "it is refused before the work"
    assert main([*words, "--overwrite"]) == 0
    assert isinstance(json.loads(own.read_text()), dict)


def test_the_same_command_replaces_its_own_figures(result, tmp_path):
    for _ in range(2):
        assert main(["share", result, "--json", "figures.json"]) == 0
    assert json.loads((tmp_path / "figures.json").read_text())


def test_scores_are_figures_of_evaluate(tiny_dataset, result, tmp_path, capsys):
    words = ["evaluate", result, "--dataset", str(tiny_dataset), "--no-images", "--json", "figures.json"]
    assert main(words) == 0
    write_json(tmp_path / "figures.json", json.loads((tmp_path / "figures.json").read_text()) | {"costs": {}})
    assert main(words) == 0 and json.loads((tmp_path / "figures.json").read_text())["costs"]
    before = (tmp_path / "figures.json").read_bytes()
    assert main(["doctor", "--json", "figures.json"]) == 1
    assert (tmp_path / "figures.json").read_bytes() == before


def test_an_option_is_no_file_of_figures(result, capsys):
    assert main(["share", result, "--json", "--quiet"]) == 2
    assert "--json: name the file" in capsys.readouterr().err and not os.path.exists("--quiet")


def test_figures_in_a_file_for_a_folder_are_refused_before_the_work(result, capsys):
    assert main(["share", result, "--out", "z.html", "--json", "result.npz/x.json"]) == 1
    assert "result.npz is a file, where a folder is needed" in capsys.readouterr().err
    assert not os.path.exists("z.html")


def test_every_out_is_of_a_folder_or_of_files():
    """By the beginning of its text, a file in the place of a folder is refused before the work."""
    files = ("File to write", "Files to write", "File or folder", "JSON file", "Film to write", "The .blend")
    begins = {
        command: option.text
        for command, module in leaves().items()
        for option in options_of(config_of(module))
        if option.field == "out"
    }
    assert len(begins) > 15
    for command, text in begins.items():
        assert text.startswith((*FOLDERS, *files)), f"{command}: {text}"


@pytest.mark.parametrize(
    "words",
    [
        "evaluate result.npz --dataset nothing",
        "leaderboard nothing",
        "background nothing",
        "ingest a.mp4",
        "unpack a.tar",
        "reconstruct nothing",
        "depth nothing",
    ],
)
def test_a_file_for_a_folder_is_refused_before_the_work(words, result, capsys):
    for out in ("result.npz", "result.npz/deeper"):
        assert main([*words.split(), "--out", out]) == 1
        assert "--out: result.npz is a file, where a folder is needed" in capsys.readouterr().err


def test_a_result_to_view_must_be_there(result, capsys):
    assert main(["view", "nothing"]) == 1
    assert capsys.readouterr().err == "gof view: nothing: no such file or folder\n"


def test_a_blend_goes_to_no_device(result, tiny_dataset, tmp_path, capsys):
    """Blender puts a new file in the place of the old one, whatever that was."""
    os.mkfifo("x.blend")
    assert main(["import", result, "--dataset", str(tiny_dataset), "--out", "x.blend"]) == 1
    assert "x.blend: is not a file but a device or a pipe" in capsys.readouterr().err


def test_what_fails_leaves_a_device_untouched(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError), atomic_path(tmp_path / "pipe") as draft:
        draft.write_text("half")
        raise ValueError
    with pytest.raises(IsADirectoryError):
        write_json(tmp_path, {})


def test_files_get_their_names_in_one_place():
    """`os.replace` and its kin stand where this says: one rule for files, and folders that must not exist before."""
    files = {"gof.core.files"}
    folders = {"gof.core.drafts", "gof_benchmark.commands.benchmark_add", "gof.core.grid_writer"}
    found = set()
    product = {n: path for n, path in modules().items() if not n.startswith("gof_benchmark.evidence")}
    for name, path in product.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
                if (owner, node.func.attr) in {("os", "replace"), ("shutil", "move")} or node.func.attr in RENAMES:
                    found.add(name)
    assert found == files | folders
