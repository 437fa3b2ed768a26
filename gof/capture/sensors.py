"""What is known of rolling-shutter sensors, as data (sensors.json)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

from gof.errors import DataFormatError
from gof.io.files import read_json


@dataclass(frozen=True)
class Sensor:
    """A camera mode: native size in pixels, frames per second, time from sensor row to row in us, where that is from."""

    camera: str
    width: int
    height: int
    fps: float
    row_time_us: float
    source: str

    def image_row_time_us(self, lines: int) -> float:
        """Row time of a picture whose `lines` lines show all sensor rows.

        Raises: ValueError for lines < 1.
        """
        if lines < 1:
            raise ValueError(f"a picture with {lines} lines")
        return self.row_time_us * self.height / lines


def sensor(name: str) -> Sensor:
    """A sensor of the table by name.

    Raises: DataFormatError: not in the table (names those that are).
    """
    table = read_json(files("gof.capture") / "sensors.json")["sensors"]
    if name not in table:
        raise DataFormatError(
            f"no sensor '{name}' in the table; it has {', '.join(table)}. Or give the row time itself"
        )
    d = table[name]
    return Sensor(d["camera"], d["width"], d["height"], d["fps"], d["row_time_us"], d["source"])
