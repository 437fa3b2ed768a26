"""`gof baseline`: other methods' training code without CUDA, in a process of its own."""

from __future__ import annotations

import os

from gof.host import extras
from gof.host.processes import python_command, run

# Threads that wait by turning round cost several times the work itself where cores are few.
ENVIRONMENT = {"OMP_WAIT_POLICY": "passive", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
# Large gradients come and go in each step: from the system anew, their pages cost more than their sums (glibc).
ENVIRONMENT |= {"MALLOC_MMAP_THRESHOLD_": "1000000000", "MALLOC_TRIM_THRESHOLD_": "8000000000"}


def main(argv: list[str]) -> int:
    """Run `gof baseline`; PyTorch is changed in another process alone.

    Raises:
        MissingDependencyError: PyTorch is absent.
    """
    extras.require("torch", "torch", "other methods' training code")
    return run(python_command("-m", "gof.on_cpu", *argv), env=ENVIRONMENT | os.environ).returncode
