"""`gof capture check-footage`: a minute's look at films of a fire, before the long work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.errors import printable
from gof.host.terminal import console
from gof.ingest.look_over import look_over, summary

SIGNS = {"good": ("✓", "green"), "look": ("!", "yellow"), "bad": ("✗", "bold red")}


@dataclass(frozen=True)
class CheckFootageConfig:
    """Check films of a fire for problems that will spoil a reconstruction, and advise how to film better.

    Examples:
      gof capture check-footage cam_0.mp4 cam_1.mp4 cam_2.mp4

    Looks at the flame's exposure, size and speed, at what it hides all the time, at shake and changes of exposure, at
    rates, repeats and HDR, whether the cameras see the same things, and whether the films' clocks can be found. Exit
    status 0: nothing is bad.
    """

    videos: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="VIDEO ...")]]
    """The cameras' own files of one take."""


def main(argv: list[str]) -> int:
    """Print a line for everything that was looked at, and a remedy where one is needed."""
    config = read_options(CheckFootageConfig, "capture check-footage", argv)
    from rich.text import Text

    out = console()
    found = look_over(config.videos)
    for who in dict.fromkeys(finding.camera for finding in found):
        out.print(Text(printable(who or "together"), "bold"))
        for finding in (f for f in found if f.camera == who):
            sign, style = SIGNS[finding.verdict]
            remedy = f" -> {finding.remedy}" if finding.remedy else ""
            words = printable(f" {finding.about:<8} {finding.words}{remedy}")
            out.print(Text.assemble("  ", (printable(sign), style), words), soft_wrap=True)
    content = summary(found)
    write_figures(content)
    return int(content["verdict"] == "bad")
