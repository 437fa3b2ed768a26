"""Cost presets: points on the accuracy/time curves of docs/presets.md, one for each rung of gof.core.ladder."""

from __future__ import annotations

PRESETS: dict[str, dict[str, dict]] = {
    "toy": {
        "clip": {"frames": 6, "warm_up_frames": 16},  # one frame, the fifth, is held out between two others
        "domain": {"resolution": 24},
        "render": {"percentage": 6, "samples": 1, "plate_samples": 2, "denoise": False},
    },
    "preview": {
        "clip": {"frames": 8},
        "domain": {"resolution": 40},
        "render": {"percentage": 12, "samples": 4, "plate_samples": 16},
    },
    "standard": {
        "clip": {"frames": 50},
        "domain": {"resolution": 128},
        "render": {"percentage": 25, "samples": 16, "plate_samples": 64},
    },
    "large": {
        "clip": {"frames": 50},
        "domain": {"resolution": 256},
        "render": {"percentage": 100, "samples": 2, "plate_samples": 16, "volume_step_rate": 4.0},
    },
    "full": {
        "clip": {"frames": 50},
        "domain": {"resolution": 640},
        "render": {"percentage": 100, "samples": 32, "plate_samples": 256},
    },
}
"""Changes of each preset to a spec: cost, never content. ``toy`` is for tests."""

FORMER: dict[str, dict[str, dict]] = {
    "draft": {
        "clip": {"frames": 36},
        "domain": {"resolution": 64},
        "render": {"percentage": 25, "samples": 6, "plate_samples": 32},
    },
}
"""Presets that are no rung of the ladder any more; they go with the next version."""
NEW_NAMES = {"paper": "full"}
"""Old name -> rung, for one version."""
