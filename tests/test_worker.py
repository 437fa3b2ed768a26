"""Child processes: their costs and progress, and what stays after a failure."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from gof.core.errors import GofError
from gof.host.worker import run_worker


@pytest.mark.long
def test_worker_reports_cost_and_last_figures(tmp_path):
    code = (
        "from gof.host.terminal import progress_bar; x = bytearray(150 << 20); import time\n"
        "with progress_bar('work') as update:\n"
        "  [update(i, 3, note='n') or time.sleep(.4) for i in range(1, 4)]\n"
        "print('chatter')"
    )
    cost = run_worker([sys.executable, "-c", code], "work", tmp_path / "log.txt")
    assert 1.2 <= cost.seconds < 20 and cost.peak_mb > 150
    assert cost.settings["done"] == 3 and (tmp_path / "log.txt").read_text() == "chatter\n"


def test_failing_worker_shows_its_last_words(tmp_path):
    with pytest.raises(GofError, match=r"status 3(.|\n)*the reason"):
        run_worker([sys.executable, "-c", "print('the reason'); raise SystemExit(3)"], "work")


def test_progress_passes_through_nested_workers():
    inner = "from gof.host.terminal import report_progress; report_progress('inner', 2, 2)"
    outer = (
        f"import sys; from gof.host.worker import run_worker; run_worker([sys.executable, '-c', {inner!r}], 'outer')"
    )
    assert run_worker([sys.executable, "-c", outer], "top").settings["stage"] == "inner"


@pytest.mark.skipif(
    sys.platform != "linux", reason="kept by the Linux kernel; elsewhere the worker stops at its next progress line"
)
def test_killing_the_parent_kills_the_whole_chain(tmp_path):
    inner = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    outer = (
        f"import sys; from gof.host.worker import run_worker; run_worker([sys.executable, '-c', {inner!r}], 'inner')"
    )
    top = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"import sys; from gof.host.worker import run_worker; run_worker([sys.executable, '-c', {outer!r}], 'x')",
        ]
    )
    for _ in range(200):
        if (tmp_path / "pid").exists() and (tmp_path / "pid").read_text():
            break
        time.sleep(0.1)
    pid = int((tmp_path / "pid").read_text())
    os.kill(top.pid, signal.SIGKILL)
    top.wait()
    for _ in range(50):
        if not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return
        time.sleep(0.1)
    pytest.fail("the innermost worker still runs")
