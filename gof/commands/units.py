"""Numbers of a command line with their units, which help shows in place of the value."""

from typing import Annotated

import tyro

from gof.core.ladder import METAVAR

Seconds = Annotated[float, tyro.conf.arg(metavar="SECONDS")]
Microseconds = Annotated[float, tyro.conf.arg(metavar="US")]
Rate = Annotated[float, tyro.conf.arg(metavar="FPS")]
Metres = Annotated[float, tyro.conf.arg(metavar="M")]
Millimetres = Annotated[float, tyro.conf.arg(metavar="MM")]
Inches = Annotated[float, tyro.conf.arg(metavar="IN")]
Degrees = Annotated[float, tyro.conf.arg(metavar="DEG")]
Megabytes = Annotated[float, tyro.conf.arg(metavar="MB")]
Pixels = Annotated[int, tyro.conf.arg(metavar="PX")]
Preset = Annotated[str, tyro.conf.arg(metavar=METAVAR)]
