"""Drawing of charts, by matplotlib: inline SVG for pages, and .pdf, .svg and .png for papers.

A `Chart` is what to draw and how large; `Chart.svg` and `Chart.write` draw it. On a page letters are text, colours
are those for black (for white where it is printed), and marks say their numbers to a resting pointer. In a file the
ground is white and letters are outlines (.svg) or whole TrueType fonts (.pdf), which publishers ask for. The same chart
is the same bytes at any time.
"""

from __future__ import annotations

import io
import re
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from gof.core.errors import GofError
from gof.core.files import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure


Kind = Literal["pdf", "svg", "png"]
SUFFIXES = (".pdf", ".svg", ".png")
DPI, PAGE_DPI = 300, 150  # of a .png; and of what is pixels in a page's SVG
LETTERS, SMALL = 7.5, 6.0  # pt
COLOURS = ("#c2410c", "#1d4ed8", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be185d", "#475569")
INK, SOFT, GRID = "#1c1c1e", "#6b6b70", "#e3e3e3"
DARK = dict(  # what a colour becomes on a screen, where pages are dark (page.css)
    zip(
        (*COLOURS, INK, SOFT, GRID),
        ("#fb923c", "#7aa2ff", "#5fce85", "#c79bfa", "#4cc9e0", "#e3b341", "#f783b5", "#a8b3c2")
        + ("#ece7e0", "#a29a90", "#3a3632"),
        strict=True,
    )
)
STYLE = {
    "svg.hashsalt": "gof",
    "pdf.fonttype": 42,
    "font.size": LETTERS,
    "axes.linewidth": 0.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
}
ON_A_PAGE = {"svg.fonttype": "none", "figure.facecolor": "none", "axes.facecolor": "none"}
LETTER_PX = 15  # of labels on a page, where there is room
TIP = "tip:"  # begins the name of a mark that says its numbers
ONE_AT_A_TIME = threading.Lock()  # matplotlib's settings are the process's
STEPS = (1, 2, 5)  # of a decade that get a number
ROOM = 0.06  # beyond the outermost points, of an axis


@dataclass(frozen=True)
class Chart:
    """A chart that is not drawn yet.

    Attributes:
        title: what people read who do not see it.
        size_in: width and height in print, inches.
        draw: draws it into an empty figure of that size.
        letters: of its labels, pt.
    """

    title: str
    size_in: tuple[float, float]
    draw: Callable[[Figure], None]
    letters: float = LETTERS

    def svg(self) -> str:
        """Return an <svg> for a page of HTML, as wide as there is room, until its letters have the page's size."""
        drawn = io.BytesIO()
        with _style(ON_A_PAGE):
            self._drawn().savefig(drawn, format="svg", dpi=PAGE_DPI, metadata=dict.fromkeys(("Date", "Creator")))
        size_pt = (72 * self.size_in[0], 72 * self.size_in[1])
        return _inline(drawn.getvalue().decode(), self.title, size_pt, LETTER_PX / self.letters)

    def write(self, path: Path) -> None:
        """Write a file. Raises GofError: `path` is no .pdf, .svg or .png."""
        require_figure(path)
        kind = path.suffix.lower()[1:]
        dates: dict[str, dict[str, str | None]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}
        about = dates[kind]
        about |= {"Title": self.title} if self.title else {}
        with _style({}), atomic_path(path) as temporary:
            self._drawn().savefig(temporary, format=kind, dpi=DPI, metadata=about)

    def _drawn(self) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=self.size_in)
        self.draw(figure)
        return figure


def require_figure(*paths: Path) -> None:
    """Raise GofError for a suffix of which no figure is made."""
    for path in paths:
        if path.suffix.lower() not in SUFFIXES:
            raise GofError(f"{path}: a figure is a {', '.join(SUFFIXES)}")


def text_width_in(words: str, size: float) -> float:
    """Return the inches that words take in a size in pt."""
    from matplotlib.textpath import TextPath

    return TextPath((0, 0), words, size=size).get_extents().xmax / 72


def unit_range() -> Normalize:
    """Return the range of values from 0 to 1, for a map of colours."""
    from matplotlib.colors import Normalize

    return Normalize(0, 1)


@contextmanager
def _style(settings: Mapping[str, str]) -> Iterator[None]:
    """Hold matplotlib for one thread, in our style, whatever the user's own settings are."""
    from matplotlib import style

    with ONE_AT_A_TIME, style.context(["default", {**STYLE, **settings}]):
        yield


def _inline(drawn: str, title: str, size_pt: tuple[float, float], px_per_pt: float) -> str:
    """matplotlib's SVG as part of a page: named, in the page's letters and for its ground, with numbers at its marks.

    Names of groups go, because several charts of a page would share them; definitions of one name are equal.
    """
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", drawn[drawn.index(">", drawn.index("<svg")) + 1 :], flags=re.S)
    body = body.replace("*{stroke", ".chart *{stroke")
    body = re.sub(rf'<g id="{TIP}([^"]*)">', r"<g><title>\1</title>", body)
    body = re.sub(r'<g id="[^"]*">', "<g>", body)
    body = re.sub(r"font: ((?:\d+ )?)([\d.]+px)[^;\"]*", _own_letters, body)  # of matplotlib before 3.11
    body = re.sub(r"font-family: [^;\"]*;? ?", "", body)
    body = re.sub("|".join(DARK), lambda found: f"var(--{found[0][1:]}, {found[0]})", body)
    dark = "; ".join(f"--{light[1:]}: {dark}" for light, dark in DARK.items())
    width, height = size_pt
    return (
        f'<svg class="chart" role="img" aria-label="{escape(title)}" viewBox="0 0 {width:g} {height:g}" width="100%" '
        f'style="max-width: {px_per_pt * width:.0f}px">\n'
        f"<style>@media screen {{ .chart {{ {dark} }} }}</style>{body}"
    )


def _own_letters(font: re.Match) -> str:
    weight = f"font-weight: {font[1].strip()}; " if font[1] else ""
    return f"{weight}font-size: {font[2]}"


class ChartSize(NamedTuple):
    """Size of a chart without its legend, inches, where its axes begin, as shares of it, and its letters, pt."""

    width: float
    height: float
    left: float
    letters: float

    @property
    def small(self) -> float:
        return self.letters * SMALL / LETTERS


COLUMN = ChartSize(3.4, 2.4, 0.16, LETTERS)  # one column of a paper
WIDE = ChartSize(5.8, 3.5, 0.14, 9.0)


def lay_out(
    title: str, x_label: str, y_label: str, names: Sequence[str], size: ChartSize, fill: Callable[[Axes], None]
) -> Chart:
    """Return a chart with its title above, and a legend of `names` below, in rows; `fill` draws the data."""
    row_in = 1.4 * size.small / 72
    legend_in = row_in * sum(name.count("\n") + 1 for name in names) + 0.1
    whole = size.height + legend_in

    def draw(figure: Figure) -> None:
        below, above = 3.6 * size.letters / 72, 2.6 * size.letters / 72
        area = (size.left, (legend_in + below) / whole, 0.97 - size.left, (size.height - below - above) / whole)
        axes = figure.add_axes(area)
        fill(axes)
        axes.set_xlabel(x_label, fontsize=size.letters)
        axes.set_ylabel(y_label, fontsize=size.letters)
        axes.set_title(title, fontsize=1.1 * size.letters, fontweight="bold", loc="left")
        dress(axes, size.small)
        corner = (size.left - 0.04, 0.0)
        figure.legend(fontsize=size.small, frameon=False, labelspacing=0.3, loc="lower left", bbox_to_anchor=corner)

    return Chart(title, (size.width, whole), draw, size.letters)


def dress(axes: Axes, size: float) -> None:
    """Add a thin grid behind the data, numbers of `size` pt, no box."""
    axes.grid(color=GRID, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=size, labelcolor=INK, width=0.5, length=2.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def fit_name(name: str, size: ChartSize) -> str:
    """Return a name in rows that fit the chart, which matplotlib takes neither for a formula nor for none at all."""
    letters = int(97 * size.width / size.small)  # of 0.58 of their height each, beside the legend's marks
    return textwrap.fill(name, letters).replace("$", "\\$").lstrip("_") or "-"


def tip_of(*words: str) -> dict[str, Any]:
    """Return the text of a mark, as an argument of matplotlib's."""
    return {"gid": TIP + ", ".join(word for word in words if word)}


def find_limits(values: Sequence[float], room: float = ROOM) -> tuple[float, float]:
    """Return the limits of a logarithmic axis."""
    low, high = np.log10([min(values), max(values)])
    beyond = max(room * (high - low), 0.02)
    return float(10 ** (low - beyond)), float(10 ** (high + beyond))


def number_decades(axis: Axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis: 1, 2 and 5 of each decade; powers of ten over many; even steps within one.

    Args:
        axis: `axes.xaxis` or `axes.yaxis`.
        low, high: its limits, above zero.
    """
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    wide = np.log10(high / low)
    if wide > 8:
        decades = decades[decades % 4 == 0]
    ticks = np.outer(10.0**decades, STEPS if wide < 2.5 else (1,)).ravel()
    ticks = ticks[(ticks >= low) & (ticks <= high)]
    if len(ticks) < 3:
        unit = 10.0 ** np.floor(np.log10((high - low) / 2))
        step = next(many * unit for many in (*STEPS, 10) if (high - low) / (many * unit) <= 6)
        ticks = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    axis.set_ticks(ticks, [f"{tick:.6g}" for tick in ticks])
    axis.set_ticks([], minor=True)
