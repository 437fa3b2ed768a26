"""Finds the LED board in footage of a fixed camera: marker, then LEDs, then the strips' curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.capture.board_points import BoardPoints
from gof.capture.template import BoardTemplate
from gof.core.errors import GofError

MIN_FLICKER = 12.0  # grey levels between strips and gaps; a codec's noise is a few
MIN_TEETH = 3  # of the five strips in the picture, to tell teeth from gaps
MARKER_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)  # in marker sides
SHIFTS = np.linspace(-1.6, 1.6, 129)  # spacings by which the strips may lie beside the marker's plane


class BoardNotFound(GofError):
    """The footage does not show the board well enough to read it."""


class MarkerNotFound(BoardNotFound):
    """The footage does not show the board's whole marker."""


@dataclass(frozen=True)
class BoardInImage:
    """The place of the board in an image. Pixel coordinates, centres at integer + 0.5.

    Args:
        corners: (4, 2) marker corners.
        marker_to_image: (3, 3) homography from marker sides, corrected with the LEDs.
        led: (L, 2) LED positions; led_visible (L,) False where cut off by the image border.
        strip: (S, J, 2) sample points along each strip, in template order; strip_visible (S, J).
        strip_normal: (J, 2) unit vectors across the strips.
    """

    corners: np.ndarray
    marker_to_image: np.ndarray
    led: np.ndarray
    led_visible: np.ndarray
    strip: np.ndarray
    strip_visible: np.ndarray
    strip_normal: np.ndarray

    @property
    def marker_px(self) -> float:
        """Mean side of the marker."""
        return float(np.linalg.norm(np.diff(self.corners, axis=0), axis=1).mean())


class Summary:
    """Per-pixel minimum, maximum and a mid picture of the first frames, in one pass and three images of memory."""

    def __init__(self) -> None:
        self.low = self.high = np.empty((0, 0), np.uint8)
        self.pictures: list[np.ndarray] = []  # a few grey frames to look for the marker in
        self.count = 0

    def add(self, frame: np.ndarray) -> None:
        """Add an RGB or grey frame.

        Raises: BoardNotFound: its size differs from the first frame's.
        """
        import cv2

        w = white(frame)
        if self.count == 0:
            self.low, self.high = w.copy(), w.copy()
        elif w.shape != self.low.shape:
            raise BoardNotFound(f"frame {self.count} is {w.shape[::-1]}, the ones before {self.low.shape[::-1]} pixels")
        else:
            np.minimum(self.low, w, out=self.low)
            np.maximum(self.high, w, out=self.high)
        if self.count % 16 == 0 and len(self.pictures) < 9:
            self.pictures.append(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) if frame.ndim == 3 else frame)
        self.count += 1


def locate(
    summary: Summary, template: BoardTemplate, samples: int = 96, points: BoardPoints | None = None
) -> BoardInImage:
    """Find the board.

    Args:
        summary: of frames in which LEDs and strips change.
        samples: points along each strip.
        points: where the board is by a user, who sees more of it than a marker that is partly hidden; None looks for
            the marker.
    Raises:
        BoardNotFound: no marker (says what to check), or no strips where the template puts them.
        DataFormatError: the user's points do not fit a board.
    """
    import cv2

    if summary.count == 0:
        raise BoardNotFound("no frames")
    height, width = summary.low.shape
    if points is None:
        points = BoardPoints(MARKER_CORNERS, find_marker(summary, template))
    else:
        points = _refined(points, summary)
    H = points.homography()
    corners = project(H, MARKER_CORNERS)
    side = float(np.sqrt(abs(cv2.contourArea(corners.astype(np.float32)))))

    high = cv2.GaussianBlur(summary.high, (0, 0), max(0.5, side / 60)).astype(np.float32)
    led = project(H, template.led_xy)
    snapped, found = bright_spots(high, led, radius=max(2.0, side / 8))
    if found.sum() >= 4:
        # LEDs spread wider than the marker: they settle the homography. RANSAC drops reflections and dark LEDs.
        better, inlier = cv2.findHomography(
            np.vstack([points.xy, template.led_xy[found]]),
            np.vstack([points.pixels, snapped[found]]),
            cv2.RANSAC,
            side / 25,
        )
        if better is not None and inlier.sum() >= 6:
            H = better
    led = project(H, template.led_xy)
    snapped, found = bright_spots(high, led, radius=max(1.5, side / 14))
    led = np.where(found[:, None], snapped, led)
    margin = max(1.0, side / 30)
    led_visible = in_picture(led, width, height, margin)

    return BoardInImage(corners, H, led, led_visible, *_find_strips(summary, template, H, samples))


def _refined(points: BoardPoints, summary: Summary) -> BoardPoints:
    """Return a user's marks, a pixel or two off, moved to the corners and the LEDs that they mean: the strips lie
    several marker sides away, where such an error would be as large as their distance."""
    import cv2

    H = points.homography()  # or it says that these are no points of a board
    side = float(np.sqrt(cv2.contourArea(project(H, MARKER_CORNERS).astype(np.float32))))
    picture = np.median(summary.pictures, axis=0).astype(np.uint8)
    pixels, _ = bright_spots(summary.high.astype(np.float32), points.pixels, radius=max(2.0, side / 8))
    is_corner = np.isin(points.xy, (0, 1)).all(1)
    half = max(2, round(side / 12))
    within = in_picture(points.pixels, picture.shape[1], picture.shape[0], half + 2)
    for k in np.flatnonzero(is_corner):
        pixels[k] = points.pixels[k]
        if within[k]:
            start = (points.pixels[k] - 0.5).astype(np.float32).reshape(1, 1, 2)
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.01)
            found = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), stop).reshape(2) + 0.5
            pixels[k] = found if np.linalg.norm(found - pixels[k]) < half + 1 else pixels[k]
    return BoardPoints(points.xy, pixels)


def find_marker(summary: Summary, template: BoardTemplate) -> np.ndarray:
    """Return (4, 2) corners of the template's marker in continuous pixel coordinates.

    Raises: MarkerNotFound: it is in none of the pictures, at half, one or two times their size.
    """
    median = np.median(summary.pictures, axis=0).astype(np.uint8)
    for scale in (1, 0.5, 2):  # reduced for blurred markers, enlarged for small ones
        for picture in (median, summary.high, *summary.pictures):
            corners = marker_in(picture, template.marker_id, template.inverted, scale)
            if corners is not None:
                return corners
    kind = "inverted " if template.inverted else ""
    raise MarkerNotFound(
        f"marker {template.marker_id} ({kind}DICT_4X4_50) is not in the picture: is it whole, lit, and at least about "
        "20 pixels wide?"
    )


def marker_in(picture: np.ndarray, number: int, inverted: bool, scale: float = 1) -> np.ndarray | None:
    """Return (4, 2) corners of the marker with this number in a grey (H, W) picture, looked for at `scale` times its
    size; in continuous pixel coordinates of the unchanged picture. None where it is not seen."""
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), parameters)
    image = 255 - picture if inverted else picture
    if scale != 1:
        image = cv2.resize(
            image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        )
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None or number not in ids:
        return None
    # OpenCV puts pixel centres at integers.
    return (corners[int(np.flatnonzero(ids.ravel() == number)[0])][0].astype(np.float64) + 0.5) / scale


def project(H: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Return points (..., 2) through a homography (3, 3)."""
    import cv2

    return cv2.perspectiveTransform(np.asarray(xy, np.float64).reshape(1, -1, 2), H).reshape(np.shape(xy))


def in_picture(points: np.ndarray, width: int, height: int, margin: float) -> np.ndarray:
    """Return (...) bool: points (..., 2) in the picture, `margin` px from its border or more; False where NaN."""
    x, y = points[..., 0], points[..., 1]
    return (x >= margin) & (y >= margin) & (x <= width - margin) & (y <= height - margin)


def bright_spots(image: np.ndarray, points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Centroid of the bright spot within `radius` of each point; found False where it is no spot or at the border."""
    height, width = image.shape
    out, found = points.copy(), np.zeros(len(points), bool)
    for i, (x, y) in enumerate(points):
        x0, x1, y0, y1 = int(x - radius), int(x + radius) + 1, int(y - radius), int(y + radius) + 1
        if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
            continue
        patch = image[y0:y1, x0:x1]
        low, high = np.percentile(patch, 20), patch.max()
        if high - low < 60:
            continue
        weight = np.clip(patch - (low + high) / 2, 0, None)
        yy, xx = np.mgrid[y0:y1, x0:x1] + 0.5
        out[i] = (weight * xx).sum() / weight.sum(), (weight * yy).sum() / weight.sum()
        found[i] = True
    return out, found


@dataclass(frozen=True)
class _Comb:
    """Places of the strips by the template and the marker's plane: teeth across a common middle line.

    Attributes:
        s: (J,) place along the strips, 0 = first and 1 = last lit point.
        middle: (J, 2) px, mean of the strips.
        spacing: (J,) px from strip to strip.   normal: (J, 2) unit vectors across the strips.
        teeth, gaps: (S,) and (S + 1,) places of the strips, and of what is between and beside them, in spacings.
    """

    s: np.ndarray
    middle: np.ndarray
    spacing: np.ndarray
    normal: np.ndarray
    teeth: np.ndarray
    gaps: np.ndarray

    def at(self, places: np.ndarray) -> np.ndarray:
        """Return (..., J, 2) px: points `places` (..., J or 1) spacings across from the middle."""
        return places[..., None] * (self.spacing[:, None] * self.normal) + self.middle


def _find_strips(summary: Summary, template: BoardTemplate, H: np.ndarray, samples: int):
    """Slide the comb of five predicted strips across the flicker image, separately along their length, and fit smooth
    curves: strips are mounted off the marker's plane and lenses bend them.

    Returns:
        strips (S, J, 2), visible (S, J) and normals (J, 2), see `BoardInImage`.
    """
    flicker = summary.high.astype(np.float32) - summary.low
    height, width = flicker.shape
    comb = _predicted_comb(template, H, samples)
    inside = in_picture(comb.middle, width, height, 2)
    if inside.sum() < samples / 4:
        raise BoardNotFound("the strips are outside the picture")
    stretch, shift = _fit_comb(flicker, comb)
    strip = comb.at(comb.teeth[:, None] * stretch + shift)
    for k in range(len(strip)):
        strip[k] += _towards_ridge(flicker, comb, strip[k])
    lit = sample(flicker, strip)
    visible = in_picture(strip, width, height, 1.5) & (lit > 0.5 * np.median(lit[:, inside]))
    return strip, visible, comb.normal


def _predicted_comb(template: BoardTemplate, H: np.ndarray, samples: int) -> _Comb:
    s = np.linspace(-0.04, 1.04, samples)
    ends = template.strip_ends
    predicted = project(H, ends[:, None, 0] + s[:, None] * (ends[:, None, 1] - ends[:, None, 0]))  # (S, J, 2)
    across = predicted[-1] - predicted[0]
    spacing = np.linalg.norm(across, axis=1) / (len(ends) - 1)
    along = np.gradient(predicted.mean(0), axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
    normal *= np.sign((normal * across).sum(1))[:, None]
    teeth = np.arange(len(ends)) - (len(ends) - 1) / 2
    gaps = np.arange(len(ends) + 1) - len(ends) / 2
    return _Comb(s, predicted.mean(0), spacing, normal, teeth, gaps)


def _fit_comb(flicker: np.ndarray, comb: _Comb) -> tuple[float, np.ndarray]:
    """Return one stretch for the board; one curve of shifts (J,) in spacings, quadratic along the strips.

    That along which most of the comb is seen, then refined without outliers. Where the comb leaves the picture, or ends
    before the template has it end, nothing is seen and nothing bends the curve.

    Raises: BoardNotFound: nothing flickers there, or the strips blend into each other.
    """
    stretches = np.linspace(0.85, 1.15, 7)
    scores = np.stack([_comb_score(flicker, comb, stretch) for stretch in stretches])
    tries = [_brightest_curve(score) for score in scores]
    best = int(np.argmax([found for _, found in tries]))
    curve, score = tries[best][0], scores[best]
    near = np.abs(SHIFTS[:, None] - curve) < 0.5
    at = np.where(near, score, -np.inf).argmax(0)
    shift, strength = SHIFTS[at], score[at, np.arange(len(at))]
    seen = strength > 0
    usual = np.median(strength[seen]) if seen.any() else 0.0
    if usual < MIN_FLICKER:
        raise BoardNotFound(
            f"no flickering strips where the board should have them (contrast {usual:.0f} of 255): is the board "
            "running, and are the strips in the picture? A frame rate that meets every period at the same moment (25, "
            "50 or 250 fps with 4 ms) freezes it: set another tick (gof capture board set --tick-us 410)"
        )
    bright = strength > 0.5 * usual
    for _ in range(4):
        use = bright & (np.abs(curve - shift) < 0.25)
        if use.sum() < 8:
            raise BoardNotFound("the five strips cannot be separated; they must be sharp, with nothing in front")
        curve = np.polyval(np.polyfit(comb.s[use], shift[use], 2), comb.s)
    return float(stretches[best]), curve


def _comb_score(flicker: np.ndarray, comb: _Comb, stretch: float) -> np.ndarray:
    """Return (SHIFTS, J) how much brighter teeth are than gaps with the comb shifted; 0 where it is not in the
    picture."""
    height, width = flicker.shape
    means = []
    for part in (comb.teeth, comb.gaps):
        points = comb.at((part[:, None] * stretch + SHIFTS)[:, :, None])
        inside = in_picture(points, width, height, 1)
        whole = inside.sum(0) >= MIN_TEETH
        means.append(np.where(whole, (sample(flicker, points) * inside).sum(0) / np.maximum(inside.sum(0), 1), np.nan))
    score = np.nan_to_num(means[0] - means[1], nan=0.0)
    # With an outer strip dead the comb fits in two places: take the one nearer to the prediction.
    return score * (1 - 0.1 * SHIFTS**2)[:, None]


def _brightest_curve(score: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (J,) the quadratic curve of shifts with the greatest mean score, of a grid of tilts and bends; and that
    mean."""
    u = np.linspace(-1, 1, score.shape[1])
    step = SHIFTS[1] - SHIFTS[0]
    few = slice(None, None, 3)  # points; the curve is refined with all
    column = np.arange(len(u))[few]
    best, found = np.zeros_like(u), -np.inf
    for tilt in np.arange(-1.2, 1.21, 0.1):
        for bend in np.arange(-0.6, 0.61, 0.1):
            curve = tilt * u + bend * (u * u - 1 / 3)
            row = np.arange(len(SHIFTS))[:, None] + np.rint(curve[few] / step).astype(int)
            ok = (row >= 0) & (row < len(SHIFTS))
            mean = np.where(ok, score[np.clip(row, 0, len(SHIFTS) - 1), column], 0.0).mean(1)
            k = int(mean.argmax())
            if mean[k] > found:
                best, found = SHIFTS[k] + curve, float(mean[k])
    return best, found


def _towards_ridge(flicker: np.ndarray, comb: _Comb, strip: np.ndarray) -> np.ndarray:
    """Return (J, 2) px from one strip's points to the ridge of its own light, smooth along it; 0 where little is
    seen."""
    height, width = flicker.shape
    fine = np.linspace(-0.35, 0.35, 29)  # spacings: within the strip's own half
    across = comb.spacing[:, None] * comb.normal
    ridge = np.clip(sample(flicker, strip + fine[:, None, None] * across) - 0.6 * flicker.max(), 0, None)
    weight = ridge.sum(0)
    ok = in_picture(strip, width, height, 2) & (weight > 0)
    if ok.sum() < 8:
        return np.zeros_like(strip)
    centre = (ridge * fine[:, None]).sum(0)[ok] / weight[ok]
    return np.polyval(np.polyfit(comb.s[ok], centre, 2), comb.s)[:, None] * across


# ----------------------------------------------------------------
# The brightness that the decoder needs: the smallest colour channel, which white LEDs fill and flames do not.


def white(frame: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8: the smallest colour channel."""
    import cv2

    if frame.ndim == 2:
        return frame
    a, b, c = cv2.split(frame)
    return cv2.min(cv2.min(a, b), c)


def sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return bilinear values of an (H, W) image at continuous pixel coordinates (..., 2) (centres at integer + 0.5);
    points outside take the nearest edge pixel."""
    import cv2

    flat = np.asarray(points, np.float32).reshape(-1, 2) - np.float32(0.5)
    columns = 4096  # OpenCV maps are limited to 32767 entries per side
    rows = -(-len(flat) // columns)
    maps = np.zeros((2, rows * columns), np.float32)
    maps[:, : len(flat)] = flat.T
    x, y = maps.reshape(2, rows, columns)
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(-1)[: len(flat)].reshape(np.shape(points)[:-1]).astype(np.float32)
