"""Which pixels of a film are flame, on a film whose flame is known."""

import cv2
import numpy as np

from gof_benchmark.evidence import flame_looks

GROUND, LED, FLAME = (40, 40, 45), (250, 250, 250), (250, 150, 50)


def test_leds_are_no_flame_and_what_always_burns_is(tmp_path):
    """A lick moves over a core that burns in every frame; a bar of white LEDs blinks below."""
    writer = cv2.VideoWriter(str(tmp_path / "cam.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 100, (160, 240))
    for frame in range(16):
        picture = np.full((240, 160, 3), GROUND, np.uint8)
        picture[100:140, 60:100] = FLAME
        picture[60:100, 50 + 2 * frame : 70 + 2 * frame] = FLAME
        picture[200:210, 20:140] = LED if frame % 2 else GROUND
        writer.write(picture[..., ::-1])
    writer.release()
    shares = flame_looks.of_clip(tmp_path, 100.0).colours.reshape(8, 8, 8)
    assert shares[7, 7, 7] < 0.005, "LEDs"
    assert shares[7, 3:6, 0:3].sum() > 0.75, "flame, but for the rim that codec and mask add"
