"""The driver board's files: whole, and wired as the firmware drives it."""

import hashlib
import re
import zipfile
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[2] / "firmware"
BOARD = FIRMWARE / "board/gof_board_driver.zip"
# Espressif, ESP32-S3-DevKitC-1 v1.1: what stands at the pins of headers J1 (here L) and J3 (here R), antenna first.
LEFT = "3V3 3V3 RST 4 5 6 7 15 16 17 18 8 3 46 9 10 11 12 13 14 5V GND".split()
RIGHT = "GND TX RX 1 2 42 41 40 39 38 37 36 35 0 45 48 47 21 20 19 GND GND".split()


def test_the_archive_is_what_its_checksum_says():
    digest, name = (FIRMWARE / "board/SHA256SUMS").read_text().split()
    assert name == BOARD.name and hashlib.sha256(BOARD.read_bytes()).hexdigest() == digest
    with zipfile.ZipFile(BOARD) as archive:
        assert archive.testzip() is None
        kinds = {Path(file).suffix for file in archive.namelist()}
        report = archive.read("drc.txt").decode()
    assert kinds == {".kicad_pcb", ".kicad_sch", ".csv", ".txt", ".gbr", ".drl"}
    assert "Found 0 unconnected pads" in report and "Found 0 Footprint errors" in report
    assert set(re.findall(r"Severity: (\w+)", report)) == {"warning"}


def nets() -> dict[str, str]:
    """Pin of the module -> its net, of those that are wired."""
    with zipfile.ZipFile(BOARD) as archive:
        text = archive.read("gof_board_driver.kicad_pcb").decode()
    module = text.partition('(footprint "gof:U1"')[2].partition("\n  (footprint ")[0]
    pads = re.split(r'\(pad "', module)[1:]
    found = {pad.partition('"')[0]: re.search(r'\(net \d+ "([^"]+)"\)', pad) for pad in pads}
    assert len(found) == 44
    return {pin: net[1] for pin, net in found.items() if net}


@pytest.mark.checkout
def test_the_module_is_wired_as_the_firmware_drives_it():
    header = (FIRMWARE / "esp-idf/main/pins_esp32s3.h").read_text()
    pins = re.sub(r"/\*.*?\*/|\\\\", "", header.partition("#define GOF_PINS")[2], flags=re.DOTALL)
    gpios = [int(number) for number in re.findall(r"\d+", pins)]
    assert len(gpios) == 21
    outputs = [*(f"OUT_S{k}" for k in range(5)), *(f"OUT_G{k}" for k in range(15)), "OUT_D"]
    expected = {str(gpio): output for gpio, output in zip(gpios, outputs, strict=True)}
    expected |= {"GND": "GND", "5V": "MODULE_5V"}
    places = {f"L{k + 1}": at for k, at in enumerate(LEFT)} | {f"R{k + 1}": at for k, at in enumerate(RIGHT)}
    assert nets() == {place: expected[at] for place, at in places.items() if at in expected}
