"""The study of wrong frame times changes what is believed about them, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.dataset import Dataset
from gof_benchmark.evidence.wrong_clocks import believing, mistakes


def test_rounded_and_exaggerated_times(tiny_dataset):
    common = Dataset.open(tiny_dataset)
    with pytest.raises(GofError, match="effect 'clock'"):
        mistakes(common)
    first, second = common.description.cameras
    late = replace(second, time_s=tuple(t + 0.013 for t in common.times_s))  # 1.3 frames of 10 ms
    dataset = replace(common, description=replace(common.description, cameras=(first, late)))
    np.testing.assert_allclose(mistakes(dataset), [[0] * 4, [-0.003] * 4], atol=1e-9)
    for error, expected in ((0, 0.013), (1, 0.010), (2, 0.007)):
        wrong = believing(dataset, error)
        np.testing.assert_allclose(wrong.camera_times_s(1), common.times_s + expected, atol=1e-9)
        np.testing.assert_array_equal(wrong.camera_times_s(0), common.times_s)
