"""A fire from OpenVDB files, written with Blender's library as other programs do, against the field they hold."""

import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

from gof_benchmark.solvers import vdb
from gof_benchmark.solvers.grids import FireGrids
from gof_blender.core.errors import DataFormatError
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.fires import FireStore
from tests.blender.runs import TOY, in_blender

WRITE = """
    import numpy as np
    from gof_blender.scene import images
    import openvdb
    folder, up, kind = sys.argv[1:]
    for frame in (9, 10):
        grids = []
        for name, vectors in (("vel", True), ("flames", False), ("heat", False)):
            edge = 0.1 if kind == "odd" and name == "heat" else 0.05
            matrix = np.diag([edge, edge, edge, 1.0])
            matrix[3, :3] = (-1.0, 0.2, 0.3)
            i = np.stack(np.meshgrid(np.arange(8), np.arange(6), np.arange(5), indexing="ij"), -1)
            place = i * 0.05 + matrix[3, :3] + np.array([0.05, 0.1, 0.0])  # the first index is (1, 2, 0)
            if kind == "staggered" and vectors:  # each component half a cell below
                place = place - 0.025
            x, y, z = np.moveaxis(place, -1, 0)
            if vectors:
                values = np.stack([1 + x, 2 + y, 3 + z + frame], -1)
            else:
                values = np.full(x.shape, {"flames": 0.5, "heat": 16.2695}[name])  # 1900 K below
            parts = {name: values}
            if kind in (".", "_") and vectors:  # three grids of numbers
                parts = {f"{name}{kind}{axis}": values[..., k] for k, axis in enumerate("xyz")}
            for part, numbers in parts.items():
                grid = openvdb.Vec3SGrid() if numbers.ndim == 4 else openvdb.FloatGrid()
                if kind == "staggered" and vectors:
                    grid.gridClass = openvdb.GridClass.STAGGERED
                grid.saveFloatAsHalf = kind == "."
                grid.copyFromArray(np.ascontiguousarray(numbers, np.float32), ijk=(1, 2, 0))
                grid.name, grid.transform = part, openvdb.createLinearTransform(matrix.tolist())
                grids.append(grid)
        openvdb.write(f"{folder}/cache_{frame}.vdb", grids)
"""
OPTIONS = ["--velocity", "vel", "--flame", "flames", "--temperature", "heat", "--kelvin", "100"]
OPTIONS += ["--kelvin-at-0", "273.05", "--rate-hz", "24"]


def written(folder, up="z", kind="plain"):
    pytest.importorskip("bpy", reason="OpenVDB files are read by the bpy wheel")
    in_blender(WRITE, folder, up, kind)
    return [str(path) for path in folder.glob("*.vdb")][::-1]


@pytest.mark.blender
@pytest.mark.parametrize("up, kind", [("z", "plain"), ("y", "plain"), ("z", "staggered"), ("z", "."), ("y", "_")])
def test_the_field_of_the_files_is_the_fires(tmp_path, up, kind):
    """In centimetres and cm/s. Frame 9 comes before 10; with y up, (x, y, z) of the files is (x, -z, y).

    Kinds "." and "_" have velocity as three grids of numbers, "." in half floats, too.
    """
    files = written(tmp_path, up, kind)
    out = tmp_path / "fire"
    assert (
        vdb.main([*files, "--out", str(out), *OPTIONS, "--up", up, "--metres", "0.01", "--velocity-m-s", "0.01"]) == 0
    )
    fire = FireGrids.open(out)
    fire.check()
    assert fire.times_s == pytest.approx([0, 1 / 24])
    inner = (slice(0, -1),) * 3 if kind == "staggered" else (slice(None),) * 3  # the last faces are not stored
    for index, frame in enumerate((9, 10)):
        centre = 100 * fire.velocity.frame(index).cell_centers()
        x, y, z = np.moveaxis(centre, -1, 0)
        if up == "z":
            wanted = np.stack([1 + x, 2 + y, 3 + z + frame], -1)
        else:  # the files' y is z, their z is -y
            wanted = np.stack([1 + x, -(3 - y + frame), 2 + z], -1)
        found = 100 * fire.velocity.frame(index).velocity
        assert np.abs(found - wanted)[inner].max() < (8e-3 if kind == "." else 2e-5)  # a half has 11 bits: 14 / 2048
        emission = fire.grids["emission"].cells(index)
        assert emission[..., 0] == pytest.approx(
            7.0, rel=3e-3 if kind == "." else 1e-4
        )  # half of a black body's 14 at 1900 K
    assert centre[..., 0].min() == pytest.approx(-0.95) and centre.shape[:3] == ((8, 6, 5) if up == "z" else (8, 5, 6))
    spec = TOY.to_dict() | {"fire": {"grids": str(out)}, "domain": None, "effects": []}
    assert scene_spec.SceneSpec.from_dict(spec).fire.store.grid == centre.shape[:3]


@pytest.mark.blender
def test_what_does_not_fit_is_refused_by_file_and_grid(tmp_path, capsys):
    files = written(tmp_path, kind="odd")
    out = tmp_path / "fire"
    assert vdb.main([*files, "--out", str(out), *OPTIONS]) == 1
    assert "'heat' has other cells" in " ".join(capsys.readouterr().out.split())
    assert vdb.main([*files, "--out", str(out), "--rate-hz", "24", "--kelvin-at-0", "1700", "--velocity", "v"]) == 1
    assert "no grid 'v' can be read" in " ".join(capsys.readouterr().out.split())
    (tmp_path / "cache_11.vdb").write_bytes(b"no VDB")
    broken = [str(tmp_path / "cache_11.vdb"), "--out", str(out), *OPTIONS]
    assert vdb.main(broken) == 1 and "cache_11.vdb" in "".join(capsys.readouterr().out.split())
    assert not out.exists()


CACHE = """
    import numpy as np
    from gof_blender.scene import images
    import openvdb
    folder, *names = sys.argv[1:]
    for k, name in enumerate(names):
        name, _, missing = name.partition("-")
        grids = []
        for grid, value in ((openvdb.Vec3SGrid(), (0.0, 0.0, 1.0 + k)), (openvdb.FloatGrid(), 1.0)):
            grid.name = "flame" if isinstance(value, float) else "velocity"
            grid.transform = openvdb.createLinearTransform(0.05)
            grid.copyFromArray(np.full((4, 4, 4, *np.shape(value)), value, np.float32))
            grids += [] if grid.name == missing else [grid]
        openvdb.write(f"{folder}/{name}.vdb", grids)
"""


def cached(folder, *names):
    """A file for each name; NAME-flame lacks that grid. The gas of the n-th one rises with n m/s."""
    pytest.importorskip("bpy", reason="OpenVDB files are read by the bpy wheel")
    in_blender(CACHE, folder, *names)
    (folder / f"._{names[0].partition('-')[0]}.vdb").write_bytes(b"AppleDouble")
    files = sorted(str(path) for path in [*folder.glob("*.vdb"), *folder.glob("._*")])
    return [*files, "--out", str(folder / "fire"), "--rate-hz", "24", "--kelvin-at-0", "1700"]


def rise(fire):
    """(T,) m/s."""
    return [fire.velocity.frame(k).velocity[1, 1, 1, 2] for k in range(len(fire.times_s))]


@pytest.mark.blender
def test_the_clock_is_that_of_the_numbers(tmp_path, capsys):
    """1003 was lost; a size stands behind the number; 999 comes before 1000."""
    names = [f"fire.{k}_64x64" for k in (999, 1000, 1001, 1002, 1004)]
    assert vdb.main(cached(tmp_path, *names)) == 0
    assert "1 files are missing (1003)" in " ".join(capsys.readouterr().out.split())
    fire = FireGrids.open(tmp_path / "fire")
    assert fire.times_s == pytest.approx([0, 1 / 24, 2 / 24, 3 / 24, 5 / 24])
    assert rise(fire) == pytest.approx([1, 2, 3, 4, 5])


@pytest.mark.blender
def test_frames_before_the_fire_burns_are_dark(tmp_path, capsys):
    names = ["fire.0000-flame", "fire.0001-flame", "fire.0002", "fire.0003"]
    assert vdb.main(cached(tmp_path, *names)) == 0
    assert "fire.0000.vdb, fire.0001.vdb: without the grid 'flame'" in " ".join(capsys.readouterr().out.split())
    fire = FireGrids.open(tmp_path / "fire")
    light = [float(np.max(fire.grids["emission"].cells(k))) for k in range(4)]
    assert light[:2] == [0, 0] and min(light[2:]) > 0
    assert rise(fire) == pytest.approx([1, 2, 3, 4])


@pytest.mark.blender
@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["fire_v1.0000", "fire_v1.0001", "fire_v2.0000"], "has the number 0, and so has fire_v1.0000.vdb"),
        (["fire_v1.0000", "fire_v2.0001"], "differ in more than the frame's number"),
        (["fire.0000", "fire"], "fire.vdb: its name has no frame number"),
        (["fire.0000", "fire.0001-velocity"], "fire.0001.vdb: no grid 'velocity' can be read there; it has flame"),
        (["fire.0000-flame", "fire.0001-flame"], "no grid 'flame' can be read there; it has velocity"),
    ],
)
def test_files_that_are_no_one_sequence_are_refused_by_name(tmp_path, capsys, names, said):
    assert vdb.main(cached(tmp_path, *names)) == 1
    assert said.replace(" ", "") in "".join(capsys.readouterr().out.split())
    assert not (tmp_path / "fire").exists()


def test_light_needs_a_temperature(tmp_path, capsys):
    assert vdb.main(["x.vdb", "--out", str(tmp_path / "fire"), "--rate-hz", "24"]) == 1
    assert "--temperature" in capsys.readouterr().out


@pytest.mark.blender
def test_the_command_that_the_panel_gives_does_it(tmp_path):
    """The line of the message, in a shell as it stands, with the names of these files' grids put in."""
    folder = tmp_path / "my cache"
    folder.mkdir()
    written(folder)
    with pytest.raises(DataFormatError) as error:
        FireStore(folder)
    command = re.search(r"python (-m gof_benchmark.solvers.vdb .*); then choose", str(error.value))[1]
    command = command.replace("--velocity velocity", "--velocity vel").replace("--flame flame", "--flame flames")
    subprocess.run(f"{shlex.quote(sys.executable)} {command}", shell=True, check=True, cwd=tmp_path)
    assert FireStore(tmp_path / "my cache_fire").velocity.times_s.tolist() == pytest.approx([0, 1 / 24])
