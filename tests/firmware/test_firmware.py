"""The firmware on the host: tests under sanitizers, static analysis, and pin maps against the core."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

FIRMWARE = Path(__file__).parents[2] / "firmware"
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") and shutil.which("make")), reason="needs cc and make")


@needs_compiler
def test_core_and_esp32_layer_pass_their_tests_under_sanitizers(tmp_path):
    run = subprocess.run(
        ["make", "-C", FIRMWARE, "test", f"BUILD={tmp_path}"], capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 0, run.stdout + run.stderr
    passed = re.findall(r"^ok (\w+)", run.stdout, re.M)
    written = [
        name
        for file in ("test_core.c", "test_esp32.c")
        for name in re.findall(r"^static void (test_\w+)", (FIRMWARE / "host" / file).read_text(), re.M)
    ]
    assert sorted(passed) == sorted(written * 2)  # LEDs that light at a high and at a low level; both chips


@pytest.mark.skipif(not shutil.which("cppcheck"), reason="needs cppcheck")
def test_firmware_is_cppcheck_clean():
    run = subprocess.run(["make", "-C", FIRMWARE, "check"], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr


def pin_map(name: str) -> list[int]:
    text = re.sub(r"/\*.*?\*/", "", (FIRMWARE / "esp-idf/main" / name).read_text(), flags=re.S)
    body = re.search(r"#define GOF_PINS[\s\\]*\{(.*)\}", text, re.S).group(1)
    gray_14 = re.findall(r"#define GOF_GRAY_14 \(?(-?\d+)", text)
    return [int(p) for p in re.findall(r"-?\d+", body.replace("GOF_GRAY_14", gray_14[-1] if gray_14 else ""))]


@pytest.mark.parametrize(
    "name, forbidden, wired",
    [
        # strapping, USB console, flash and PSRAM, UART0; no pin 22..25 exists
        ("pins_esp32s3.h", {0, 3, 45, 46, 19, 20, 43, 44, *range(22, 38)}, 21),
        # console, flash, input-only; 20, 24, 28..31 do not exist
        ("pins_esp32.h", {1, 3, *range(6, 12), 20, 24, *range(28, 32), *range(34, 49)}, 20),
    ],
)
def test_pin_maps_use_distinct_pins_that_can_drive_an_led(name, forbidden, wired):
    pins = pin_map(name)
    used = [p for p in pins if p >= 0]
    assert len(pins) == 21 and len(used) == len(set(used)) == wired
    assert not set(used) & forbidden
    strips = pins[:5]
    assert len({p // 32 for p in strips}) == 1  # one register word: the five edges coincide


def test_interrupt_path_has_no_floating_point_and_no_heap():
    for path in [*sorted((FIRMWARE / "core").glob("*.c")), FIRMWARE / "esp-idf/main/main.c"]:
        code = re.sub(r"/\*.*?\*/", "", path.read_text(), flags=re.S)
        assert not re.search(r"\b(float|double|malloc|calloc|realloc|free)\b", code), path
