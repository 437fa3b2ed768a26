"""SpacetimeGaussians against its polynomials, one Gaussian at a time."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gof.core.errors import DataFormatError  # noqa: E402
from gof.io.importers import ImportOptions, read_result  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.lookalikes import logistic  # noqa: E402


@pytest.mark.parametrize("full", [False, True])
def test_spacetime_gaussians(tmp_path, full):
    """Positions, velocities and opacities of its renderer, one Gaussian at a time, from the raw numbers."""
    raw = lookalikes.spacetime(tmp_path / "p.ply", full=full)
    with pytest.raises(DataFormatError, match="--time-unit.*0.36 if that was"):
        read_result(tmp_path / "p.ply", ImportOptions(frame_time_s=0.01, clip_s=(0.0, 0.35)))
    got = read_result(tmp_path / "p.ply", ImportOptions(time_unit_s=0.5, time_zero_s=1.0))
    for t in (1.0, 1.2, 1.5):
        state = got.gaussians.state_at(t)
        for i in range(20):
            d = (t - 1.0) / 0.5 - raw["trbf_center"][i, 0]
            m = raw["motion"][i]
            place = [raw["xyz"][i, k] + m[k] * d + m[3 + k] * d**2 + m[6 + k] * d**3 for k in range(3)]
            speed = [(m[k] + 2 * m[3 + k] * d + 3 * m[6 + k] * d**2) / 0.5 for k in range(3)]
            q = raw["rot"][i] + d * raw["omega"][i]
            alpha = logistic(raw["opacity"][i, 0]) * np.exp(-((d / np.exp(raw["trbf_scale"][i, 0])) ** 2))
            np.testing.assert_allclose(state.position[i], place, rtol=1e-5, atol=1e-6)
            np.testing.assert_allclose(state.velocity[i], speed, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(state.rotation[i], q / np.linalg.norm(q), atol=1e-6)
            np.testing.assert_allclose(state.opacity[i], alpha, atol=1e-6)
    np.testing.assert_allclose(got.gaussians.state_at(1.2).scale, np.exp(raw["scale"]), rtol=1e-5)
    assert ("decoder" in got.notes[1]) == full
    got.gaussians.save(tmp_path / "t.npz")
    assert "velocities as stored" in read_result(tmp_path / "t.npz").notes
