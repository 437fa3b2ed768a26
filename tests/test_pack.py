"""Datasets as archives: what comes out is what went in, other people's programs open it, and damage is named."""

import hashlib
import io
import os
import shlex
import shutil
import subprocess
import tarfile
import time
from dataclasses import replace

import numpy as np
import pytest

from gof.commands import pack as pack_command
from gof.commands import unpack as unpack_command
from gof.commands.cli import main
from gof.core.errors import DataFormatError, GofError
from gof.core.grid_writer import GridWriter, scalar
from gof.dataset import Dataset
from gof.dataset.pack import VelocityFingerprint, description_lines, files_of, pack, read_credit, unpack, verify
from gof.reconstruct import pipeline
from gof.reconstruct.settings import ReconstructionSettings
from tests.evaluate.synthetic_flame import flame_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packed") / "fire"
    flame_dataset(folder)
    (folder / ".cache").mkdir()
    (folder / ".cache/large").write_bytes(b"work")
    return Dataset.open(folder)


@pytest.fixture(scope="module")
def archive(dataset, tmp_path_factory):
    return pack(dataset, tmp_path_factory.mktemp("archives"), "CC-BY-4.0", ("A. Author", "B. | <b>Bold</b>"))


def test_what_comes_out_is_what_went_in(dataset, archive, tmp_path):
    folder = unpack(archive, tmp_path)
    assert folder == tmp_path / "fire"
    for name in files_of(dataset.path):
        assert (folder / name).read_bytes() == (dataset.path / name).read_bytes()
    assert not (folder / ".cache").exists()
    assert VelocityFingerprint.of(Dataset.open(folder)) == VelocityFingerprint.of(dataset)
    assert verify(folder) == len(files_of(dataset.path)) + 1  # the card
    card = (folder / "README.md").read_text()
    assert card.startswith('---\nlicense: "cc-by-4.0"\n') and "A. Author" in card and "<b>" not in card
    assert "held out: 4" in card and VelocityFingerprint.of(dataset).sha256 in card


def test_tar_and_sha256sum_open_it(archive, tmp_path):
    subprocess.run(["sha256sum", "--check", "--strict", f"{archive.name}.sha256"], cwd=archive.parent, check=True)
    subprocess.run(["tar", "-xf", archive, "-C", tmp_path], check=True)
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=tmp_path / "fire", check=True)


def test_the_same_files_make_the_same_archive(dataset, archive, tmp_path):
    shutil.copytree(dataset.path, tmp_path / "fire")
    again = pack(Dataset.open(tmp_path / "fire"), tmp_path / "out", "CC-BY-4.0", ("A. Author", "B. | <b>Bold</b>"))
    assert again.read_bytes() == archive.read_bytes()


CHANGED_NS = 1_234_567_890_123_456_789  # in 2009; a float of seconds would lose the last three digits


@pytest.mark.parametrize("by", ["gof unpack", "tar"])
def test_files_keep_their_times_of_change(dataset, tmp_path, by):
    folder = shutil.copytree(dataset.path, tmp_path / "fire")
    os.utime(folder / "dataset.json", ns=(CHANGED_NS, CHANGED_NS))
    archive = pack(Dataset.open(folder), tmp_path / "packed", "CC0-1.0", ("A",))
    if by == "tar":
        (tmp_path / "out").mkdir()
        subprocess.run(["tar", "-xf", archive, "-C", tmp_path / "out"], check=True)
    else:
        unpack(archive, tmp_path / "out")
    assert (tmp_path / "out/fire/dataset.json").stat().st_mtime_ns == CHANGED_NS
    for name in files_of(folder):
        assert (tmp_path / "out/fire" / name).stat().st_mtime_ns == (folder / name).stat().st_mtime_ns, name


@pytest.mark.parametrize("stated", ["0", "-5", "nan", "1e300", "99999999999", "soon", ""])
def test_times_that_no_file_can_have_are_not_taken(archive, tmp_path, stated):
    def change(members):
        for member, _ in members:
            member.pax_headers = {"mtime": stated}
            member.mtime = 0

    before = time.time()
    folder = unpack(rewritten(archive, tmp_path / "fire.tar", change), tmp_path / "out")
    assert before - 60 < (folder / "dataset.json").stat().st_mtime < time.time() + 60


@pytest.mark.parametrize("damage", ["a bit", "cut off", "no tar"])
@pytest.mark.parametrize("checksum_beside", [True, False])
def test_damage_is_named_and_nothing_is_left(archive, tmp_path, damage, checksum_beside):
    broken = tmp_path / "fire.tar"
    content = bytearray(archive.read_bytes())
    if damage == "a bit":
        content[content.index(b"PNG") + 40] ^= 1
    broken.write_bytes({"a bit": content, "cut off": content[: len(content) // 2], "no tar": b"hello"}[damage])
    if checksum_beside:
        shutil.copy(f"{archive}.sha256", f"{broken}.sha256")
    with pytest.raises(DataFormatError, match="fire.tar"):
        unpack(broken, tmp_path / "out")
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def rewritten(archive, target, change):
    """The archive with its members changed: change(list of (TarInfo, content)) in place."""
    with tarfile.open(archive) as tar:
        members = [(member, tar.extractfile(member).read()) for member in tar.getmembers()]
    change(members)
    with tarfile.open(target, "w") as tar:
        for member, content in members:
            tar.addfile(member, io.BytesIO(content))
    return target


def added(name, kind=tarfile.REGTYPE, link=""):
    def change(members):
        member = tarfile.TarInfo(name)
        member.type, member.linkname = kind, link
        members.append((member, b""))

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (added("../evil"), "evil"),
        (added("fire/../../evil"), "evil"),
        (added("/etc/evil"), "evil"),
        (added("fire/link", tarfile.SYMTYPE, "/etc/passwd"), "link"),
        (added("fire/hard", tarfile.LNKTYPE, "/etc/passwd"), "hard"),
        (added("fire/device", tarfile.CHRTYPE), "device"),
        (added("fire/more"), "more is not listed"),
        (added("fire/dataset.json"), "dataset.json"),
        (lambda members: members.pop(3), "is missing"),
        (lambda members: members.pop(), "no SHA256SUMS"),
    ],
)
def test_strangers_archives_pass_one_gate(archive, tmp_path, change, named):
    with pytest.raises(DataFormatError, match=named):
        unpack(rewritten(archive, tmp_path / "evil.tar", change), tmp_path / "out")
    assert not list((tmp_path / "out").iterdir()) and not (tmp_path / "evil").exists()


@pytest.mark.parametrize("headers", [{"size": str(10**19)}, {"size": "-1"}, {"size": str(2**63 - 1)}])
def test_sizes_that_lie_are_named(archive, tmp_path, headers):
    """As `pax` headers, which have room for any number."""
    with tarfile.open(tmp_path / "fire.tar", "w", format=tarfile.PAX_FORMAT) as tar:
        for name in ("fire/a.png", "fire/b.png"):
            member = tarfile.TarInfo(name)
            member.pax_headers = headers
            tar.addfile(member)
    with pytest.raises(DataFormatError, match=r"fire\.tar"):
        unpack(tmp_path / "fire.tar", tmp_path / "out")
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_a_checksum_file_that_is_no_text_is_a_wrong_one(archive, tmp_path):
    shutil.copy(archive, tmp_path)
    (tmp_path / f"{archive.name}.sha256").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataFormatError, match="is not as .* says"):
        unpack(tmp_path / archive.name, tmp_path / "out")


def test_what_is_there_is_not_replaced(archive, tmp_path):
    unpack(archive, tmp_path)
    with pytest.raises(GofError, match="exists"):
        unpack(archive, tmp_path)


def test_a_changed_file_is_found_later(archive, tmp_path):
    folder = unpack(archive, tmp_path)
    (folder / "static/cam_0.png").write_bytes(b"")
    with pytest.raises(DataFormatError, match=r"static/cam_0.png is not as its checksum says"):
        verify(folder)


def test_links_and_silence_are_refused(dataset, tmp_path):
    with pytest.raises(GofError, match="licence"):
        pack(dataset, tmp_path, " ", ("A",))
    with pytest.raises(GofError, match="is inside the dataset"):
        pack(dataset, dataset.path / "out", "CC0-1.0", ("A",))
    shutil.copytree(dataset.path, tmp_path / "linked")
    (tmp_path / "linked/more.png").symlink_to("/etc/passwd")
    with pytest.raises(DataFormatError, match=r"more.png"):
        pack(Dataset.open(tmp_path / "linked"), tmp_path / "out", "CC0-1.0", ("A",))


def test_the_commands(dataset, tmp_path, capsys):
    packed = ["--licence", "CC-BY-4.0", "--authors", "A. Author", "--out", str(tmp_path)]
    assert pack_command.main([str(dataset.path), *packed]) == 0
    assert unpack_command.main([str(tmp_path / "fire.tar"), "--out", str(tmp_path / "data")]) == 0
    assert unpack_command.main([str(tmp_path / "data/fire")]) == 0
    assert "all as their checksums say" in capsys.readouterr().out


def test_a_truth_is_its_numbers(dataset, tmp_path):
    found = VelocityFingerprint.of(dataset)
    first = dataset.velocity.at(0.0).velocity.astype(np.float64)
    assert found.rms_m_s[0] == pytest.approx(np.sqrt((first**2).sum(-1).mean()), rel=1e-5)
    assert len(found.sha256) == len(hashlib.sha256().hexdigest())
    assert found.differs(found) == ""
    other = VelocityFingerprint("0" * 64, tuple(1.02 * speed for speed in found.rms_m_s))
    assert "1.96%" in found.differs(other)
    assert "frames" in found.differs(VelocityFingerprint("0" * 64, (1.0,)))


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ([], "--licence and --authors missing"),
        (["--licence", "CC0-1.0"], "--authors missing"),
        (["--authors", "A B"], "--licence missing"),
        (["--authors", "A B", "--licence", " "], "--licence missing"),
    ],
)
def test_all_that_is_missing_is_named_at_once_with_a_command_that_works(tiny_dataset, tmp_path, capsys, given, missing):
    out = tmp_path / "packed here"
    assert main(["pack", str(tiny_dataset), "--out", str(out), *given]) == 1
    said = capsys.readouterr().err
    assert missing in said and not out.exists()
    program, *words = shlex.split(said.split("For example: ")[1])
    assert program == "gof" and main(words) == 0
    assert [path.suffix for path in sorted(out.iterdir())] == [".tar", ".sha256"]


@pytest.mark.parametrize("name", ["cameras/cam_1/rgb/000003.png", "static/cam_0.png"])
def test_a_dataset_with_files_missing_is_not_packed_nor_reconstructed(dataset, tmp_path, name):
    folder = shutil.copytree(dataset.path, tmp_path / "fire")
    assert (folder / name).is_file()
    (folder / name).unlink()
    copied = Dataset.open(folder)
    with pytest.raises(DataFormatError, match=f"{name}: no such file, which dataset.json names"):
        pack(copied, tmp_path / "out", "CC0-1.0", ("A",))
    assert not list((tmp_path / "out").rglob("*"))
    with pytest.raises(DataFormatError, match=f"{name}: no such file"):
        pipeline.reconstruct(copied, ReconstructionSettings(copied.identity(), 10, 500, 20, 64), tmp_path / "run")
    assert not (tmp_path / "run/observation.npz").exists()
    (folder / "cameras/cam_0/rgb/000000.png").unlink()
    with pytest.raises(DataFormatError, match="and 1 more files"):
        pack(copied, tmp_path / "out", "CC0-1.0", ("A",))


def test_a_grid_that_lost_a_frame_is_not_packed(dataset, tmp_path):
    folder = shutil.copytree(dataset.path, tmp_path / "fire")
    times = dataset.velocity.times_s
    writer = GridWriter(folder / "grids/flame.zarr", (2, 2, 2), np.eye(4), times, 1.0, "float32", scalar("flame"))
    for frame in range(len(times)):
        writer.write_frame(frame, np.zeros((2, 2, 2)).__getitem__)
    writer.finish()
    pack(Dataset.open(folder), tmp_path / "out", "CC0-1.0", ("A",))
    shutil.rmtree(folder / "grids/flame.zarr/c/2")
    with pytest.raises(DataFormatError, match=r"flame\.zarr: frame 2 has none of its chunks"):
        pack(Dataset.open(folder), tmp_path / "again", "CC0-1.0", ("A",))


def test_words_of_the_authors_stand_below_the_card_however_often_it_is_packed(dataset, tmp_path):
    folder, words = shutil.copytree(dataset.path, tmp_path / "a/fire"), "# Ours\n\nPlease cite us.\n"
    (folder / "README.md").write_text(words)
    cards = []
    for place in ("b", "c"):
        archive = pack(Dataset.open(folder), tmp_path / place, "CC0-1.0", ("A",))
        folder = unpack(archive, tmp_path / place)
        cards.append((folder / "README.md").read_text())
    assert cards[0] == cards[1] and cards[0].startswith("---\nlicense:") and cards[0].endswith(words)
    assert read_credit(folder) == "Made by A. Licence: CC0-1.0."
    assert verify(folder) == len(files_of(folder)) + 1
    (folder / "README.md").write_bytes(b"\xff\xfe")
    with pytest.raises(DataFormatError, match=r"README\.md: no text in UTF-8"):
        pack(Dataset.open(folder), tmp_path / "d", "CC0-1.0", ("A",))


def test_a_clips_length_does_not_depend_on_when_it_begins(dataset):
    about = dataset.description
    later = replace(dataset, description=replace(about, time_s=tuple(t + 13 for t in about.time_s)))
    assert description_lines(later, 1000) == description_lines(dataset, 1000)
