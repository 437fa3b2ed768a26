"""The way of a dataset through `evaluate`: it is opened at the door, and few files are handed what was opened."""

import sys
from pathlib import Path

import pytest

import gof
from gof.core.fields import VelocitySequence
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.emission import FlameGrid
from gof.evaluate.sparse_grid import StoredField
from tests.evaluate.synthetic_flame import flame_dataset
from tests.evaluate.test_emission import with_a_flame_grid

OPENED = (Dataset, VelocitySequence, FlameGrid, StoredField)
ONCE = (VelocitySequence, FlameGrid)  # views of a dataset are datasets, too
SOURCES = str(Path(gof.__file__).parent)
MOST = 12  # with EVE, light in space and the settled quadrature


class Walk:
    """The files that functions of ours get something opened in, one after the other; every call counts once.

    A function that has it as `self` is its own; one that gets it from such a function is not on the way.
    """

    def __init__(self):
        self.files: list[str] = []
        self.opened = {}  # by their ids, which stay theirs as long as they are here
        self._calls = set()

    def __call__(self, frame, event, argument):
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(SOURCES) or code.co_name.startswith("<"):
            return
        caller = frame.f_back
        while caller and caller.f_code.co_name.startswith("<"):  # comprehensions and lambdas
            caller = caller.f_back
        if caller is None:  # called by a kernel
            return
        ours = caller.f_code.co_filename.startswith(SOURCES)
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        given = [frame.f_locals.get(name) for name in names if name != "self"]
        self.opened |= {id(thing): thing for thing in given if isinstance(thing, ONCE)}
        call = (caller.f_code, caller.f_lineno, code)
        if call in self._calls or not _holds(frame, names) or (ours and not _holds(caller, caller.f_locals)):
            return
        self._calls.add(call)
        for file in [caller.f_code.co_filename] * ours + [code.co_filename]:
            if not self.files or self.files[-1] != file:
                self.files.append(file)


def _holds(frame, names) -> bool:
    return any(isinstance(frame.f_locals.get(name), OPENED) for name in names if name not in ("self", "cls"))


@pytest.mark.long
def test_a_dataset_makes_few_stays_in_evaluate(tmp_path):
    truth = flame_dataset(tmp_path / "data")
    dataset = Dataset.open(with_a_flame_grid(tmp_path / "data"))
    walk = Walk()
    before = sys.getprofile()
    sys.setprofile(walk)
    try:
        scores = evaluate(truth, dataset)
    finally:
        sys.setprofile(before)
    assert scores.dve.eve and scores.dve.gradients and scores.psnr_flame, "all of it was asked for"
    stays = [Path(file).relative_to(SOURCES).as_posix() for file in walk.files]
    assert stays[0] == "evaluate/scoring.py" and "evaluate/image_scores.py" in stays
    assert len(stays) <= MOST, "\n".join(stays)
    assert sorted(type(thing).__name__ for thing in walk.opened.values()) == ["FlameGrid", "VelocitySequence"]
