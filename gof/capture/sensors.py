"""What is known of rolling-shutter sensors, as data (sensors.json)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from typing import ClassVar

from gof.core.errors import DataFormatError
from gof.core.records import read_record


@dataclass(frozen=True)
class Sensor:
    """A camera mode.

    Attributes:
        width, height: native size in pixels.
        row_time_us: from sensor row to sensor row.
        source: where that is from.
    """

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


@dataclass(frozen=True)
class SensorTable:
    """sensors.json, by name of the mode. What else it holds (measurements, notes) is for people."""

    SCHEMA: ClassVar[str] = "gof-sensors"
    VERSION: ClassVar[int] = 1

    sensors: dict[str, Sensor]


def sensor(name: str) -> Sensor:
    """A sensor of the table by name.

    Raises: DataFormatError: not in the table (names those that are).
    """
    table = read_record(SensorTable, files("gof.capture") / "sensors.json").sensors
    if name not in table:
        raise DataFormatError(
            f"no sensor '{name}' in the table; it has {', '.join(table)}. Or give the row time itself"
        )
    return table[name]
