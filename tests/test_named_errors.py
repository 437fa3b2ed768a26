"""No tracebacks: what files, options and disks can do to a command ends in a sentence that names them."""

import csv
import errno
import io
import json
import os
import resource
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.capture import protocol
from gof.capture.protocol import Identity, ProtocolError
from gof.commands import cli, convert, leaderboard
from gof.core import files
from gof.core.errors import DataFormatError, GofError
from gof.core.npz import read_npy, read_npz
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate import evaluate
from gof.evaluate.depth import read_depth
from gof.evaluate.leaderboard import LeaderboardRow, collect, to_csv, to_markdown
from gof.footage.lens import Lens
from gof.ingest.plates import read_plate
from gof.reconstruct.background import plate_depths
from tests.conftest import random_gaussians
from tests.test_reliability import allocated

ESCAPE = "\x1b]0;owned\x07\x1b[2J"


# ---------------------------------------------------------------- terminals


def test_messages_hold_nothing_that_acts_on_a_terminal():
    assert str(GofError(f"a{ESCAPE}b\nc\u202ed\x9b31m\te")) == "a\ufffd]0;owned\ufffd\ufffd[2Jb\nc\ufffdd\ufffd31m\te"
    assert str(DataFormatError("plain ü 左")) == "plain ü 左"


def test_messages_do_not_fill_the_terminal():
    said = str(GofError("result.npz: " + "x" * 10**6 + "; write it again"))
    assert len(said) < 5000 and said.startswith("result.npz: ") and said.endswith("; write it again")


def test_a_commands_tables_hold_nothing_that_acts(tmp_path, capsys):
    from gof.host.terminal import console

    console().print(f"[/b]{ESCAPE}[bold]x [link=file:///etc/passwd]y :fire:")
    said = capsys.readouterr().out
    assert "\x1b" not in said and "\x07" not in said
    assert "[/b]" in said and "[bold]x" in said and "[link=file:///etc/passwd]y" in said and ":fire:" in said


@pytest.mark.parametrize(
    ("name", "bits", "strips", "ticks"),
    [
        (f"gof-board {ESCAPE}", 10, 3, 4),
        ("gof-board 1", 255, 3, 4),
        ("gof-board 1", 10, 0, 4),
        ("gof-board 1", 10, 3, 0),
    ],
)
def test_a_board_is_asked_for_a_plain_identity(name, bits, strips, ticks):
    body = bytes([strips, bits, ticks, 2 * ticks]) + b"\7\0\0\0" + name.encode()
    with pytest.raises(ProtocolError, match="LED board"):
        Identity.decode(body)
    good = Identity.decode(bytes([3, 10, 4, 8]) + b"\7\0\0\0gof-board 1")
    assert (good.name, good.gray_bits, protocol.VERSION) == ("gof-board 1", 10, 1)


# ---------------------------------------------------------------- leaderboard


@pytest.fixture
def evaluated(tiny_dataset, tmp_path) -> Path:
    folder = tmp_path / "method"
    result = random_gaussians(30).save(folder / "result.npz")
    evaluate(result, Dataset.open(tiny_dataset), images=False).write(folder / "scores.json")
    return folder


@pytest.mark.parametrize(
    "about",
    [{"name": 5}, [1], {"train_seconds": "fast"}, {"train_seconds": -1.0}, {"name": "a\udcff"}, {"name": ""}, "x"]
    + [{"unfinished": " "}, {"made_by": 3}, {"given": "plates"}],
)
def test_a_method_file_is_checked(evaluated, about):
    (evaluated / "method.json").write_text(json.dumps(about))
    with pytest.raises(DataFormatError, match=r"method\.json"):
        collect([evaluated])


def test_names_are_text_on_every_page(evaluated, tmp_path, capsys):
    """Markup of the terminal's, of tables', of pages' and of spreadsheets."""
    for name in ("[/b]x", "=HYPERLINK(1)", "<script>alert(1)</script>|x", "[x](javascript:alert(1))"):
        (evaluated / "method.json").write_text(json.dumps({"name": name, "train_seconds": 3}))
        assert leaderboard.main([str(evaluated), "--out", str(tmp_path / "[/b]board"), "--overwrite"]) == 0
        assert "\x1b" not in capsys.readouterr().out
        page = (tmp_path / "[/b]board" / "leaderboard.html").read_text()
        assert "<script>alert" not in page
        table = (tmp_path / "[/b]board" / "leaderboard.md").read_text()
        assert "<script>" not in table and "](javascript" not in table and "\x1b" not in table
        assert all(
            line.count("|") - line.count("\\|") == table.splitlines()[0].count("|") for line in table.splitlines()
        )
    (evaluated / "method.json").write_text(json.dumps({"name": f"a{ESCAPE}"}))
    with pytest.raises(DataFormatError, match="every character must be visible"):
        leaderboard.main([str(evaluated), "--out", str(tmp_path / "[/b]board"), "--overwrite"])


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+2", "@SUM(A1)", "\t=1", "\r=1", '=HYPERLINK("http://x")', " =1"])
def test_a_cell_is_no_formula(text):
    """Spreadsheets take what begins so as a formula, also in quotes; an apostrophe makes it text."""
    row = next(iter(list(csv.reader(io.StringIO(to_csv([LeaderboardRow(name=text, method=text, l2=-1.5)]))))[1:]))
    assert row[0] == row[1] == f"'{text.strip()}"
    assert "-1.5" in row, "numbers stay numbers"
    plain = list(csv.reader(io.StringIO(to_csv([LeaderboardRow(name="a=b", method="4D-GS")]))))[1]
    assert plain[:2] == ["a=b", "4D-GS"]


def test_a_markdown_row_is_one_row():
    text = to_markdown([LeaderboardRow(name="a|b\nc`*_<i>", method="m", l2=1.0)])
    assert text.splitlines()[2] == r"| a\|b c\`\*\_&lt;i&gt; | 1.000 |" and len(text.splitlines()) == 3


def test_paths_with_markup_are_printed_as_they_are(tmp_path, capsys):
    folder = tmp_path / "[/b]"
    result = random_gaussians(5).save(folder / "r.npz")
    assert convert.main([str(result), str(folder / "out.ply")]) == 0
    assert "[/b]" in capsys.readouterr().out


def test_costs_with_other_fields_are_named(tmp_path):
    from gof.core.costs import StageLog

    stage = {"name": "x", "seconds": "long", "peak_mb": 1, "settings": {}}
    (tmp_path / "costs.json").write_text(json.dumps({"schema": "gof-costs", "version": 1, "stages": [stage]}))
    with pytest.raises(DataFormatError, match=r"costs\.json.*seconds"):
        StageLog(tmp_path / "costs.json").stages()


# ---------------------------------------------------------------- memory


def huge_png(path: Path):
    """A few kB that unpack to 500 MB."""
    packer = zlib.compressobj()
    body = b"".join(packer.compress(bytes(1626)) for _ in range(13000)) + packer.flush()
    chunks = ((b"IHDR", struct.pack(">2I5B", 13000, 13000, 1, 0, 0, 0, 0)), (b"IDAT", body), (b"IEND", b""))
    content = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        content += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    path.write_bytes(content)


def address_space() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


@pytest.fixture
def little_memory():
    """300 MB beyond what is in use."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + 300 * 2**20, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def test_a_picture_is_as_large_as_its_camera_before_it_is_decoded(tiny_dataset, tmp_path, little_memory):
    dataset = Dataset.open(tiny_dataset)
    huge_png(tiny_dataset / "cameras/cam_0/rgb/000001.png")
    with pytest.raises(DataFormatError, match=r"000001\.png: is 13000x13000, the camera says 36x64"):
        dataset.image(0, 1)
    (tmp_path / "plates").mkdir()
    huge_png(tmp_path / "plates/cam_0.png")
    with pytest.raises(DataFormatError, match=r"cam_0\.png: is 13000x13000"):
        background(dataset, 0, tmp_path)
    huge_png(tmp_path / "cam_0.png")
    with pytest.raises(DataFormatError, match=r"cam_0\.png"):
        read_plate(tmp_path / "cam_0.png", Lens(36, 64, np.eye(3)))


def lying_npy(path: Path):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f4", "fortran_order": False, "shape": (100_000, 200_000)}
        )


def test_a_depth_map_that_announces_too_much_is_refused_unread(tiny_dataset, tmp_path):
    dataset = Dataset.open(tiny_dataset)
    for name in ("cam_0", "cam_1"):
        lying_npy(tiny_dataset / "depth" / f"{name}.npy")
    plates = [dataset.static(c) for c in range(2)]
    lying_npy(tmp_path / "d" / "cam_0" / "000000.npy")

    def refused():
        with pytest.raises(DataFormatError, match=r"cam_0\.npy"):
            plate_depths(dataset, plates, None)
        with pytest.raises(DataFormatError, match=r"000000\.npy"):
            read_depth(tmp_path / "d", "cam_0", 0)

    refused()
    assert allocated(refused) < 2**24


def test_tensors_that_repeat_one_number_are_refused_unread(tmp_path):
    torch = pytest.importorskip("torch")
    from gof.io.importers.source import array

    with pytest.raises(DataFormatError, match=r"'x' announces .* more than the file holds"):
        array(torch.zeros(1).expand(10**9, 3), "x", (None, 3), tmp_path)
    assert array(torch.arange(6.0).reshape(2, 3).T, "x", (3, 2), tmp_path).shape == (3, 2)


def test_too_little_memory_is_named(monkeypatch, capsys):
    class Module:
        @staticmethod
        def main(argv):
            raise MemoryError("Unable to allocate 74.5 GiB for an array")

    monkeypatch.setattr(cli.importlib, "import_module", lambda name: Module)
    assert cli.run("reconstruct", []) == 1
    assert "gof reconstruct: not enough memory (Unable to allocate 74.5 GiB" in capsys.readouterr().err


# ---------------------------------------------------------------- disks and names


def test_a_file_system_without_locks_is_said_once(tmp_path, monkeypatch, capsys):
    def no_locks(*args):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", no_locks)
    with files.only_run_in(tmp_path):
        assert (tmp_path / ".lock").read_text() == str(os.getpid())
    assert "this file system has no locks" in capsys.readouterr().err


@pytest.mark.parametrize(
    "code", [errno.ENOTDIR, errno.EIO, errno.ENAMETOOLONG, errno.ESTALE, errno.EISDIR, errno.ELOOP]
)
def test_every_error_of_the_system_is_a_sentence(monkeypatch, capsys, code):
    class Module:
        @staticmethod
        def main(argv):
            raise OSError(code, os.strerror(code), "some/file")

    monkeypatch.setattr(cli.importlib, "import_module", lambda name: Module)
    assert cli.run("convert", []) == 1
    assert f"gof convert: some/file: {os.strerror(code)}" in capsys.readouterr().err


def gof(*arguments, **environment):
    command = [sys.executable, "-m", "gof", *arguments]
    return subprocess.run(command, capture_output=True, env=os.environ | environment, timeout=120)


def test_a_path_that_is_not_utf_8_is_named(tiny_dataset):
    """OpenCV crashes at such a path."""
    bad = os.fsencode(tiny_dataset.parent) + b"/bad\xffbytes"
    os.rename(tiny_dataset, bad)
    done = gof(b"reconstruct", bad, b"--out", bytes(tiny_dataset.parent) + b"/out")
    assert done.returncode == 2 and b"is not UTF-8" in done.stderr and b"Traceback" not in done.stderr


def test_pictures_are_read_by_any_name(tiny_dataset):
    bad = os.fsdecode(os.fsencode(tiny_dataset.parent) + b"/bad\xffbytes")
    os.rename(tiny_dataset, bad)
    assert Dataset.open(bad).image(0, 0).shape == (64, 36, 3)


def test_a_closed_pipe_is_no_error():
    done = subprocess.run(
        f"{sys.executable} -m gof --help | head -c 1 >/dev/null; exit ${{PIPESTATUS[0]}}",
        shell=True,
        executable="/bin/bash",
        capture_output=True,
    )
    assert b"Traceback" not in done.stderr and b"BrokenPipe" not in done.stderr


# ---------------------------------------------------------------- what must survive a power cut


def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    done = []
    real_sync, real_replace = os.fsync, os.replace
    monkeypatch.setattr(
        os, "fsync", lambda number: (done.append(os.readlink(f"/proc/self/fd/{number}")), real_sync(number))
    )
    monkeypatch.setattr(os, "replace", lambda a, b: (done.append(f"rename {Path(b).name}"), real_replace(a, b)))
    files.write_json(tmp_path / "a.json", {"a": 1})
    assert len(done) >= 2 and ".json" in done[0] and done[1] == "rename a.json", done
    assert done[2:] == [str(tmp_path)], "and then the folder's list of names"


def test_stores_of_another_zarr_version_are_refused(tmp_path):
    """Version 2 has codecs that run code from the file."""
    import zarr

    from gof.core.fields import open_array

    array = zarr.create_array(str(tmp_path / "v.zarr"), shape=(1, 2, 2, 2, 3), dtype="f4", zarr_format=2)
    array[:] = 0
    with pytest.raises(DataFormatError, match=r"v\.zarr"):
        open_array(tmp_path / "v.zarr")


def test_decoding_is_as_before(tiny_dataset):
    """What the checked reader gives is what OpenCV gives."""
    path = tiny_dataset / "cameras/cam_0/rgb/000000.png"
    expected = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB).astype(np.float32) / 255
    np.testing.assert_array_equal(Dataset.open(tiny_dataset).image(0, 0), expected)


# ---------------------------------------------------------------- options out of range


@pytest.mark.parametrize("camera", ["99", "-5", "2"])
def test_a_report_of_a_camera_that_is_none(evaluated, tiny_dataset, camera):
    from gof.commands import report

    with pytest.raises(GofError, match=rf"--camera {camera}: the dataset has cam_0, cam_1"):
        report.main([str(evaluated), "--dataset", str(tiny_dataset), "--camera", camera])


@pytest.mark.parametrize(("camera", "frame"), [(7, 0), (0, 7), (-1, 0), (0, -1)])
def test_a_preview_of_a_picture_that_is_none(evaluated, tiny_dataset, camera, frame):
    from gof.commands import report
    from gof.look.report import Preview

    cv2.imwrite(str(evaluated / "p.png"), np.zeros((8, 8, 3), np.uint8))
    Preview("p.png", camera, frame).write(evaluated / "preview.json")
    with pytest.raises(DataFormatError, match=r"preview\.json: the dataset has no frame"):
        report.main([str(evaluated), "--dataset", str(tiny_dataset)])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "99999999"], "--port"),
        (["--port", "-1"], "--port -1"),
        (["--host", "0.0.0.0"], "--host: .* this machine alone"),
        (["--host=0.0.0.0"], "--host: .*ssh -L"),
    ],
)
def test_an_address_that_the_page_cannot_have(tmp_path, words, said):
    from gof.commands import view

    result = random_gaussians(5).save(tmp_path / "r.npz")
    with pytest.raises(GofError, match=said):
        view.main([str(result), *words])


def test_generation_without_workers_is_refused(tmp_path):
    from gof_benchmark.commands import generate

    with pytest.raises(GofError, match="--workers 0: must be 1 or more"):
        generate.main(["demo", "--preset", "toy", "--out", str(tmp_path / "d"), "--workers", "0"])
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize("option", ["gaussians", "steps"])
def test_a_demo_is_refused_before_it_begins(tmp_path, option):
    from gof_benchmark.commands import demo

    with pytest.raises(GofError, match=f"--{option} 0: must be 1 or more"):
        demo.main(["--preset", "toy", f"--{option}", "0", "--out", str(tmp_path / "d")])
    assert not (tmp_path / "d").exists()


def test_a_folder_in_place_of_a_file_is_named(tmp_path):
    (tmp_path / "scores.json").mkdir()
    with pytest.raises(OSError, match=r"scores\.json") as raised:
        files.write_json(tmp_path / "scores.json", {})
    assert raised.value.filename == str(tmp_path / "scores.json")


def test_scores_name_no_place_on_their_authors_machine(tiny_dataset, tmp_path):
    """The result is found again from the scores' own folder, wherever both are moved."""
    from gof.evaluate.scores import Scores
    from gof.look.comparison import read_again

    result = random_gaussians(30).save(tmp_path / "theirs" / "run 7" / "r.npz")
    scores = evaluate(result, Dataset.open(tiny_dataset), images=False)
    scores.write(tmp_path / "boards" / "a" / "scores.json")
    assert json.loads((tmp_path / "boards/a/scores.json").read_text())["import"]["path"] == "../../theirs/run 7/r.npz"
    assert str(tmp_path) not in (tmp_path / "boards/a/scores.json").read_text()
    Scores.read(tmp_path / "boards/a/scores.json").write(tmp_path / "scores.json")
    assert json.loads((tmp_path / "scores.json").read_text())["import"]["path"] == "theirs/run 7/r.npz"
    (found,) = collect([tmp_path / "boards" / "a"])
    assert len(read_again(found)) == 30
    assert files.without_place(Path("/home/alice/r.npz"), Path("/scratch/boards")) == "r.npz"


@pytest.mark.parametrize("kind", ["device", "pipe", "folder"])
def test_json_is_read_from_files_only(tmp_path, kind):
    """A device or a pipe would be read for ever."""
    path = tmp_path / "captions.json"
    {"device": lambda: path.symlink_to("/dev/zero"), "pipe": lambda: os.mkfifo(path), "folder": path.mkdir}[kind]()
    with pytest.raises(DataFormatError, match=r"captions\.json: not a file"):
        files.read_json(path)


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n half", b"GIF89a", b"<svg></svg>"])
def test_a_damaged_picture_of_a_report_is_named(tmp_path, content):
    from gof.look.images import data_uri

    (tmp_path / "1.png").write_bytes(content)
    with pytest.raises(DataFormatError, match=r"1\.png: cannot be decoded"):
        data_uri(tmp_path / "1.png")


def test_an_array_whose_header_does_not_end_is_named(tmp_path):
    """numpy reads such headers with Python's tokenizer, whose error is of no kind that numpy's readers name."""
    np.save(tmp_path / "000000.npy", np.ones((4, 4)))
    data = (tmp_path / "000000.npy").read_bytes()
    (tmp_path / "000000.npy").write_bytes(data.replace(b"}", b"("))
    with pytest.raises(DataFormatError, match=r"000000\.npy: not a readable npy"):
        read_npy(tmp_path / "000000.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x.npy", data.replace(b"}", b"("))
    with pytest.raises(DataFormatError, match=r"a\.npz: not a readable npz"):
        read_npz(tmp_path / "a.npz")
