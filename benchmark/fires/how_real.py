"""How real are these fires? `python -m gof_benchmark.fires.how_real PLACES...` compares them with known laws."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.errors import DataFormatError, GofError
from gof.dataset import DatasetDescription
from gof.host.terminal import progress_bar
from gof.look.charts import line_chart
from gof_benchmark.fires import SPLITS, measures
from gof_benchmark.fires.flames import Axis, SideView, SimulationFacts, ViewedFlame, flame_of
from gof_benchmark.fires.measured import MeasuredFire, compare, read_database
from gof_benchmark.fires.measures import ZONES, heskestad_heat, heskestad_height, mccaffrey_speed, puffing_law

BANDS = ((0.1, 0.4), (0.4, 0.7), (0.7, 1.0))  # of the flame's height, through which structures are followed
LOWEST = 0.02  # m/kW^(2/5): nearer to the burner its rim, not its heat, decides
HIGHEST = 0.35  # of the charts: the flame, and where its plume begins
CHART_POINTS, CHART_HZ = 14, np.geomspace(*measures.FLICKER_HZ, 12)


@dataclass
class HowReal:
    """Print how fires of any solver, and filmed ones, compare with what real fires are known to do.

    Speed on the axis over McCaffrey's zones, flame height, puffing, flicker of the light, and how fast bright
    structures rise. The laws and their sources: `gof_benchmark/fires/measures.py`; what the columns mean:
    docs/how_real.md.
    """

    places: tyro.conf.Positional[tuple[Path, ...]]
    """Grids of a solver, datasets, folders with one video a camera, or folders of these, as
    `python -m gof_benchmark.fires` makes them."""
    clip_rate_hz: float = 0.0
    """At which videos were filmed; slow-motion files state another rate."""
    measured: Path | None = None
    """Your copy of MaCFP's database (github.com/MaCFP/macfp-db): fires of the size of its pools are held beside the
    velocities measured there."""
    charts: Path | None = None
    """Also draw how_real_SOURCE.svg and how_real_flicker.svg into this folder."""


@dataclass(frozen=True)
class Laws:
    """A simulated fire beside the laws; NaN where it cannot be measured, and in wind everything but its heat.

    Args:
        heat_kw: of the burner that is looked at. heat_inferred: it follows from the flame's height, by Heskestad's law.
        rise_ratio, rise_exponent: axis speed over McCaffrey's 6.8 sqrt(z), mean between 0.02 and 0.08 Q^(2/5), and its
            exponent there (0.5).
        plateau_ratio: likewise in the intermittent zone, 0.08 to 0.20 Q^(2/5). plume_ratio: above.
        height_law_m: Heskestad's; NaN where the heat follows from it.
        puffing_hz, puffing_resolution_hz: of the axis' speed up to two diameters; NaN below two periods of the law.
        shining_ratio, shining_exponent: as the first two for the shining gas, wherever it is.
    """

    heat_kw: float
    heat_inferred: bool
    rise_ratio: float
    rise_exponent: float
    plateau_ratio: float
    plume_ratio: float
    height_law_m: float
    puffing_hz: float
    puffing_resolution_hz: float
    puffing_law_hz: float
    shining_ratio: float
    shining_exponent: float


@dataclass(frozen=True)
class PictureMeasures:
    """Measures of pictures, of a filmed fire too: medians over the views.

    Args:
        height: of the visible flame, m, or pixels of a filmed one.
        flicker, flicker_slope: `measures.flicker`.
        rise: of bright structures in the lower, middle and upper third of the flame, flame heights a second.
        rise_exponent: n of rise ~ height^n; 0.5 in a fire that accelerates as McCaffrey's.
        over_gas: rise over the speed on the axis at the same heights, mean.
    """

    height: float
    flicker: float
    flicker_slope: float
    rise: tuple[float, float, float]
    rise_exponent: float
    over_gas: float


def seen(flame: ViewedFlame) -> PictureMeasures:
    """Return the measures of the views; see `PictureMeasures`."""
    per_view = [_seen(flame.time_s, view) for view in flame.views]
    height, flicker, slope, *rise = (_median(values) for values in zip(*per_view, strict=True))
    middles = height * np.mean(BANDS, axis=1)
    over_gas = math.nan
    if flame.truth and not flame.truth.windy:
        over_gas = _mean(height * np.array(rise) / _speed_at(flame.truth.axis, middles))
    return PictureMeasures(
        height, flicker, slope, tuple(rise), measures.power_law(middles, np.array(rise))[1], over_gas
    )


def _seen(time_s: np.ndarray, view: SideView) -> tuple[float, ...]:
    """Return (height, flicker, its slope, rise in each of BANDS in flame heights a second) of one view."""
    height = measures.flame_height(view.brightest, view.height)
    rise = [
        measures.rise_speed(time_s, view.height, view.total, (low * height, high * height)) / height
        if height
        else height
        for low, high in BANDS
    ]
    return height, *measures.flicker(time_s, view.total.sum(1)), *rise


def laws(truth: SimulationFacts, height_m: float) -> Laws:
    """Return a simulated fire whose visible flame is so high, beside the laws; see `Laws`."""
    inferred = math.isnan(truth.heat_kw)
    heat_kw = heskestad_heat(height_m, truth.diameter_m) if inferred and not truth.windy else truth.heat_kw
    law_hz, swings = puffing_law(truth.diameter_m), truth.swings
    duration = float(swings.time_s[-1] - swings.time_s[0])
    long_enough = duration * law_hz >= 2 and not truth.windy
    axis, shining = (None, None) if truth.windy else (truth.axis, truth.shining)
    rise, plateau, plume = (_over_law(axis, heat_kw, zone) for zone in range(3))
    light = _over_law(shining, heat_kw, 0)
    return Laws(
        heat_kw=heat_kw,
        heat_inferred=inferred,
        rise_ratio=rise[0],
        rise_exponent=rise[1],
        plateau_ratio=plateau[0],
        plume_ratio=plume[0],
        height_law_m=math.nan if inferred or truth.windy else heskestad_height(heat_kw, truth.diameter_m),
        puffing_hz=measures.puffing_frequency(swings.time_s, swings.rise_m_s) if long_enough else math.nan,
        puffing_resolution_hz=1 / duration if duration else math.inf,
        puffing_law_hz=law_hz,
        shining_ratio=light[0],
        shining_exponent=light[1],
    )


def _over_law(axis: Axis | None, heat_kw: float, zone: int) -> tuple[float, float]:
    """Return (mean speed over McCaffrey's, exponent of the speed) in one of his zones; NaN where there is nothing."""
    if axis is None:
        return math.nan, math.nan
    scaled = axis.height_m / heat_kw**0.4
    low = ZONES[zone - 1][0] if zone else LOWEST
    inside = (scaled >= low) & (scaled < ZONES[zone][0]) & np.isfinite(axis.speed_m_s)
    height, speed = axis.height_m[inside], axis.speed_m_s[inside]
    return _mean(speed / mccaffrey_speed(height, heat_kw)), measures.power_law(height, speed)[1]


def _speed_at(axis: Axis, height_m: np.ndarray) -> np.ndarray:
    return np.interp(height_m, axis.height_m, axis.speed_m_s)


def _mean(values: np.ndarray) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else math.nan


def _median(values: tuple[float, ...]) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else math.nan


# ---------------------------------------------------------------- what is printed


LAWS_HEAD = (
    "fire",
    "heat, kW",
    "mean over, s",
    "axis speed / McCaffrey: flame",
    "its exponent (0.5)",
    "intermittent",
    "plume",
    "height (Heskestad), m",
    "puffing (1.5/sqrt(D)), Hz",
)
SEEN_HEAD = (
    "fire",
    "made by",
    "frames",
    "flicker, 15 to 40 Hz",
    "its slope",
    "structures rise, flame heights/s: low, middle, top",
    "exponent (0.5)",
    "over the gas",
)
MEASURED_HEAD = (
    "fire",
    "measured",
    "its heat, kW",
    "points",
    "mean over, s",
    "mean speed / measured",
    "its error",
    "within the stated uncertainty",
    "rms / measured",
    "its error",
)
SOLVER_HEAD = (
    "fire",
    "heat / nominal, kW",
    "shining gas / McCaffrey",
    "its exponent",
    "hottest, K",
    "fastest, m/s",
    "CPU s",
)


def laws_row(flame: ViewedFlame, looks: PictureMeasures) -> tuple[str, ...]:
    """Return a simulated fire's line under LAWS_HEAD."""
    truth, figures = flame.truth, laws(flame.truth, looks.height)
    height = f"{looks.height:.2f}" + ("" if math.isnan(figures.height_law_m) else f" ({figures.height_law_m:.2f})")
    puffing = f"{figures.puffing_hz:.1f} +- {figures.puffing_resolution_hz / 2:.1f}"
    if math.isnan(figures.puffing_hz):
        puffing = "wind" if truth.windy else "too short"
    return (
        flame.name + (" (wind)" if truth.windy else ""),
        _figure(figures.heat_kw, 0) + (" (from its height)" if figures.heat_inferred and not truth.windy else ""),
        _figure(truth.axis.over_s),
        _figure(figures.rise_ratio),
        _figure(figures.rise_exponent),
        _figure(figures.plateau_ratio),
        _figure(figures.plume_ratio),
        height,
        f"{puffing} ({figures.puffing_law_hz:.1f})",
    )


def seen_row(flame: ViewedFlame, looks: PictureMeasures) -> tuple[str, ...]:
    """Return a fire's line under SEEN_HEAD."""
    rate = 1 / float(np.median(np.diff(flame.time_s)))
    return (
        flame.name + (" (cut by the picture's edge)" if flame.cut else ""),
        flame.source,
        f"{len(flame.time_s)} at {rate:.0f} Hz",
        "-" if math.isnan(looks.flicker) else f"{100 * looks.flicker:.1f} %",
        _figure(looks.flicker_slope, 1),
        ", ".join(_figure(speed, 1) for speed in looks.rise),
        _figure(looks.rise_exponent),
        _figure(looks.over_gas),
    )


def solver_row(flame: ViewedFlame, looks: PictureMeasures) -> tuple[str, ...]:
    """Return a solver's fire's line under SOLVER_HEAD."""
    truth, figures = flame.truth, laws(flame.truth, looks.height)
    return (
        flame.name,
        f"{_figure(truth.heat_burnt_kw, 1)} / {_figure(truth.heat_nominal_kw, 1)}",
        _figure(figures.shining_ratio),
        _figure(figures.shining_exponent),
        _figure(truth.hottest_k, 0),
        _figure(truth.fastest_m_s, 1),
        _figure(truth.cpu_s, 0),
    )


def measured_row(flame: ViewedFlame, measured: MeasuredFire) -> tuple[str, ...]:
    """Return a simulated fire's line under MEASURED_HEAD."""
    found = compare(flame.truth.flow, measured)
    return (
        flame.name,
        measured.name,
        _figure(measured.heat_kw, 0),
        str(found.points),
        _figure(found.over_s),
        _figure(found.mean_ratio),
        _figure(found.mean_error),
        "-" if math.isnan(found.within) else f"{found.within:.0%}",
        _figure(found.rms_ratio),
        _figure(found.rms_error),
    )


def measured_table(flames: list[ViewedFlame], database: list[MeasuredFire]) -> str:
    """Return the table of the fires that are as wide as a measured one, as hot and in still air; or that none is."""
    pairs = [
        (flame, measured)
        for flame in flames
        for measured in database
        if flame.truth and not flame.truth.windy and measured.is_same(flame.truth.diameter_m, flame.truth.heat_kw)
    ]
    if pairs:
        return table(MEASURED_HEAD, [measured_row(flame, measured) for flame, measured in pairs])
    sizes = "; ".join(f"'{fire.name}' ({fire.diameter_m:g} m, {fire.heat_kw:g} kW)" for fire in database)
    return f"None of these fires is one of these, in still air: {sizes}. gof generate waterloo makes one."


def _figure(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [head, ("---",) * len(head), *rows])


# ---------------------------------------------------------------- charts


def draw(flames: list[ViewedFlame], looks: list[PictureMeasures], folder: Path) -> None:
    """Draw the speed on the axis in still air, scaled as McCaffrey does, a chart a solver; all flicker in one chart."""
    folder.mkdir(parents=True, exist_ok=True)
    for source in sorted({flame.source for flame in flames if flame.truth}):
        lines = {"McCaffrey's law": _law_line()}
        for flame, look in zip(flames, looks, strict=True):
            if flame.source == source and not flame.truth.windy:
                lines[flame.name.replace("_", " ")] = _scaled(flame.truth.axis, laws(flame.truth, look.height).heat_kw)
        line_chart(
            f"{source}: mean speed on the axis",
            "height above the burner / Q^(2/5), m/kW^(2/5)",
            "speed / Q^(1/5), m/s/kW^(1/5)",
            lines,
        ).write(folder / f"how_real_{source.lower()}.svg")
    spectra = {source: _mean_spectrum(flames, source) for source in sorted({flame.source for flame in flames})}
    line_chart(
        "flicker of the whole flame's light",
        "frequency, Hz",
        "power over the mean light squared, 1/Hz",
        {source: points for source, points in spectra.items() if points},
    ).write(folder / "how_real_flicker.svg")


def _law_line() -> list[tuple[float, float, str]]:
    scaled = np.geomspace(LOWEST / 2, HIGHEST, 60)
    return [(float(z), float(u), "") for z, u in zip(scaled, mccaffrey_speed(scaled, 1.0), strict=True)]


def _scaled(axis: Axis, heat_kw: float) -> list[tuple[float, float, str]]:
    """Return some points of a profile, evenly spaced on the chart's axis."""
    z, u = axis.height_m / heat_kw**0.4, axis.speed_m_s / heat_kw**0.2
    shown = (z > LOWEST / 2) & (z < HIGHEST)
    if not shown.any():
        return []
    at = np.geomspace(z[shown][0], z[shown][-1], CHART_POINTS)
    return [(float(a), float(np.interp(a, z, u)), "") for a in at]


def _mean_spectrum(flames: list[ViewedFlame], source: str) -> list[tuple[float, float, str]]:
    """Geometric mean over a source's fires, each the geometric mean over its views."""
    powers = [_power(flame) for flame in flames if flame.source == source]
    powers = [power for power in powers if power is not None]
    if not powers:
        return []
    mean = np.exp(np.mean(np.log(powers), axis=0))
    return [(float(f), float(p), "") for f, p in zip(CHART_HZ, mean, strict=True)]


def _power(flame: ViewedFlame) -> np.ndarray | None:
    """Return the power of a flame's light over its mean, at CHART_HZ; None where its clip is too slow or too short to
    say."""
    if math.isnan(measures.flicker(flame.time_s, np.ones(len(flame.time_s)))[0]):
        return None
    logs = []
    for view in flame.views:
        light = view.total.sum(1)
        frequency, power = measures.spectrum(flame.time_s, light / light.mean())
        logs.append(np.log(np.maximum(np.interp(CHART_HZ, frequency, power), 1e-30)))
    return np.exp(np.mean(logs, axis=0))


# ---------------------------------------------------------------- the command


def places_in(path: Path) -> list[Path]:
    """Return the fires in a folder: itself, or grids, datasets and clips below it. Datasets of grids are their grids.

    Raises:
        DataFormatError: there is none.
    """
    if any((path / name).exists() for name in ("velocity.zarr", "dataset.json")) or any(path.glob("*.mp4")):
        return [path]
    grids = sorted(file.parent for file in path.glob("openfoam/*/grids/fire.json"))
    datasets = [file.parent for split in SPLITS for file in sorted(path.glob(f"{split}/*/dataset.json"))]
    datasets = [folder for folder in datasets if "grids" not in (DatasetDescription.read(folder).spec or {})["fire"]]
    clips = sorted({file.parent for file in path.glob("*/*/*.mp4")})
    if found := [*grids, *datasets, *clips]:
        return found
    raise DataFormatError(f"{path}: no fire there: no grids of a solver, no dataset, no videos (*.mp4)")


def main(argv: list[str] | None = None) -> int:
    config = tyro.cli(HowReal, prog="python -m gof_benchmark.fires.how_real", args=argv)
    try:
        places = [place for path in config.places for place in places_in(path)]
        flames = []
        with progress_bar("reading fires") as update:
            for done, place in enumerate(places):
                update(done, len(places), note=str(place))
                flames.append(flame_of(place, config.clip_rate_hz))
            update(len(places), len(places))
        beside = measured_table(flames, read_database(config.measured)) if config.measured else ""
    except GofError as e:
        print(f"how_real: {e}", file=sys.stderr)
        return 1
    looks = [seen(flame) for flame in flames]
    pairs = list(zip(flames, looks, strict=True))
    simulated = [(flame, look) for flame, look in pairs if flame.truth]
    solved = [(flame, look) for flame, look in simulated if flame.truth.shining]
    for head, row, chosen in (
        (LAWS_HEAD, laws_row, simulated),
        (SEEN_HEAD, seen_row, pairs),
        (SOLVER_HEAD, solver_row, solved),
    ):
        if chosen:
            print(table(head, [row(flame, look) for flame, look in chosen]), end="\n\n")
    if beside:
        print(beside, end="\n\n")
    if config.charts:
        draw(flames, looks, config.charts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
