"""`gof doctor`: what this machine has, what each part is for, and how to get what is missing."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from gof.commands.cli import where_to_ask
from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError, printable
from gof.host.checks import checks, examine
from gof.host.terminal import console

DEMO = ("OpenEXR", "Blender", "Mantaflow")  # what making fires needs, and nothing else
STYLES = {"ok": "green", "missing": "yellow", "broken": "bold red"}


@dataclass
class DoctorConfig:
    """Check this machine: Python, Blender and its Mantaflow (a real 3-frame bake), Dr.Jit, CUDA, OpenEXR, disk,
    weights.

    Examples:
      gof doctor

    Exit status 0: everything installed works. 1: something is broken (the table names the repair). Missing parts are
    optional. Put the whole table into a bug report.
    """


def main(argv: list[str]) -> int:
    """Run the checks, print one line each. Raises GofError: something needed is broken."""
    read_options(DoctorConfig, "doctor", argv)
    from rich.text import Text

    out = console()
    with out.status("looking at this machine (a real 3-frame bake takes some seconds)"):
        findings = examine(checks())
    for finding in findings:
        status = (f"{finding.status:<8}", STYLES[finding.status])
        out.print(Text.assemble(status, (finding.name, "bold"), printable(f" ({finding.purpose}): {finding.detail}")))
    write_figures({"checks": [asdict(finding) for finding in findings]})
    broken = [finding.name for finding in findings if finding.status == "broken"]
    if where := where_to_ask():
        out.print(where)
    if broken:
        raise GofError(f"not ready: {', '.join(broken)}")
    absent = [finding.name for finding in findings if finding.status == "missing" and finding.name in DEMO]
    out.print("ready, but for `gof generate` and `gof demo`" if absent else "ready: `gof demo` has all it needs")
    return 0
