"""Shared by the capture tests: the board emulator (the firmware's own C core behind a pseudo-terminal), real clips."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def emulator_binary(tmp_path_factory):
    if os.name != "posix" or not (shutil.which("cc") and shutil.which("make")):
        pytest.skip("the emulator needs a POSIX system with cc and make")
    build = tmp_path_factory.mktemp("firmware")
    subprocess.run(
        ["make", "-C", ROOT / "firmware", f"BUILD={build}", build / "emulator"], check=True, capture_output=True
    )
    return build / "emulator"


@pytest.fixture
def start_emulator(emulator_binary):
    """start_emulator(*arguments) -> (process, port); all are stopped at the end."""
    running = []

    def start(*arguments):
        process = subprocess.Popen(
            [emulator_binary, *map(str, arguments)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        running.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


@pytest.fixture(scope="session")
def clips():
    """Folder of the real three-camera clips, when this machine has it."""
    folder = Path(os.environ.get("GOF_CAPTURES", ROOT.parent / "shared" / "captures"))
    if not folder.is_dir():
        pytest.skip(f"no real clips at {folder} (set GOF_CAPTURES)")
    return folder
