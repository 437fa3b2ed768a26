"""`gof evaluate` in a Python that has gof, beside Blender's own."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from .dataset_process import JobError
from .io import FileFormatError
from .scores import Scores

INSTALL = (
    "install it there: in the folder of the Gaussians on Fire source run `make setup`, and choose its .venv/bin/python "
    "(Windows: .venv\\Scripts\\python.exe)"
)


class EvaluationError(JobError):
    """The scores could not be computed; the message says why and what to do."""


class Evaluation:
    """A running evaluation.

    Attributes:
        scores: what `gof evaluate --json` has found, once `poll` is false.

    Raises:
        EvaluationError: that Python cannot be started.
    """

    def __init__(self, python: Path, result: Path, dataset: Path, time_unit_s: float = 0.0):
        """``time_unit_s``: seconds per unit of a foreign result's time; 0 = the file says it."""
        self.scores = Scores()
        self._folder = Path(tempfile.mkdtemp(prefix="gof-score-"))
        self._started = time.monotonic()
        if len(python.parts) > 1:
            python = python.absolute()  # not resolved: a virtual environment's is a link
        command = [str(python), "-m", "gof", "evaluate", str(result.absolute()), "--truth", str(dataset.absolute())]
        command += ["--no-images", "--json", str(self._folder / "scores.json")]
        command += ["--time-unit", repr(time_unit_s)] if time_unit_s else []
        self._log = self._folder / "log.txt"
        try:
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, cwd=self._folder
                )
        except OSError as error:
            shutil.rmtree(self._folder)
            raise EvaluationError(
                f"{python}: cannot be run ({error.strerror}); choose the Python that gof is installed in, or {INSTALL}"
            ) from None
        self._python = python

    def __str__(self) -> str:
        return f"gof evaluate, {time.monotonic() - self._started:.0f} s"

    def poll(self) -> bool:
        """Whether it still runs. Raises: EvaluationError when it failed."""
        status = self._process.poll()
        if status is None:
            return True
        try:
            if status:
                raise EvaluationError(self._reason())
            self.scores = Scores.read(self._folder / "scores.json")
        except FileFormatError as error:
            raise EvaluationError(str(error)) from None
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)
        return False

    def run(self) -> None:
        """Wait until the scores are there. Raises: EvaluationError."""
        self._process.wait()
        self.poll()

    def stop(self) -> None:
        """End it; nothing is kept."""
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _reason(self) -> str:
        text = self._log.read_text(encoding="utf-8", errors="replace").strip()
        if "No module named gof" in text:
            return f"{self._python}: this Python has no gof; {INSTALL}"
        lines = text.splitlines()
        said = [line for line in lines if line.startswith("gof evaluate:")] or lines[-3:] or ["no message"]
        return "\n".join(said)
