"""A reconstruction is scored in another process: by `gof evaluate` in a Python that has gof, or by `worker.score` in
another Blender like this one."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from ..core.errors import GofError
from ..core.time_left import TimeLeft, duration
from .child import JobError, WorkerMessages, code
from .dve import MotionScores

INSTALL = (
    "install it there: in the folder of the Gaussians on Fire source run `make setup`, and choose its .venv/bin/python "
    "(Windows: .venv\\Scripts\\python.exe); without a Python the add-on scores by itself"
)


ONE_AFTER_THE_OTHER = (
    "import sys; from gof.commands.cli import main; words = sys.argv[1:]; k = words.index('then'); "
    "sys.exit(main(words[:k]) or main(words[k + 1:]))"
)


class EvaluationError(JobError):
    """The scores could not be computed; the message says why and what to do."""


class Evaluation:
    """A running evaluation; `by_gof` and `by_addon` begin one.

    Attributes:
        by: who computes, in words.
        scores: what was found, once `poll` is false.
    """

    def __init__(self, by: str, command: list[str], folder: Path):
        """``command`` writes folder/scores.json. Raises EvaluationError: it cannot be started."""
        self.by, self.scores = by, MotionScores()
        self._folder, self._program = folder, command[0]
        self._log = folder / "log.txt"
        self._started = time.monotonic()
        self._pace, self._heard = TimeLeft(), 0
        try:
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, cwd=folder
                )
        except OSError as error:
            shutil.rmtree(folder)
            raise EvaluationError(
                f"{command[0]}: cannot be run ({error.strerror}); choose the Python that gof is installed in, or "
                f"{INSTALL}"
            ) from None
        self._messages = WorkerMessages(self._process.stdout)

    @classmethod
    def by_gof(cls, python: Path, result: Path, dataset: Path, time_unit_s: float = 0.0) -> Evaluation:
        """Args: time_unit_s: seconds per unit of a foreign result's time; 0 = the file states it."""
        folder = Path(tempfile.mkdtemp(prefix="gof-score-"))
        if len(python.parts) > 1:
            python = python.absolute()  # not resolved: a virtual environment's is a link
        result, written = result.absolute(), folder / "result.npz"
        evaluate = ["evaluate", str(written if time_unit_s else result), "--dataset", str(dataset.absolute())]
        evaluate += ["--no-images", "--json", str(folder / "scores.json")]
        words = [str(python), "-m", "gof", *evaluate]
        if time_unit_s:  # what the file does not say goes into a copy in our format, not into the user's folder
            convert = ["convert", str(result), str(written), "--time-unit", repr(time_unit_s)]
            words = [str(python), "-c", ONE_AFTER_THE_OTHER, *convert, "then", *evaluate]
        return cls("gof evaluate", words, folder)

    @classmethod
    def by_addon(cls, blender: list[str], result: Path, dataset: Path, time_unit_s: float = 0.0) -> Evaluation:
        """Args: blender: a command that runs the Python code given as its next argument, in another Blender."""
        folder = Path(tempfile.mkdtemp(prefix="gof-score-"))
        arguments = ["--result", str(result.absolute()), "--dataset", str(dataset.absolute())]
        arguments += ["--out", str(folder / "scores.json"), "--clip-seconds", repr(time_unit_s)]
        return cls("the add-on", [*blender, code("score", arguments)], folder)

    def __str__(self) -> str:
        seconds = time.monotonic() - self._started
        self._messages.read()
        if not self._messages.done:
            return f"{self.by}, {seconds:.0f} s"
        if self._messages.done != self._heard:
            self._heard = self._messages.done
            self._pace.reach("frames", self._messages.share)
        left = self._pace.seconds
        remaining = "" if left is None else f", {duration(left)} left"
        return f"frame {self._messages.done} of {self._messages.total}{remaining}"

    def poll(self) -> bool:
        """Return whether it still runs. Raises: EvaluationError when it failed."""
        status = self._process.poll()
        if status is None:
            return True
        self._messages.read_rest()
        try:
            if status:
                raise EvaluationError(self._reason())
            self.scores = MotionScores.read(self._folder / "scores.json")
        except GofError as error:
            raise EvaluationError(str(error)) from None
        finally:
            self._leave()
        return False

    def run(self) -> None:
        """Wait until the scores are there. Raises: EvaluationError."""
        self._process.wait()
        self.poll()

    def stop(self) -> None:
        """End it; nothing is kept."""
        self._process.kill()
        self._process.wait()
        self._messages.read_rest()
        self._leave()

    def _leave(self) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _reason(self) -> str:
        text = self._log.read_text(encoding="utf-8", errors="replace").strip()
        if "No module named gof" in text:
            return f"{self._program}: this Python has no gof; {INSTALL}"
        lines = text.splitlines()
        shown = (
            [line for line in lines if line.startswith(("gof evaluate:", "gof convert:", "score:"))]
            or lines[-3:]
            or ["no message"]
        )
        return "\n".join(shown)
