"""Names and texts to damage: what they may lead to, and where they are shown."""

from __future__ import annotations

import hashlib
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from gof.core.errors import GofError
from tests.reliability.datasets import dataset as write_dataset
from tests.reliability.datasets import read_dataset
from tests.reliability.format import Format
from tests.reliability.malice import instead, packed, renamed

ESCAPED = Path("/tmp/gof-escaped")
SECRET = 123  # the grey of a picture that no reader may show


def formats() -> dict[str, Format]:
    """By name."""
    return {
        "names in dataset.json": Format(_names, _use_names, "dataset/dataset.json", injury=renamed),
        "links and pipes in a dataset": Format(_names, _use_names, "dataset/**/*", injury=instead),
        "names of pictures": Format(_captions, _use_captions, "dataset/[cp]*.json", injury=renamed),
        "links and pipes for pictures": Format(_captions, _use_captions, "dataset/*.*", injury=instead),
        "archive of gof pack": Format(_archive, _unpack, "dataset/*.tar", injury=packed, named=False),
        "archive, damaged": Format(_archive, _unpack, "dataset/*.tar"),
        "checksum of an archive": Format(_archive_with_checksum, _unpack, "dataset/*.sha256", share=0.3),
        "names in a submission": Format(_submission, _open_submission, "dataset/**/*.json", injury=renamed),
        "texts of a result": Format(_evaluated, _show_texts, injury=renamed, named=False, share=0.5),
        "texts on pages": Format(_pages, _show_pages, "*.json", injury=renamed, named=False),
        "scores, costs, method": Format(_evaluated, _show_texts, named=False, share=0.5),
        "board of a suite": Format(_pages, _show_pages, "*.json", named=False),
    }


def _beside_secrets(folder: Path) -> Path:
    """The empty folder/dataset, with links in it, beside what nothing in it may reach: folder/outside."""
    import cv2

    dataset, outside = folder / "dataset", folder / "outside"
    for path in (dataset, outside):
        path.mkdir()
    cv2.imwrite(str(outside / "secret.png"), np.full((64, 30, 3), SECRET, np.uint8))
    (dataset / "link").symlink_to(outside)
    (dataset / "secret.png").symlink_to(outside / "secret.png")
    return dataset


def _names(folder: Path) -> None:
    from gof_blender.pure.spec import BlendFile, SceneSpec

    dataset = _beside_secrets(folder)
    write_dataset(dataset)
    file = dataset / "dataset.json"
    (dataset / "background.blend").write_bytes(b"")
    spec = SceneSpec("sample", background="blend_file", blend_file=BlendFile("background.blend"))
    file.write_text(json.dumps(json.loads(file.read_text()) | {"spec": spec.to_dict()}))


def _captions(folder: Path) -> None:
    import cv2

    from gof.look.report import Preview
    from gof.reconstruct.captions import Caption, Captions

    dataset = _beside_secrets(folder)
    for name in ("1.png", "preview.png"):
        cv2.imwrite(str(dataset / name), np.zeros((8, 8, 3), np.uint8))
    Captions((Caption("1.png", "what it shows"), Caption("1.png", "again"))).write(dataset)
    Preview("preview.png", 0, 0).write(dataset / "preview.json")


def _use_names(folder: Path):
    """Everything that reads and writes files by the names in a dataset.json."""
    from gof.core.files import path_in
    from gof.dataset import Dataset
    from gof.dataset.plates import background, save_plates
    from gof_benchmark.views import dnerf, dynerf, nerfstudio
    from gof_benchmark.views.source import ViewSource
    from gof_blender.core.errors import GofError as ErrorOfTheAddOn
    from gof_blender.pure.dve import true_velocity
    from gof_blender.worker.import_result import read_spec

    dataset = folder / "dataset"
    try:
        found = read_dataset(dataset)
        _require_unseen([picture for pictures in found[3] for picture in pictures])
        d = Dataset.open(dataset)
        save_plates(dataset / "out", [camera.name for camera in d.cameras], [d.static(c) for c in range(2)])
        plates = [background(d, c, dataset / "out") for c in range(2)]
        _require_unseen(plates)
        for camera in d.cameras:
            path_in(dataset, f"cameras/{camera.name}/board_mask.png").parent.mkdir(parents=True, exist_ok=True)
        source = ViewSource.open(dataset)
        nerfstudio.write(source)
        dnerf.write(source)
        for number in range(2):
            dynerf.link_pictures(source, number, number)
        for what in ("transforms.json", "transforms_train.json"):
            for frame in json.loads((dataset / what).read_text())["frames"]:
                path_in(dataset, frame["file_path"].removeprefix("./"))
        files = [read_spec(dataset).blend_file.path, true_velocity(dataset).times_s]
        files += [camera.name for camera in d.description.cameras]
    except ErrorOfTheAddOn as e:
        raise GofError(str(e)) from e
    finally:
        _require_apart(folder)
    return found, plates, files


def _use_captions(folder: Path):
    """The pictures that a report takes from files beside it."""
    from gof.dataset import Dataset
    from gof.look.report import Preview, _preview, _stage_pictures

    dataset = folder / "dataset"
    if not (dataset / "dataset.json").exists():
        write_dataset(dataset)
    pages = _stage_pictures(dataset), _preview(Preview.read(dataset / "preview.json"), dataset, Dataset.open(dataset))
    _require_apart(folder)
    return pages


def _archive(folder: Path) -> None:
    from gof.dataset import Dataset
    from gof.dataset.pack import pack

    place = _beside_secrets(folder)
    original = folder.with_name(folder.name + "-original") / "fire"
    original.mkdir(parents=True)
    write_dataset(original)
    pack(Dataset.open(original), place, "CC-BY-4.0", ("somebody",))
    shutil.rmtree(original.parent)
    (place / "fire.tar.sha256").unlink()  # or nothing but its own damage would ever be seen


def _archive_with_checksum(folder: Path) -> None:
    _archive(folder)
    archive = folder / "dataset" / "fire.tar"
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    archive.with_name("fire.tar.sha256").write_text(f"{digest}  fire.tar\n")


def _unpack(folder: Path):
    from gof.dataset.pack import unpack, verify

    out = folder / "dataset" / "unpacked"
    try:
        target = unpack(folder / "dataset" / "fire.tar", out)
        links = [path for path in target.rglob("*") if path.is_symlink() or not (path.is_file() or path.is_dir())]
        assert not links and target.parent == out, "not plain files in one folder"
        return verify(target)
    finally:
        left = [path.name for path in out.iterdir() if path.name.startswith(".")] if out.is_dir() else []
        shutil.rmtree(out, ignore_errors=True)
        _require_apart(folder)
        assert not left, "a draft was left"


def _submission(folder: Path) -> None:
    from gof.dataset.leaks import MadeFrom
    from gof.evaluate.scores import Origin, Scores
    from tests.reliability.results import gaussians

    run = _beside_secrets(folder) / "scene"
    run.mkdir()
    gaussians().save(run / "result.npz")
    Scores(gaussians=12, dynamic_gaussians=9, import_=Origin("gof", (), path="result.npz")).write(run / "scores.json")
    MadeFrom.of(["result.npz"], [0, 1]).write(run)
    about = {"name": "ours", "code": "https://example.org", "given": ["plates"], "authors": ["somebody"]}
    (run.parent / "method.json").write_text(json.dumps(about))


def _open_submission(folder: Path):
    """What `gof benchmark check` reads before it draws."""
    from gof.dataset.leaks import MadeFrom
    from gof.evaluate.submission import Run, Submission, picture_file
    from gof.io.importers import read_result

    submission = Submission.open(folder / "dataset")
    found = []
    for scene, folders in submission.runs.items():
        for place in folders:
            run = Run.open(place, scene)
            assert run.result.resolve().is_relative_to(folder.resolve() / "dataset"), "a result outside was opened"
            gaussians = read_result(run.result, run.options).gaussians
            found.append((gaussians, MadeFrom.read(place), str(picture_file(place, "cam_0", 0))))
    _require_apart(folder)
    return submission.name, found


def _pages(folder: Path) -> None:
    """The texts that others write and our pages show: a dataset's, a method's, a board's."""
    from gof.core.records import write_record
    from gof.evaluate.suite_board import BoardRow, BoardScene, Figure, SuiteBoard

    write_dataset(folder)
    file = folder / "dataset.json"
    said = {"effects": ["motion_blur"], "provenance": {"licence": "CC-BY-4.0", "source": "a page"}}
    file.write_text(json.dumps(json.loads(file.read_text()) | said))
    figures = {"l2": Figure(0.3, 0.1, 0.01, 1, 1), "psnr": Figure(30.0)}
    row = BoardRow("ours", "code; licence", True, 1, 2, ("plates",), ("a prior",), figures)
    scene = BoardScene("a scene", "dev", 0.2, False, 3.0, {"ours": figures})
    write_record(folder / "board.json", SuiteBoard("a board", (row,), (scene,)))


def _show_pages(folder: Path):
    """The suite's board, a shared page and a data card, with the texts of the files; only our own tags are in them."""
    from gof.core.records import read_record
    from gof.dataset import Dataset
    from gof.dataset.pack import card, description_lines
    from gof.evaluate.suite_board import SuiteBoard
    from gof.look.boards import suite_html, suite_markdown
    from gof.look.player.page import assemble

    board, dataset = read_record(SuiteBoard, folder / "board.json"), Dataset.open(folder)
    table = suite_markdown(board)
    assert len(table.splitlines()) == len(board.rows) + 2 and not {"<", "\x1b", "\0"} & set(table), "a name acts"
    name = dataset.description.name
    facts = description_lines(dataset, 1000)
    shared = assemble({"results": [{"name": row.name} for row in board.rows], "facts": facts, "file": name}, name)
    for page in (suite_html(board, {}), shared):
        assert not _strange_tags(page), "a name acts on a page"
    said = card(dataset, name or "x", (name,), 1000)
    assert "<script" not in said.split("```")[0] and said.count("\n---\n") == 1, "a name acts on a card"
    return board, said


def _strange_tags(page: str) -> list[str]:
    """Tags and attributes that no page of ours has."""
    found: list[str] = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
            acting = [name for name, value in attributes if name.startswith("on") or "javascript:" in (value or "")]
            scripts.append(tag == "script")
            found.extend(acting + [tag] * (tag in ("iframe", "object", "embed", "base", "form")))

    scripts: list[bool] = []
    Parser().feed(page)
    return found + ["script"] * (sum(scripts) > 3)


def _evaluated(folder: Path) -> None:
    from gof.core.costs import StageLog
    from gof.evaluate.scores import Origin, Scores

    origin = Origin("a method", ("a note", "another"))
    Scores(gaussians=3, dynamic_gaussians=2, import_=origin, warnings=("a warning",)).write(folder / "scores.json")
    (folder / "method.json").write_text(json.dumps({"name": "ours", "train_seconds": 3.0}))
    StageLog(folder / "costs.json").record("stage", 1.0, 2.0)


def _show_texts(folder: Path):
    """The texts of an evaluated result in every table and on every page."""
    import csv
    import io

    from gof.core.costs import StageLog
    from gof.evaluate.leaderboard import collect, rows_of, to_csv, to_markdown
    from gof.host.terminal import console
    from gof.look.boards import leaderboard_html

    rows = rows_of(collect([folder]))
    costs = StageLog(folder / "costs.json").costs()
    for cells in csv.reader(io.StringIO(to_csv(rows))):
        assert not any(cell.lstrip().startswith(("=", "+", "@")) for cell in cells), "a cell is a formula"
        assert cells[0][:1] != "-", "a name is a formula"
    table = to_markdown(rows)
    assert len(table.splitlines()) == len(rows) + 2 and not {"<", "\x1b", "\0"} & set(table), "a name acts in a table"
    page = leaderboard_html(rows, [], rows[0].name)
    assert "<script>alert" not in page, "a name acts on a page"
    screen = console()
    with screen.capture() as said:
        screen.print(rows[0].name, *rows[0].notes)
    assert not {"\x1b", "\x07", "\x9b", "\r", "\0"} & set(said.get()), "a name acts on a terminal"
    return rows, costs


def _require_unseen(pictures: list[np.ndarray | None]) -> None:
    """No picture is the one outside."""
    for picture in pictures:
        if picture is not None and np.size(picture):
            assert np.abs(np.asarray(picture) - SECRET / 255).max() > 1e-3, "a file outside was read"


def _require_apart(folder: Path) -> None:
    """What lies outside the dataset is as it was, and nothing has come there."""
    import cv2

    secret = folder / "outside" / "secret.png"
    assert {p.name for p in folder.iterdir()} == {"dataset", "outside"}, "something was written outside"
    assert [p.name for p in secret.parent.iterdir()] == ["secret.png"], "something was written through a link"
    assert secret.stat().st_nlink == 1, "a file outside was linked"
    assert (cv2.imread(str(secret)) == SECRET).all(), "a file outside was changed"
    assert not list(ESCAPED.parent.glob(ESCAPED.name + "*")), "something was written at an absolute path"
