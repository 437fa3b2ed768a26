"""The true velocity of a dataset in a few numbers, which show whether two datasets are the same scene.

The digest is of the numbers, not of the files: another compression is the same truth. A solver that rounds otherwise on
another CPU gives another digest and nearly the same speeds.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from gof.dataset.dataset import Dataset


@dataclass(frozen=True)
class Truth:
    """The fingerprint of a velocity store.

    Attributes:
        sha256: of its times, its grid and its values.
        rms_m_s: root-mean-square speed of every frame over all cells.
    """

    sha256: str
    rms_m_s: tuple[float, ...]

    @classmethod
    def of(cls, dataset: Dataset) -> Truth:
        """Read every frame. Raises DataFormatError: the dataset has no true velocity, or it is damaged."""
        store = dataset.velocity
        state = hashlib.sha256()
        state.update(np.round(store.times_s, 9).astype("<f8").tobytes())
        state.update(np.round(store.index_to_world, 9).astype("<f8").tobytes())
        speeds = []
        for time_s in store.times_s:
            values = store.at(float(time_s)).velocity
            state.update(f"{values.shape}".encode())
            state.update((values + 0).astype("<f4").tobytes())  # + 0: of the two zeros only one
            speeds.append(float(np.sqrt(np.square(values.astype(np.float64)).sum(-1).mean())))
        return cls(state.hexdigest(), tuple(round(speed, 6) for speed in speeds))

    def differs(self, recorded: Truth) -> str:
        """In what this truth is another than the recorded one; empty where it is the same."""
        if self.sha256 == recorded.sha256:
            return ""
        if len(self.rms_m_s) != len(recorded.rms_m_s):
            return f"it has {len(self.rms_m_s)} frames, the recorded one {len(recorded.rms_m_s)}"
        ours, theirs = np.array(self.rms_m_s), np.array(recorded.rms_m_s)
        off = float(np.max(np.abs(ours - theirs) / np.maximum(theirs, 1e-9)))
        return f"its velocities are not those to the bit; the speed of a frame differs by at most {off:.2%}"
