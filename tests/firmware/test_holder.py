"""The printable holder: closed surfaces of the volume that its boxes have."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "firmware/board"))
import holder


@pytest.mark.parametrize("part", ["front", "rails"])
@pytest.mark.parametrize("marker_mm", [45.0, 55.0, 100.0])
def test_parts_are_watertight(part, marker_mm):
    plate = getattr(holder, part)(marker_mm)
    triangles = plate.triangles()
    edges = Counter()
    for triangle in np.round(triangles, 5):
        for a, b in zip(triangle, np.roll(triangle, -1, 0), strict=True):
            edges[tuple(a), tuple(b)] += 1
    assert all(count == 1 and edges[b, a] == 1 for (a, b), count in edges.items())
    volume = np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6
    assert volume == pytest.approx(plate.volume(), rel=1e-9)
