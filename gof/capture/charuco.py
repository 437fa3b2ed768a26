"""The calibration target: a ChArUco pattern, its drawing at true size, its corners in pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gof.core.errors import GofError

PAPERS_MM = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
POINTS_PER_MM = 72 / 25.4
MOST_MM = 10_000.0  # of a square
MINIMUM_CORNERS = 8  # of a view; a homography needs 4
OWN_DICTIONARY = "DICT_4X4_50"
DICTIONARIES = (OWN_DICTIONARY, *(f"DICT_{n}X{n}_1000" for n in (5, 6, 7, 4)), "DICT_ARUCO_ORIGINAL")  # of bought ones
FEWEST_MARKERS = 4  # different ones; a wrong dictionary finds one or two by chance


@dataclass(frozen=True)
class Charuco:
    """A ChArUco target of DICT_4X4_50; the paper's is the default."""

    columns: int = 7
    """Squares across."""
    rows: int = 5
    """Squares down."""
    square_mm: float = 40.0
    """Side of a square, as measured on the print."""
    marker_mm: float = 30.0
    """Side of a marker."""

    @property
    def has_old_layout(self) -> bool:
        """Whether OpenCV before 4.6 drew it otherwise: with an even number of rows, its upper left square was white."""
        return self.rows % 2 == 0

    def pattern(self, old_layout: bool = False):
        """OpenCV's `CharucoBoard`, in metres.

        Args:
            old_layout: as OpenCV before 4.6 drew it.
        Raises:
            GofError: sizes that make no pattern.
        """
        import cv2

        if not self.square_mm <= MOST_MM:
            raise GofError(f"--square-mm: {self.square_mm:g} mm is more than {MOST_MM:g}")
        if not (self.columns >= 3 and self.rows >= 3 and 0 < self.marker_mm < self.square_mm):
            raise GofError("a ChArUco target needs at least 3 x 3 squares, and markers smaller than its squares")
        if self.columns * self.rows // 2 > 50:
            raise GofError(f"{self.columns} x {self.rows} squares need more than the dictionary's 50 markers")
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_mm * 1e-3, self.marker_mm * 1e-3, _dictionary())
        board.setLegacyPattern(old_layout)
        return board

    def corners(self, grey: np.ndarray, old_layout: bool = False) -> tuple[np.ndarray, np.ndarray] | None:
        """Inner corners in a grey picture: board points (N, 1, 3) in metres and continuous pixel coordinates (N, 1, 2);
        None when fewer than MINIMUM_CORNERS are seen."""
        import cv2

        pattern = self.pattern(old_layout)
        # OpenCV 4.11 gives these corners with pixel centres at integer + 0.5, unlike its other corner finders.
        found, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
        return pattern.matchImagePoints(found, ids) if ids is not None and len(ids) >= MINIMUM_CORNERS else None

    def squares(self) -> list[tuple[float, float, float, bool]]:
        """Squares to paint in this order on white: x, y (down), side in mm, True = black."""
        import cv2

        s = self.square_mm
        out = [(c * s, r * s, s, True) for r in range(self.rows) for c in range(self.columns) if (r + c) % 2 == 0]
        cell = self.marker_mm / 6
        for corners, marker in zip(self.pattern().getObjPoints(), np.ravel(self.pattern().getIds()), strict=True):
            x0, y0 = (1000 * np.asarray(corners)[0, :2]).tolist()
            out.append((x0, y0, self.marker_mm, True))
            white = np.argwhere(cv2.aruco.generateImageMarker(_dictionary(), int(marker), 6) > 0)
            out += [(x0 + c * cell, y0 + r * cell, cell, False) for r, c in white.tolist()]
        return out

    def looks_like(self, pictures: list[np.ndarray]) -> str:
        """Return a remedy in words by the looks of a target that is not found; "" where nothing is recognised."""
        turned = replace(self, columns=self.rows, rows=self.columns)
        if any(turned.corners(p, old) for p in pictures for old in {False, turned.has_old_layout}):
            return f"it looks like --squares {turned.columns}x{turned.rows}"
        seen = {name: _markers(pictures, name) for name in DICTIONARIES}
        name = max(seen, key=lambda name: len(seen[name]))
        if len(seen[name]) < FEWEST_MARKERS:
            return ""
        if name != OWN_DICTIONARY:
            return f"its markers are of {name}, this program reads {OWN_DICTIONARY}: print one with gof capture target"
        count = self.columns * self.rows // 2
        return f"markers up to number {max(seen[name])} are seen, and {self.columns} x {self.rows} squares have {count}"

    @property
    def size_mm(self) -> tuple[float, float]:
        return self.columns * self.square_mm, self.rows * self.square_mm


def _dictionary(name: str = OWN_DICTIONARY):
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _markers(pictures: list[np.ndarray], dictionary: str) -> set[int]:
    """Return numbers of the markers of a dictionary that the pictures show."""
    import cv2

    detector = cv2.aruco.ArucoDetector(_dictionary(dictionary), cv2.aruco.DetectorParameters())
    found = [detector.detectMarkers(picture)[1] for picture in pictures]
    return {int(number) for ids in found if ids is not None for number in ids.ravel()}


def page(target: Charuco) -> tuple[str, float, float]:
    """Name, width and height (mm) of the smallest A paper, landscape, that holds the target; its own size beyond A0."""
    width, height = target.size_mm
    for name, (w, h) in PAPERS_MM.items():
        if width <= w - 8 and height <= h - 8:
            return name, w, h
    return "own size", width + 40, height + 40


def draw_svg(target: Charuco) -> str:
    """Return SVG of the page, in mm."""
    _, width, height = page(target)
    x0, y0, note = _place(target)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
    ]
    out += [
        f'<rect x="{x0 + x:.4f}" y="{y0 + y:.4f}" width="{side:.4f}" height="{side:.4f}" '
        f'fill="{"#000" if black else "#fff"}"/>'
        for x, y, side, black in target.squares()
    ]
    out.append(f'<text x="{x0:.2f}" y="{height - 1.8:.2f}" font-size="2.5" font-family="sans-serif">{note}</text>')
    return "\n".join([*out, "</svg>", ""])


def draw_pdf(target: Charuco) -> bytes:
    """One-page PDF, at true size whatever program prints it at 100 %."""
    _, width, height = page(target)
    x0, y0, note = _place(target)
    k = POINTS_PER_MM
    paint = [
        f"{0 if black else 1} g {k * (x0 + x):.4f} {k * (height - y0 - y - side):.4f} {k * side:.4f} {k * side:.4f} re "
        "f"
        for x, y, side, black in target.squares()
    ]
    paint.append(f"0 g BT /F 7 Tf {k * x0:.2f} {k * 1.8:.2f} Td ({note}) Tj ET")
    content = "\n".join(paint)
    objects = [
        "<< /Type /Catalog /Pages 2 0 R >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {k * width:.4f} {k * height:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F << /Type /Font /Subtype /Type1 /BaseFont /Helvetica >> >> >> >>",
        f"<< /Length {len(content)} >>\nstream\n{content}\nendstream",
    ]
    text, starts = "%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        starts.append(len(text))
        text += f"{number} 0 obj\n{body}\nendobj\n"
    table = "".join(f"{start:010d} 00000 n \n" for start in starts)
    text += (
        f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}"
        f"trailer << /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{len(text)}\n%%EOF\n"
    )
    return text.encode("ascii")


def _place(target: Charuco) -> tuple[float, float, str]:
    """Return where the pattern's corner is on the page, mm, and the note below it."""
    name, width, height = page(target)
    (w, h) = target.size_mm
    note = (
        f"ChArUco DICT_4X4_50, {target.columns} x {target.rows}, squares {target.square_mm:g} mm, markers "
        f"{target.marker_mm:g} mm. "
        f"Print on {name} at 100 %: the pattern must measure {w:g} x {h:g} mm"
    )
    return (width - w) / 2, (height - h) / 2, note
