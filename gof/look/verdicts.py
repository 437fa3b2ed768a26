"""What scores mean in plain words."""

from __future__ import annotations

from typing import NamedTuple

from gof.core.cameras import in_words
from gof.evaluate.scores import ControlScore, Scores, VelocityScore

COMPARED = {
    "zero": "standing still",
    "random": "moving at the same speed in random directions",
    "constant": "the best single vector for everything (fitted to the truth)",
    "height_mean": "the mean velocity of each height (fitted to the truth)",
}
OUTCOMES = {  # by (smaller L2, larger CosSim)
    (True, True): "Better than",
    (False, False): "Not better than",
    (True, False): "Closer in size, not in direction, than",
    (False, True): "Better in direction, not in size, than",
}
RIGHT_SPEED = (0.8, 1.25)  # ratios of the estimated to the true speed that are called right


class Verdict(NamedTuple):
    good: bool
    sentence: str


def verdicts(scores: Scores) -> list[Verdict]:
    """The velocities against the controls, their speed, the flame's pixels against the plate: what is defined of it."""
    out = []
    if scores.dve is not None and scores.dve.l2 is not None:
        for name, words in COMPARED.items():
            control = scores.controls.get(name)
            if control is not None and control.l2 is not None:
                out.append(_against(control, words, scores.dve))
        ratio = scores.dve.speed_ratio
        low, high = RIGHT_SPEED
        out.append(Verdict(low <= ratio <= high, f"Speeds are {ratio:.2f} times the true ones."))
    if scores.psnr_flame is not None:
        gain = scores.psnr_flame - scores.psnr_flame_plate
        side = "above" if gain > 0 else "below"
        size = in_words(scores.images.sizes_px) if scores.images else ""
        where = f"held-out frames ({size})" if size else "held-out frames"
        sentence = f"On flame pixels of {where}, {abs(gain):.1f} dB {side} the fire-free plate alone."
        out.append(Verdict(gain > 0, sentence))
    return out


def _against(control: ControlScore, words: str, dve: VelocityScore) -> Verdict:
    closer, straighter = dve.l2 < control.l2, dve.cos_sim > control.cos_sim
    return Verdict(
        closer and straighter,
        f"{OUTCOMES[closer, straighter]} {words}: L2 {dve.l2:.3f} against {control.l2:.3f}, "
        f"CosSim {dve.cos_sim:.3f} against {control.cos_sim:.3f}.",
    )
