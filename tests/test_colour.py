"""Display values and linear light."""

import numpy as np

from gof.core.colour import linear_to_srgb, srgb_to_linear


def test_srgb_end_points():
    display = np.array([0, 0.04045, 0.5, 1.0])
    light = [0, 0.0031308, 0.2140411, 1]
    np.testing.assert_allclose(srgb_to_linear(display), light, atol=1e-6)
    np.testing.assert_allclose(linear_to_srgb(np.array(light)), display, atol=1e-6)
