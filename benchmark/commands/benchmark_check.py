"""`gof benchmark check`: a submission -> ticks and crosses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.evaluate.submission import Submission, SubmissionFinding, check
from gof.host.terminal import console
from gof_benchmark.suite.made import made_scenes

STYLES = {"ok": "green", "hint": "yellow", "refused": "bold red"}


@dataclass
class CheckConfig:
    """Check every claim of a submission that can be checked. A single failed check refuses it (exit status 1).

    Examples:
      gof benchmark check mine bench/preview

    Files are there; the clock is the clip's; no held-out frame went in; the checkpoint draws the pictures that came
    with it; held-out frames look as unseen ones do; scores come out again. Everything is computed anew, which takes as
    long as `gof evaluate` for every run.
    """

    submission: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SUBMISSION")]]
    """Folder with method.json and one folder a scene (docs/benchmark.md)."""
    suite: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SUITE")]]
    """Folder of a size of the suite: WORK/standard."""


def main(argv: list[str]) -> int:
    """Run `gof benchmark check`; 1 where the submission is refused."""
    config = read_options(CheckConfig, "benchmark check", argv)
    datasets = {name: made.dataset for name, made in made_scenes(config.suite).items()}
    out, findings = console(), []
    for finding in check(Submission.open(config.submission), datasets):
        findings.append(finding)
        out.print(str(finding), style=STYLES[finding.verdict], markup=False, highlight=False)
    out.print(verdict(findings), markup=False, highlight=False)
    write_figures({"findings": [asdict(finding) for finding in findings]})
    return 1 if any(finding.verdict == "refused" for finding in findings) else 0


def verdict(findings: list[SubmissionFinding]) -> str:
    """Return one sentence."""
    refused = [finding for finding in findings if finding.verdict == "refused"]
    hints = sum(finding.verdict == "hint" for finding in findings)
    if refused:
        return f"refused: {len(refused)} of {len(findings)} checks failed"
    return f"passed {len(findings) - hints} checks; {hints} to judge by people"
