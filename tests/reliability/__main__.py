"""The command line: `python -m tests.reliability fuzz|kill`."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass
class Fuzz:
    """Damaged inputs of every format through its public reader."""

    count: int = 2000
    """Inputs, over all formats."""
    seed: int = 0
    """Input number k of a format is the same at the same seed."""
    jobs: int = 2
    """Reader processes at a time."""
    only: tuple[str, ...] = ()
    """Names of formats; default: all."""
    out: Path = Path("out/reliability")
    """Folder for the inputs that failed, and for how far the campaign is: ended and begun again, it goes on. Choose
    another one after a change of the code."""

    def run(self) -> int:
        from tests.reliability import fuzz

        begin = time.perf_counter()
        tallies = fuzz.campaign(self.count, self.seed, self.jobs, self.only, self.out / "progress")
        for tally in tallies:
            fuzz.keep(tally, self.seed, self.out)
        print(fuzz.table(tallies))
        failures = sum(len(tally.failures) for tally in tallies)
        print(f"{time.perf_counter() - begin:.0f} s" + (f"; failed inputs in {self.out}" if failures else ""))
        return 1 if failures else 0


@dataclass
class Kill:
    """kill -9 at random moments of `gof generate` and `gof reconstruct`, resumed until they are done."""

    times: int = 50
    """Kills, half of each command."""
    seed: int = 0
    """Of the moments."""
    only: tuple[str, ...] = ()
    """generate or reconstruct; default: both. The reconstruction needs the dataset of the first."""
    out: Path = Path("out/reliability-kill")
    """New folder for all runs."""

    def run(self) -> int:
        from tests.reliability import kill

        status = False
        print(
            "| command | uninterrupted | kills | runs to the end | finished files left by kills | rewritten | lost | "
            "spoilt | failed | difference |"
        )
        print("|" + "---|" * 10)
        for command in kill.commands(self.out):
            if not self.only or command.name in self.only:
                times = self.times if self.only else self.times // 2
                outcome = kill.campaign(command, times, self.seed, self.out)
                print(kill.report(outcome), flush=True)
                status |= any(outcome.faults().values())
        return int(status)


def main(argv: list[str] | None = None) -> int:
    """Run a campaign. Returns 1 if something failed."""
    return tyro.cli(Fuzz | Kill, prog="python -m tests.reliability", args=argv).run()


if __name__ == "__main__":
    sys.exit(main())
