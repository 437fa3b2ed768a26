"""What cannot be is named before the work, with figures; what is merely unusual is not."""

import shutil
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from gof.commands.cli import main
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.reconstruct import memory
from gof.reconstruct.sanity import find_faults
from tests.conftest import look_at
from tests.reconstruct.rising_flame import DT, edit, write_flame


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    return write_flame(tmp_path_factory.mktemp("sane") / "flame", frames=16, dt=0.05)


def said(folder) -> str:
    return "; ".join(("STOP " if fault.stops else "warn ") + fault.text for fault in find_faults(Dataset.open(folder)))


def changed(flame, tmp_path, change):
    """A copy whose dataset.json is changed in place: change(meta)."""
    return edit(shutil.copytree(flame, tmp_path / "changed"), change)


def turn(folder, camera, how, kinds=("rgb", "static")):
    """Change a camera's picture files in place: how(picture)."""
    files = [*(folder / f"cameras/{camera}/rgb").glob("*.png")] if "rgb" in kinds else []
    files += [folder / f"static/{camera}.png"] if "static" in kinds else []
    for path in files:
        cv2.imwrite(str(path), how(cv2.imread(str(path))))
    return folder


def test_a_good_rig_has_no_fault_and_it_takes_no_time(flame):
    start = time.perf_counter()
    assert said(flame) == ""
    assert time.perf_counter() - start < 5


@pytest.mark.parametrize(
    ("what", "change", "words"),
    [
        ("focal 1e9", lambda c: c["K"][0].__setitem__(0, 1e9), "STOP camera 'cam_1' would see"),
        ("focal 1e-6", lambda c: c["K"][0].__setitem__(0, 1e-6), "STOP camera 'cam_1' would see 180"),
        ("row time", lambda c: c.update(row_time_s=1e6), "STOP camera 'cam_1' would take"),
        ("row time a bit", lambda c: c.update(row_time_s=0.06 / 96), "warn camera 'cam_1' would take"),
        ("row time < 0", lambda c: c.update(row_time_s=-1e-3), "STOP camera 'cam_1': row_time_s"),
        ("clock", lambda c: c.update(time_s=[100 + 0.05 * k for k in range(16)]), "when no other camera filmed"),
        ("clock a bit", lambda c: c.update(time_s=[0.2 + 0.05 * k for k in range(16)]), "4.0 frames"),
        ("focal x 2", lambda c: [c["K"][k].__setitem__(k, 2 * c["K"][k][k]) for k in (0, 1)], "focal length or pose"),
    ],
    ids=lambda value: value if isinstance(value, str) and " " in value else "",
)
def test_impossible_cameras_are_named(flame, tmp_path, what, change, words):
    assert words in said(changed(flame, tmp_path, lambda meta: change(meta["cameras"][1])))


def test_an_upside_down_camera_is_named(flame, tmp_path):
    """Its pictures and its plate turned by 180 degrees: no pixel of any file is wrong in itself."""
    text = said(turn(shutil.copytree(flame, tmp_path / "down"), "cam_1", lambda p: p[::-1, ::-1]))
    assert "STOP" in text and "upside down" in text and "'cam_1'" in text.partition("spread otherwise")[2]


@pytest.mark.parametrize("left", [0.0, 0.08], ids=["no flame at all", "hardly any"])
def test_a_camera_that_shows_no_flame_is_named_and_the_others_are_not_blamed(flame, tmp_path, capsys, left):
    """Its pictures are its plate, or its light above the plate is weak, as that of HDR footage read as SDR."""
    folder = shutil.copytree(flame, tmp_path / "dark")
    plate = cv2.imread(str(folder / "static/cam_1.png")).astype(float)
    turn(folder, "cam_1", lambda p: np.uint8(np.rint(plate + left * (p - plate))), kinds=("rgb",))
    text = said(folder)
    assert text.startswith("STOP camera 'cam_1' shows no flame (0.00% of its picture; 'cam_0' ")
    assert "camera 'cam_0'" not in text and "camera 'cam_2'" not in text and "can be where" not in text
    assert main(["reconstruct", str(folder), "--out", str(tmp_path / "out"), "--preset", "preview"]) == 1
    assert "camera 'cam_1' shows no flame" in " ".join(capsys.readouterr().err.split())


def test_plates_of_other_cameras_are_named(flame, tmp_path):
    folder = shutil.copytree(flame, tmp_path / "swapped")
    first, second = (folder / f"static/cam_{c}.png" for c in (0, 1))
    a, b = first.read_bytes(), second.read_bytes()
    first.write_bytes(b)
    second.write_bytes(a)
    assert said(folder).count("are the plates swapped?") == 2
    turned = turn(shutil.copytree(flame, tmp_path / "turned"), "cam_2", lambda p: p[::-1, ::-1], kinds=("static",))
    assert "plate turned by 180 degrees" in said(turned)


def test_a_pose_of_elsewhere_is_named(flame, tmp_path):
    def invert(meta):
        meta["cameras"][1]["world_to_camera"] = np.linalg.inv(meta["cameras"][1]["world_to_camera"]).tolist()

    assert "STOP" in said(changed(flame, tmp_path, invert))

    def opengl(meta):
        for camera in meta["cameras"]:
            camera["world_to_camera"] = (np.diag([1, -1, -1, 1]) @ camera["world_to_camera"]).tolist()

    assert "behind camera" in said(changed(flame, tmp_path / "gl", opengl))


def test_three_times_the_same_view_is_no_rig(flame, tmp_path):
    """A view, copied, its camera turned about the flame by a hundredth of a degree."""
    folder = shutil.copytree(flame, tmp_path / "narrow")
    for c in (1, 2):
        shutil.rmtree(folder / f"cameras/cam_{c}")
        shutil.copytree(folder / "cameras/cam_0", folder / f"cameras/cam_{c}")
        shutil.copy(folder / "static/cam_0.png", folder / f"static/cam_{c}.png")

    def narrow(meta):
        first = np.array(meta["cameras"][0]["world_to_camera"])
        for c in (1, 2):
            a = np.deg2rad(0.01 * c)
            about = np.eye(4)
            about[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
            meta["cameras"][c]["world_to_camera"] = (first @ about).tolist()

    assert "STOP the cameras see the flame from directions at most 0.02" in said(edit(folder, narrow))


def test_a_clock_that_is_off_by_frames_is_a_fault(tmp_path):
    """The times say nothing; the flame does: one camera shows it a quarter of a turn later."""

    def pulse(images, late=0):
        shown = images.copy()
        rows = np.arange(96)[:, None, None]
        for k in range(len(images)):
            for c in range(3):
                phase = (k - (late if c == 1 else 0)) * 1.3
                bright = 0.5 + 0.5 * np.sin(rows / 9 + phase)
                plate = images[:, c].min(0)
                shown[k, c] = plate + (images[k, c] - plate) * bright
        return shown

    together = write_flame(tmp_path / "together", frames=16, change=pulse)
    apart = write_flame(tmp_path / "apart", frames=16, change=lambda images: pulse(images, late=2))
    assert said(together) == ""
    assert "camera 'cam_1' changes otherwise" in said(apart)


# ---------------------------------------------------------------- false alarms


def test_unusual_rigs_have_no_fault(tmp_path):
    """Two cameras; two 8 degrees apart; landscape; four; rolled on its side; rolling shutter; over the border; a clock
    half a frame off."""
    rigs = {
        "two": {"cameras": 2},
        "four": {"cameras": 4},
        "rolling": {"row_time_s": 1e-4},
        "border": {"focal_px": 260.0},
        "half": {"late": {1: DT / 2}},
    }
    for name, options in rigs.items():
        assert said(write_flame(tmp_path / name, **options)) == "", name


def test_two_cameras_8_degrees_apart(tmp_path, monkeypatch):
    import tests.reconstruct.rising_flame as flame

    def close(n, radius=3.0, target=(0, 0, 1.0), **size):
        angles = np.deg2rad([-4, 4])
        places = [np.add(target, [radius * np.sin(a), -radius * np.cos(a), 0]) for a in angles]
        return [look_at(f"cam_{i}", place, target, **size) for i, place in enumerate(places)]

    monkeypatch.setattr(flame, "arc", close)
    assert said(write_flame(tmp_path / "close", cameras=2)) == ""


def test_fire_left_in_a_plate_and_a_lost_camera_have_no_fault(flame, tmp_path):
    """A third of the flame's light stays in one plate; another camera gives no picture for some frames."""
    folder = shutil.copytree(flame, tmp_path / "left")
    plate = cv2.imread(str(folder / "static/cam_0.png")).astype(float)
    burning = np.median([cv2.imread(str(p)) for p in (folder / "cameras/cam_0/rgb").glob("*.png")], axis=0)
    cv2.imwrite(str(folder / "static/cam_0.png"), np.maximum(plate, plate + 0.33 * (burning - plate)).astype(np.uint8))
    for k in (2, 3, 7):
        cv2.imwrite(str(folder / f"cameras/cam_2/rgb/{k:06d}.png"), np.zeros((96, 48, 3), np.uint8))
    assert "STOP" not in said(folder)


# ---------------------------------------------------------------- digits


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m.update(time_s=[1.76e9 + t for t in m["time_s"]]),
        lambda m: m.update(time_s=[5e4 + t for t in m["time_s"]]),
        lambda m: [_moved(c, [5e5, 4.2e6, 100]) for c in m["cameras"]],
        lambda m: [m.update(time_s=[600 + t for t in m["time_s"]]), *(_moved(c, [300, -100, 0]) for c in m["cameras"])],
    ],
    ids=["Unix time", "seconds since midnight", "UTM", "a little from zero"],
)
def test_clocks_and_worlds_far_from_zero_have_no_fault(flame, tmp_path, change):
    """They are measured from a datum (`tests/test_datum.py`)."""
    assert said(changed(flame, tmp_path, change)) == ""


def test_a_clip_too_long_for_its_frames_is_named(flame, tmp_path):
    """No datum helps where float32 rounds off a part of a frame between the first one and the last."""
    text = said(changed(flame, tmp_path, lambda m: m["time_s"].__setitem__(-1, 5e5)))
    assert "STOP the dataset's clock reaches 5e+05" in text and "cut it" in text


def _moved(camera, shift):
    pose = np.array(camera["world_to_camera"])
    pose[:3, 3] -= pose[:3, :3] @ shift
    camera["world_to_camera"] = pose.tolist()


# ---------------------------------------------------------------- the command


@pytest.mark.long
def test_the_command_stops_and_goes_on_anyway(flame, tmp_path, capsys):
    folder = turn(shutil.copytree(flame, tmp_path / "down"), "cam_1", lambda p: p[::-1, ::-1])
    small = ["--gaussians", "300", "--voxels", "24", "--steps", "3", "--until", "motion"]
    command = ["reconstruct", str(folder), "--out", str(tmp_path / "out"), *small]
    assert main(command) == 1
    error = capsys.readouterr().err
    assert "go on with --anyway" in error and "GB of memory" in error and not (tmp_path / "out/stages").exists()
    assert main([*command, "--anyway"]) == 0
    assert "warning: " in capsys.readouterr().err


# ---------------------------------------------------------------- memory


@pytest.mark.parametrize(
    ("pixels", "frames", "gaussians", "voxels", "measured"),
    [  # of a picture, training frames, Gaussians, voxels along the box: peak resident size of that run, MB
        (4_608, 7, 6_000, 32, 328),
        (57_600, 32, 60_000, 72, 626),
        (57_600, 32, 5_000, 72, 594),
        (57_600, 32, 250_000, 72, 870),
        (57_600, 32, 60_000, 140, 1509),
        (518_400, 44, 200_000, 112, 2367),
        (409_920, 88, 120_000, 96, 4326),  # a filmed flame
    ],
)
def test_memory_is_predicted(pixels, frames, gaussians, voxels, measured):
    """Three cameras of the demo's fire, and of a filmed one."""
    predicted = memory.needed_bytes(3 * pixels * frames, frames, gaussians, voxels)
    assert predicted / 2**20 == pytest.approx(measured, rel=0.15)


def test_memory_that_is_not_there_is_refused(capsys, monkeypatch):
    needed = memory.needed_bytes(15 * 3 * 96 * 48, 15, 1000, 24)
    memory.require(needed)
    assert capsys.readouterr().err == ""
    with pytest.raises(GofError, match="--max-size"):
        memory.require(1e18)
    monkeypatch.setattr(memory, "_limit", lambda: 1e8)
    with pytest.raises(GofError, match=r"this machine has 0\.1 GB"):
        memory.require(needed)


def test_a_limit_of_the_shell_is_known(tmp_path, flame):
    """`ulimit -v`: Dr.Jit would crash without a word where memory ends."""
    code = "import resource as r; r.setrlimit(r.RLIMIT_AS, (10**9, 10**9)); from gof.reconstruct import memory; "
    done = subprocess.run([sys.executable, "-c", code + "memory.require(5e8)"], capture_output=True, text=True)
    assert "this machine has 0.2 GB" in done.stderr
