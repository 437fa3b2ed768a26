"""Messages of a worker to the process that started it: progress, and its costs. Blender's own prints go to a log."""

from __future__ import annotations

import json
import os
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path


class Reporter:
    """Prints progress lines to the original standard output and sends everything else that is printed to a log file.

    Blender's own messages are buffered in C and would otherwise cut progress lines in two.
    """

    def __init__(self, stage: str, log: Path):
        self.stage = stage
        log.parent.mkdir(parents=True, exist_ok=True)
        self._out = os.fdopen(os.dup(1), "w")
        sys.stdout.flush()
        with open(log, "ab") as file:
            os.dup2(file.fileno(), 1)

    def __call__(self, done: int, total: int) -> None:
        self.line(progress={"stage": self.stage, "done": done, "total": total})

    def line(self, **message) -> None:
        print(json.dumps(message), file=self._out, flush=True)


def exit_status(work: Callable[[], None], *wrong: type[Exception]) -> int:
    """Do the work, and return the status to end with: 0; 2 where it raised one of `wrong`, which is what its caller can
    mend and prints one line; 1 after anything else, with its traceback."""
    try:
        work()
    except wrong as error:
        print(error, file=sys.stderr)
        return 2
    except Exception:
        traceback.print_exc()
        return 1
    return 0


def leave(status: int) -> None:
    """End this process, which may have baked: the wheel's own exit would abort then."""
    if "bpy" in sys.modules:
        from ..scene import mantaflow

        mantaflow.leave(status)
    sys.exit(status)


def run_alone(main: Callable[[list[str]], int], argv: list[str]) -> None:
    """Run a worker's command line as the only work of this process, and leave it; leave at once when standard input
    closes, which is when the process that started this one ends."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
    leave(main(argv))
