"""Sensor tracks that somebody made to harm: deep, wide, or both."""

import struct
import time

import pytest

from gof.core.errors import DataFormatError
from gof.ingest import accelerometer
from gof.ingest.accelerometer import read_tilt
from tests.ingest.gopro import box, film


def nested(levels: int) -> bytes:
    """Entries in entries."""
    content = b""
    for _ in range(levels):
        content = struct.pack(">4scBH", b"DEVC", b"\0", 1, len(content)) + content
    return content


def tables(path, chunks, runs, sizes):
    """A file whose `gpmd` track has these tables, over eight bytes of zeros at place 8."""
    stsd = box(b"stsd", struct.pack(">II", 0, 1), struct.pack(">I4s", 16, b"gpmd"), bytes(8))
    stsz = box(b"stsz", struct.pack(f">III{len(sizes)}I", 0, 0, len(sizes), *sizes))
    stco = box(b"stco", struct.pack(f">II{len(chunks)}I", 0, len(chunks), *chunks))
    flat = [number for run in runs for number in run]
    stsc = box(b"stsc", struct.pack(f">II{len(flat)}I", 0, len(runs), *flat))
    stbl = box(b"stbl", stsd, stsz, stco, stsc)
    path.write_bytes(box(b"mdat", bytes(8)) + box(b"moov", box(b"trak", box(b"mdia", box(b"minf", stbl)))))
    return path


def test_entries_that_lie_deep_in_each_other_are_refused(tmp_path):
    """3000 deep in 24 kB; the sensor is not believed, and said, and the footage is still read."""
    path = film(tmp_path / "deep.mp4", nested(3000))
    with pytest.raises(DataFormatError, match="more than 8 deep"):
        list(accelerometer.streams(path))
    assert "deep.mp4: its track of sensor data (GPMF) is damaged" in read_tilt(path, "none").why
    assert list(accelerometer.streams(film(tmp_path / "flat.mp4", nested(4)))) == []


def test_tables_take_time_by_their_length_not_by_its_square(tmp_path):
    """As many chunks and runs as are allowed: the square took minutes of a CPU."""
    count = accelerometer.MOST_SAMPLES
    path = tables(tmp_path / "a.mp4", [8] * count, [(k + 1, 1, 1) for k in range(count)], [0] * count)
    begun = time.process_time()
    assert list(accelerometer.streams(path)) == []
    assert time.process_time() - begun < 10
    same = tables(tmp_path / "b.mp4", [8] * count, [(2**32 - 1, 1, 1)] * count, [0] * count)
    with pytest.raises(DataFormatError, match="does not grow"):
        list(accelerometer.streams(same))


def test_samples_lie_where_the_runs_say(tmp_path):
    """ISO/IEC 14496-12, 8.7.4: chunks 1 and 2 hold two samples each, from chunk 3 on one each."""
    path = tables(tmp_path / "a.mp4", [100, 200, 300, 400], [(1, 2, 1), (3, 1, 1)], [1, 2, 3, 4, 5, 6])
    header = path.read_bytes()
    at = header.index(b"stbl") + 4
    assert list(accelerometer._places(header, at, len(header))) == [
        (100, 1), (101, 2), (200, 3), (203, 4), (300, 5), (400, 6),
    ]  # fmt: skip
