"""Numbers that no option can mean: NaN, infinite, below zero, zero. Each is refused by its name, before any work."""

import dataclasses
import importlib
import typing
from pathlib import Path

import numpy as np
import pytest

from gof.commands.cli import COMMANDS, main
from gof.core.errors import DataFormatError, GofError
from gof.core.fields import VelocityField, VelocitySequence
from gof.dataset import Dataset
from gof.host.options import require_number
from tests.conftest import random_gaussians

NO = ("nan", "inf", "-inf", "-3", "0")
WRONG = {  # command and what it needs, by option: values that it cannot have
    "convert RESULT OUT.ftgs.ply": {
        "--frame-time": NO,
        "--time-unit": NO,
        "--time-zero": NO[:3],
        "--clip": ("nan 1", "0 inf"),
    },
    "convert RESULT": {"--frame-time": NO, "--time-unit": NO, "--time-zero": NO[:3]},
    "convert RESULT OUT.glb": {"--time": NO[:3]},
    "share RESULT --out OUT.html": {"--pictures": NO[:4]},
    "leaderboard RESULT": {"--time": NO[:3]},
    "video RESULT --out OUT.webm": {"--fps": NO, "--max-size": ("-1", "0")},
    "video RESULT --out OUT.webm --style": {
        "slow": NO,
        "seconds": NO,
        "stop": NO[:3],
        "degrees": NO[:3],
        "reduced": NO,
    },
    "view RESULT": {"--port": ("-1", "65536", "1000000")},
    "report DATASET --dataset DATASET": {"--camera": ("-1", "99", "nobody")},
    "reconstruct DATASET --out OUT": {
        "--gaussians": ("-1", "0"),
        "--steps": ("-1", "0"),
        "--voxels": ("-1", "0"),
        "--max-size": ("-1", "0"),
        "--seed": ("-1",),
    },
    "background DATASET --out OUT": {
        "--steps": ("-1", "0"),
        "--gaussians": ("-1", "0"),
        "--max-size": ("-1", "0"),
    },
    "ingest DATASET DATASET --out OUT --times 30": {
        "--fov": (*NO, "180"),
        "--marker-mm": NO,
        "--baseline-m": NO,
        "--flame-height-m": NO,
        "--max-size": ("-1", "0"),
        "--plates": ("steady:0", "minimum:x"),
        "--frames": ("-1", "0"),
        "--start": ("-1",),
    },
    "ingest DATASET DATASET --out OUT --fov 40": {"--times": NO},
    "capture sync DATASET --out OUT": {"--tick-us": NO, "--fps": NO, "--row-time": NO[:4]},
    "capture draw --out OUT.svg": {"--marker-mm": NO},
    "capture target --out OUT.svg": {"--square-mm": NO, "--charuco-mm": NO, "--squares": ("7", "-1x2", "0x5", "7x")},
    "capture calibrate DATASET --out OUT.json": {"--views": ("-1", "0"), "--square-mm": NO, "--charuco-mm": NO},
    "capture board monitor": {"--seconds": NO[:4]},
    "generate demo --out OUT": {"--workers": ("-1", "0")},
}


@pytest.mark.parametrize("command", WRONG)
def test_numbers_that_cannot_be_are_refused_by_name(command, tiny_dataset, tmp_path, capsys):
    random_gaussians(30).save(tmp_path / "result.npz")
    words = {"RESULT": tmp_path / "result.npz", "DATASET": tiny_dataset, "OUT": tmp_path / "out"}
    base = [str(words.get(word, word)).replace("OUT", str(tmp_path / "out")) for word in command.split()]
    for option, values in WRONG[command].items():
        for value in values:
            given = [option, *value.split()] if " " in value else [f"{option}={value}"]
            assert main([*base, *given]) == 1, (option, value)
            said = capsys.readouterr().err
            known_otherwise = ("ChArUco", "scores.json", "cameras 0 to")  # sizes of a pattern; --camera of a report
            assert option in said or any(word in said for word in known_otherwise), (option, value, said)
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


def test_every_number_of_every_command_is_in_the_list():
    """A float that a command takes and nobody checks would be found here."""
    listed = {(name.split()[0], option) for name, options in WRONG.items() for option in options}
    for name, command in COMMANDS.items():
        modules = [command.module]
        if name == "capture":
            modules = [
                f"gof.commands.{p.stem}"
                for p in Path(importlib.import_module("gof.commands").__file__).parent.glob("capture_*.py")
            ]
        for module in map(importlib.import_module, modules):
            for config in vars(module).values():
                ours = getattr(config, "__module__", "").startswith(("gof.commands", "gof_benchmark"))
                if ours and dataclasses.is_dataclass(config) and isinstance(config, type):
                    for field, kind in typing.get_type_hints(config).items():
                        if float in kinds(kind) and config.__module__.startswith("gof.commands"):
                            assert {(name, "--" + field.replace("_", "-")), (name, field)} & listed, (name, field)


def kinds(hint) -> list:
    """A type and all types in it."""
    return [hint, *(kind for inner in typing.get_args(hint) for kind in kinds(inner))]


def test_a_range_is_said():
    with pytest.raises(GofError, match="--x -1: must be 0 or more and at most 5"):
        require_number("--x", -1, least=0, most=5)
    with pytest.raises(GofError, match="--x nan: must be a finite number"):
        require_number("--x", float("nan"))
    require_number("--x", None, above=0)


def test_options_that_would_be_ignored_are_refused(tiny_dataset, tmp_path, capsys):
    result = random_gaussians(30).save(tmp_path / "result.npz")
    for command, word in (
        (["evaluate", result, "--dataset", tiny_dataset, "--published", tmp_path], "gof depth"),
        (["reconstruct", tiny_dataset, "--out", tmp_path / "o", "--flow-weights", tmp_path], "--flow memfof"),
        (["convert", result, tmp_path / "a.npz", "--clip", "0", "1"], "USD and folders only"),
        (["convert", result, tmp_path / "a.npz", "--world", tmp_path / "nothing"], "--world"),
        (["convert", result], "name a file to write"),
        (["convert", result, "--time-unit", "2", "--time", "0"], "name it (OUT)"),
    ):
        assert main([str(part) for part in command]) == 1
        assert word in capsys.readouterr().err


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 11.2 GiB"),
        ImportError("_ckdtree.so: failed to map segment from shared object"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 80 bytes"),
        RuntimeError("jit_malloc(): out of memory! Could not allocate 16 bytes"),
    ],
    ids=str,
)
def test_memory_that_ends_is_named_whoever_says_so(error, monkeypatch, capsys):
    """In the words of numpy, the loader, PyTorch and Dr.Jit. Other errors of a library stay what they are."""
    from gof.commands import doctor

    def fail(argv):
        raise error

    monkeypatch.setattr(doctor, "main", fail)
    assert main(["doctor"]) == 1
    assert "gof doctor: not enough memory" in capsys.readouterr().err
    error = RuntimeError("something else")
    with pytest.raises(RuntimeError, match="something else"):
        main(["doctor"])


# ---------------------------------------------------------------- names and links beside them


@pytest.mark.parametrize("name", ["..", "../../escape", "/tmp/escape", "a\0b", "con", "-rf", ""])
def test_a_foam_fires_name_is_a_name(name):
    """It becomes a folder: OUT/<name>."""
    from gof.core.fire import FireDescription
    from gof_benchmark.solvers.openfoam.foam_fire import find_fire

    fire = find_fire("pool_methane")
    with pytest.raises(DataFormatError, match="plain name"):
        dataclasses.replace(fire, name=name)
    with pytest.raises(DataFormatError, match="plain name"):
        FireDescription(name, "none", (0.0, 0.1), "none")


def test_a_chunk_of_a_store_is_no_link_to_elsewhere(tmp_path):
    """Its bytes would be taken for velocities; inside the store a link may stand."""
    fields = [VelocityField.from_array(np.full((4, 5, 6, 3), 0.5 + k), (-1, -1, 0), 0.5, 0.01 * k) for k in range(2)]
    for store in ("here", "there"):
        VelocitySequence.create(tmp_path / f"{store}.zarr", fields)
    chunk = next(p for p in (tmp_path / "here.zarr").rglob("*") if p.is_file() and p.name != "zarr.json")
    twin = tmp_path / "there.zarr" / chunk.relative_to(tmp_path / "here.zarr")
    chunk.unlink()
    chunk.symlink_to(twin)
    with pytest.raises(DataFormatError, match="points outside"):
        for time_s in (0.0, 0.01):
            np.asarray(VelocitySequence.open(tmp_path / "here.zarr").at(time_s).velocity)


def test_the_dataset_of_a_damaged_store_is_named(tiny_dataset):
    """And a description that is a link."""
    store = tiny_dataset / "velocity.zarr"
    inside = store / "velocity" if (store / "velocity").exists() else store
    (inside / "zarr.json").rename(tiny_dataset.parent / "zarr.json")
    (inside / "zarr.json").symlink_to(tiny_dataset.parent / "zarr.json")
    with pytest.raises(DataFormatError, match="points outside"):
        Dataset.open(tiny_dataset).velocity.at(0.0)
