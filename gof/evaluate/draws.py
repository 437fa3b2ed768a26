"""Random numbers of our own: none that a user's script may have drawn already."""

from __future__ import annotations

import hashlib

import numpy as np


def own_generator(purpose: str, seed: int = 0) -> np.random.Generator:
    """Return the generator of one purpose, the same in every run.

    Everybody writes `default_rng(0)`. Numbers of the same generator are not independent of a user's data: "random"
    directions would be those in which a script placed its Gaussians.

    Args:
        purpose: what is drawn, such as "directions of the random baseline"; each has numbers of its own.
        seed: of this purpose.
    """
    word = int.from_bytes(hashlib.sha256(f"gof {purpose}".encode()).digest()[:16], "big")
    return np.random.default_rng([word, seed])
