"""Warnings about a take's times, for a person to read before believing them: in words, camera by camera. Every
figure has a limit above which it is a warning; those of `refusal` have one above which there are no times."""

from __future__ import annotations

import numpy as np

from gof.capture.times import SyncedVideo, VideoTimes

ROW_TIME_SPREAD = 0.05  # real clips of one mode agree to 0.02; 0.05 of 4 us are 50 us at the edge of 480 pixels
MOST_US = 10.0  # rms and systematic error: the published clips, heavily compressed, have 2 to 5, and 0.5 to 2.5
LEAST_LEDS = 8  # of the counter, that are usually in view
STANDS_OUT = 3.0  # times the other cameras' median
RATE_SPREAD = 1e-3  # cameras of one nominal rate agree to 3e-5
REFUSED = 10.0  # times `most_us`: rms and systematic error of times that are not to be used
MOST_OUTLIERS = 0.5  # of the frames: a clock that fewer agree with is none
FEWEST_READINGS = 4  # of each counter LED, that are no straddled change
FEWEST_MARKER_PX = 25.0
LONG_EXPOSURE = 0.9  # of the board's period
SAME_RATE, LIKE_RATE = 0.01, 0.2  # by which a file's stated rate may miss the board's; beyond the other it is another's
USUAL_RATES = (24, 25, 30, 48, 50, 60, 90, 100, 120, 150, 200, 240, 250, 300, 400, 480, 500, 600, 960, 1000)
NEAR_USUAL = 0.004  # NTSC's are 0.001 off, phones' up to 0.003


def refusal(rms_us: float, systematic_us: float, outliers: int, frames: int, most_us: float = MOST_US) -> str | None:
    """Why times are not to be used at all; None where they may be.

    Args:
        outliers: frames that do not agree with the camera's clock, of `frames`.
        most_us: see `warnings_of`.
    """
    if outliers > MOST_OUTLIERS * frames:
        return (
            f"{outliers} of {frames} frames do not agree with a steady clock: is the board hidden, or does the "
            "camera's rate vary (--clock free)?"
        )
    for what, value in (("rms", rms_us), ("systematic error", systematic_us)):
        if not value <= REFUSED * most_us:
            return (
                f"the times' {what} is {value:.0f} us, more than the {REFUSED * most_us:.0f} us that are of any use: "
                "is it another board (--board) or tick (--tick-us), is it cut off, hidden, or out of focus?"
            )
    return None


def warnings_of(cameras: list[SyncedVideo], most_us: float = MOST_US, period_us: float | None = None) -> list[str]:
    """Return one sentence per camera and fault; none for a take that is in order.

    Args:
        most_us: rms and systematic error that the board's kind usually stays below.
        period_us: of the board.
    """
    read = [(c.name, c.times) for c in cameras if c.times and c.times.clock == "board"]
    found = []
    for k, (name, times) in enumerate(read):
        others = [other for j, (_, other) in enumerate(read) if j != k]
        texts = _missing(times) + _odd_row_time(times, others) + _ragged(times, others, most_us)
        texts += _odd_rate(times) + _badly_seen(times, period_us)
        found += [f"{name}: {text}" for text in texts]
    rates = [times.fps for _, times in read]
    if rates and max(rates) - min(rates) > RATE_SPREAD * min(rates):
        listed = ", ".join(f"{name} {times.fps:.2f}" for name, times in read)
        found.append(f"the cameras ran at different rates ({listed} fps): frames of equal numbers drift apart")
    return found


def missing_frames(times: VideoTimes) -> str:
    """ "2 before frame 20, 1 before frame 57"; "" when none is missing."""
    return ", ".join(f"{count} before frame {frame}" for frame, count in times.dropped_before.items())


def _missing(times: VideoTimes) -> list[str]:
    found = []
    if times.dropped_before:
        found.append(f"{sum(times.dropped_before.values())} frames are missing: {missing_frames(times)}")
    if times.repeated_frames:
        found.append(f"frames {', '.join(map(str, times.repeated_frames))} show the one before again")
    return found


def _odd_row_time(times: VideoTimes, others: list[VideoTimes]) -> list[str]:
    """Compare with cameras whose pictures have the same size and are read along the same axis."""
    alike = [o for o in others if (o.width, o.height) == (times.width, times.height)]
    if not alike:
        return []
    found = []
    compared = alike if len(alike) == 1 else [times, *alike]  # of two, either may be wrong
    usual = float(np.median([o.row_time_us for o in compared]))
    if abs(times.row_time_us - usual) > ROW_TIME_SPREAD * max(usual, 0.1):
        lines = times.width if times.readout in ("left", "right") else times.height
        edge = abs(times.row_time_us - usual) * lines / 2
        found.append(
            f"its row time, {times.row_time_us:.2f} us per line, is not that of the others ({usual:.2f}): unless it is "
            f"another camera or mode, its edges are {edge:.0f} us off; look at its residuals, or give --row-time"
        )
    directions = {o.readout for o in alike}
    if len(alike) > 1 and len(directions) == 1 and times.readout not in directions:
        found.append(f"its lines are read {times.readout}, those of the others {directions.pop()}: is it turned over?")
    return found


def _odd_rate(times: VideoTimes) -> list[str]:
    """Return the board's clock against the rate that the file states, or cameras have: a wrong tick stretches all
    times."""
    off = times.container_fps and abs(times.fps / times.container_fps - 1)
    tick = (
        "does the board's clock differ from what was given (--tick-us, or a ring board's step_us)? All times are "
        "stretched then, and speeds with them"
    )
    if off and SAME_RATE < off < LIKE_RATE:
        return [f"by the board it ran at {times.fps:.2f} fps, its file says {times.container_fps:.2f}: {tick}"]
    if (not off or off >= LIKE_RATE) and min(abs(times.fps / rate - 1) for rate in USUAL_RATES) > NEAR_USUAL:
        return [f"by the board it ran at {times.fps:.2f} fps, a rate that few cameras have: {tick}"]
    return []


def _badly_seen(times: VideoTimes, period_us: float | None) -> list[str]:
    found = []
    if times.marker_px < FEWEST_MARKER_PX:
        found.append(f"the marker is {times.marker_px:.0f} pixels wide; from {FEWEST_MARKER_PX:.0f} on it is read well")
    if times.count.readings < FEWEST_READINGS * LEAST_LEDS:
        found.append(
            f"only {times.count.readings} readings of the counter's LEDs are clean: the count rests on few; film longer"
        )
    if period_us and times.exposure_us and times.exposure_us > LONG_EXPOSURE * period_us:
        found.append(
            f"its exposure, about {times.exposure_us:.0f} us, is about as long as the board's period; a shorter one, "
            "or a longer tick, is read better"
        )
    return found


def _ragged(times: VideoTimes, others: list[VideoTimes], most: float) -> list[str]:
    found = []
    figures = (
        ("rms", times.rms_us, "rms_us"),
        ("systematic error", times.systematic_us, "systematic_us"),
    )
    for what, value, field in figures:
        usual = float(np.median([getattr(o, field) for o in others])) if others else 0.0
        if value > most or (others and value > max(most / 2, STANDS_OUT * usual)):
            beside = f", the others {usual:.1f}" if others else ""
            found.append(
                f"its {what} is {value:.1f} us{beside}: the board was not read cleanly (cut off, hidden, out of "
                "focus, compressed?); look at its residuals"
            )
    return found
