"""`gof doctor`: what this machine has, what each part is for, and how to get what is missing."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from gof.core.errors import GofError, printable
from gof.core.files import write_json
from gof.host.checks import checks, examine
from gof.host.terminal import console

DEMO = ("OpenEXR", "Blender", "Mantaflow")  # what making fires needs, and nothing else
STYLES = {"ok": "green", "missing": "yellow", "broken": "bold red"}


@dataclass
class DoctorConfig:
    """Check this machine: Python, Blender and its Mantaflow (a real 3-frame bake), Dr.Jit, CUDA, OpenEXR, disk,
    weights.

    Exit status 0: what is installed works. 1: something is broken (the table says how to mend it). What is missing is
        optional. The whole table belongs into a bug report.
    """

    json: Path | None = None
    """Also write the findings to this file."""


def main(argv: list[str]) -> int:
    """Run the checks, print one line each. Raises GofError: something needed is broken."""
    config = tyro.cli(DoctorConfig, prog="gof doctor", args=argv)
    from rich.text import Text

    out = console()
    with out.status("looking at this machine (a real 3-frame bake takes some seconds)"):
        findings = examine(checks())
    for finding in findings:
        status = (f"{finding.status:<8}", STYLES[finding.status])
        out.print(Text.assemble(status, (finding.name, "bold"), printable(f" ({finding.purpose}): {finding.detail}")))
    if config.json:
        write_json(config.json, {"checks": [asdict(finding) for finding in findings]})
    broken = [finding.name for finding in findings if finding.status == "broken"]
    if broken:
        raise GofError(f"not ready: {', '.join(broken)}")
    absent = [finding.name for finding in findings if finding.status == "missing" and finding.name in DEMO]
    out.print("ready, but for `gof generate` and `gof demo`" if absent else "ready: `gof demo` has all it needs")
    return 0
