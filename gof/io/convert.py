"""Any known result to our formats, or to those of other programs: some that move, some of one instant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.core import ftgs
from gof.core.drafts import whole_folder
from gof.core.errors import DataFormatError, NonFiniteError
from gof.core.gaussians import VISIBLE, TransientGaussians
from gof.core.ply import splat_columns, write
from gof.host.options import require_number
from gof.io import compressed, dgs, fourdgs, gltf, tsog, usd
from gof.io.importers import Imported, ImportOptions, gof_files, read_result
from gof.io.importers.sidecar import file_of, write_sidecar
from gof.io.into_room import put_into_room
from gof.io.losses import measure_loss

MOVING = {".4dgs": fourdgs, tsog.SUFFIX: tsog, dgs.SUFFIX: dgs}  # suffixes of formats that hold what ours do, rounded
FRAMES = ("", *usd.SUFFIXES)  # suffixes of formats that hold one frame after another
INSTANT = (".glb", *compressed.SUFFIXES)  # suffixes of formats that hold the state at one time
WRITTEN = (".npz", ".ply", *MOVING, *usd.SUFFIXES, *INSTANT)
HAZIER = "other viewers blend display values, so over a bright background the flame looks hazier there than in gof"


def convert(
    imported: Imported,
    out: Path,
    start_s: float | None = None,
    end_s: float | None = None,
    frame_time_s: float | None = None,
    time_s: float | None = None,
    overwrite: bool = False,
    into: Path | None = None,
) -> list[str]:
    """Write a result by suffix: .npz (exact), .ply (3DGS, time, velocity), .ftgs.ply, .4dgs, .tsog, .glb, .spz, .sog.

    A .usda, .usdc or a folder of 3DGS PLYs (a name without a suffix) holds a frame every `frame_time_s`. Where a format
    has no place for it, OUT.gof.json says that a flame is emissive, or alone.

    Returns what the format made of it, in words.

    Args:
        start_s, end_s: first and last second of the clip, where the format has one; default: when the first Gaussian
            appears and when the last one is gone.
        frame_time_s: seconds between two frames; with both of the above it tells an .ftgs.ply its number of frames.
        time_s: instant of a .glb, .spz or .sog; default: the middle of the Gaussians' times.
        overwrite: replace a file that is there; a folder never is.
        into: room in which the flame is to stand, or the JSON that says where (`gof.io.into_room`).
    Raises:
        DataFormatError: the file exists, the suffix is unknown, positions sampled in time are to become a closed form,
            start_s, end_s or time_s is given for another format, frames without frame_time_s, or a value that the
            format cannot hold; or as `put_into_room`.
    """
    if out.suffix not in ("", *WRITTEN):
        raise DataFormatError(
            f"{out}: no format ends in '{out.suffix}'; use {', '.join(WRITTEN)}, or no suffix for a folder of PLYs"
        )
    require_number("--clip", start_s)
    require_number("--clip", end_s)
    require_number("--time", time_s)
    if (start_s, end_s) != (None, None) and not (out.suffix in (*FRAMES, *MOVING) or out.name.endswith(".ftgs.ply")):
        raise DataFormatError(
            f"{out}: --clip means something in .ftgs.ply, .4dgs, .tsog, .dgs, USD and folders only; leave it out"
        )
    if time_s is not None and out.suffix not in INSTANT:
        raise DataFormatError(f"{out}: --time means something in {', '.join(INSTANT)} only; leave it out")
    beside = file_of(out)
    if beside.exists() and not overwrite:
        raise DataFormatError(
            f"{beside}: exists already; replace it with --overwrite, or choose another name for {out}"
        )
    if out.exists() and not (overwrite and out.is_file()):
        remedy = "remove it" if out.is_dir() else "replace it with --overwrite"
        raise DataFormatError(f"{out}: exists already; {remedy}, or choose another name")
    try:
        notes = _written(imported, out, start_s, end_s, frame_time_s, time_s, into)
        beside.unlink(missing_ok=True)  # of a file that was there before
        if into is not None:
            return notes
        return [*notes, *_plates_left(imported, out), *_keep_facts(imported, out, start_s, end_s, frame_time_s)]
    except NonFiniteError as e:
        raise DataFormatError(f"{out}: {e}; is the instant far from the result's times?") from e


def _plates_left(imported: Imported, out: Path) -> list[str]:
    """Say where a result's own plates stay, which `gof evaluate` and others look for beside it."""
    plates = (imported.path if imported.path.is_dir() else imported.path.parent) / "plates"
    if not plates.is_dir() or plates.resolve() == (out.parent / "plates").resolve():
        return []
    return [f"its own plates stay in {plates}; copy them to {out.parent / 'plates'}, or it is drawn over the dataset's"]


def _written(
    imported: Imported,
    out: Path,
    start_s: float | None,
    end_s: float | None,
    frame_time_s: float | None,
    time_s: float | None,
    into: Path | None,
) -> list[str]:
    """Return the file by its suffix; args and result as of `convert`."""
    gaussians = imported.gaussians
    source = gof_files.converted(imported.method, imported.path)
    if not isinstance(gaussians, TransientGaussians):
        remedy = "write .npz (gof-trajectory/1)" if into is None else "leave out --into"
        if out.suffix != ".npz" or into is not None:
            raise DataFormatError(f"{out}: positions sampled in time have no closed form; {remedy}")
        gaussians.save(out, source)
        return []
    notes, color_at = [], None
    room = None if into is None else put_into_room(gaussians, into)
    if out.suffix in INSTANT and time_s is None:
        time_s = _middle(room.flame if room else gaussians)
        notes = [f"the instant is {time_s:.4f} s, the middle of the Gaussians' times; --time chooses another"]
    if room is not None:
        gaussians, light = room.lit(room.instants(start_s, end_s) if time_s is None else [time_s])
        color_at = room.color_at if out.suffix in FRAMES else None
        notes += [*room.notes, f"{light}; {_light_in(out)}" if room.light else light]
    if out.name.endswith(".ftgs.ply"):
        return notes + _save_ftgs(gaussians, out, start_s, end_s, frame_time_s)
    if out.suffix in MOVING:
        return notes + _save_moving(gaussians, out, *_clip(gaussians, out, start_s, end_s), source)
    if time_s is not None:
        return notes + _save_instant(gaussians, out, time_s, source)
    if out.suffix in FRAMES:
        if not frame_time_s:
            raise DataFormatError(f"{out}: USD and folders of PLYs need --frame-time, the seconds between two frames")
        clip = _clip(gaussians, out, start_s, end_s)
        if out.suffix:
            return notes + _save_usd(gaussians, out, *clip, frame_time_s, source, color_at)
        return [*notes, *_measured(gaussians), *save_frames(gaussians, out, *clip, frame_time_s, color_at)]
    gaussians.save(out, source)
    return notes


def _keep_facts(
    imported: Imported, out: Path, start_s: float | None, end_s: float | None, frame_time_s: float | None
) -> list[str]:
    """Write OUT.gof.json of what a format has no place for: that a flame is emissive, and that it is alone. Returns
    notes, one of them on how an emissive one is drawn."""
    g = imported.gaussians
    emissive = isinstance(g, TransientGaussians) and g.emissive
    timeless = out.suffix in ("", dgs.SUFFIX)
    unsaid = emissive and (timeless or out.name.endswith(".ftgs.ply"))
    notes = [HAZIER] if emissive and out.suffix != ".npz" else []
    if not unsaid and not imported.flame_only:
        return notes
    options = ImportOptions(
        time_unit_s=None if out.suffix else frame_time_s,
        time_zero_s=_clip(g, out, start_s, end_s)[0] if timeless and isinstance(g, TransientGaussians) else 0.0,
        flame_only=imported.flame_only or bool(g.dynamic.all()),
        emissive=unsaid,
    )
    return [
        *notes,
        f"{write_sidecar(out, options).name} beside it tells gof what it cannot say itself: keep both together",
    ]


def _light_in(out: Path) -> str:
    """Return in words which light on a room a format holds."""
    if out.suffix in FRAMES:
        return "each frame has its own"
    if out.suffix in INSTANT:
        return "it is that of the instant"
    return "its mean is written, since colours here do not change in time: USD and folders of PLYs hold each frame's"


def _save_ftgs(
    gaussians: TransientGaussians,
    out: Path,
    start_s: float | None,
    end_s: float | None,
    frame_time_s: float | None,
) -> list[str]:
    frames = None
    if frame_time_s and start_s is not None and end_s is not None:
        frames = round((end_s - start_s) / frame_time_s) + 1
    start_s, end_s = _clip(gaussians, out, start_s, end_s)
    ftgs.save(gaussians, out, start_s, end_s, frames)
    return [*_measured(gaussians), *ftgs.losses(gaussians, start_s, end_s)]


def _save_moving(gaussians: TransientGaussians, out: Path, start_s: float, end_s: float, source: str) -> list[str]:
    """Write a file of one of the MOVING formats, read it again, and say what that cost."""
    order = MOVING[out.suffix].save(gaussians, out, start_s, end_s, source)
    timeless = out.suffix == dgs.SUFFIX  # it says nothing of our clock, nor of a datum
    back = read_result(out, ImportOptions(time_zero_s=start_s if timeless else 0.0)).gaussians
    assert isinstance(back, TransientGaussians)
    sizes = f"{out.stat().st_size:,} bytes, {out.stat().st_size / len(gaussians):.1f} a Gaussian"
    clock = f"its clock begins at {start_s:g} s and lasts {end_s - start_s:g} s"
    return [
        f"{sizes}; {clock}",
        *(_measured(gaussians) if timeless else []),
        *MOVING[out.suffix].losses(gaussians),
        str(measure_loss(gaussians[order], back, start_s, end_s)),
    ]


def _save_usd(
    gaussians: TransientGaussians,
    out: Path,
    start_s: float,
    end_s: float,
    step_s: float,
    source: str,
    color_at: usd.ColorAt | None,
) -> list[str]:
    """Write USD; where OpenUSD's library is at hand, as for .usdc it is, read it again and say what rounding cost."""
    seen, notes = usd.save(gaussians, out, start_s, end_s, step_s, source, color_at)
    if out.suffix == ".usdc":
        back = read_result(out, ImportOptions()).gaussians
        assert isinstance(back, TransientGaussians)
        if color_at is not None:  # what is read has the colours of the first frame
            gaussians = replace(gaussians, color=color_at(start_s))
        notes.append(str(measure_loss(gaussians[seen], back, start_s, end_s)))
    return notes


def _measured(gaussians: TransientGaussians) -> list[str]:
    """Return a note on what a format without a datum leaves out."""
    if not gaussians.datum:
        return []
    x, y, z, t = gaussians.datum.numbers().tolist()
    return [f"places count from ({x:.12g}, {y:.12g}, {z:.12g}) m and times from {t:.12g} s; the file cannot say so"]


def _middle(gaussians: TransientGaussians) -> float:
    moving = gaussians.t_mu[gaussians.dynamic]
    return float(np.median(moving)) if len(moving) else 0.0


def _save_instant(gaussians: TransientGaussians, out: Path, time_s: float, source: str) -> list[str]:
    notes = _measured(gaussians)
    if out.suffix == ".glb":
        if len(gaussians) and not (gaussians.at(time_s)[1] >= VISIBLE).any():
            when = _when_seen(gaussians)
            notes.append(f"no Gaussian can be seen at {time_s:g} s{when}; --time chooses another instant")
        return notes + gltf.save(gaussians, out, time_s, source)
    return notes + compressed.save(gaussians, out, time_s)


def _when_seen(gaussians: TransientGaussians) -> str:
    """Return in words from when to when they shine; empty where that is not known."""
    born, dead = gaussians.life() if gaussians.dynamic.any() else (np.nan, np.nan)
    return f", but between {born:.4g} and {dead:.4g} s" if np.isfinite([born, dead]).all() else ""


def _clip(gaussians: TransientGaussians, out: Path, start_s: float | None, end_s: float | None) -> tuple[float, float]:
    """Return first and last second to write: what was given, else when the first one appears and the last one is
    gone."""
    born, dead = gaussians.life() if gaussians.dynamic.any() else (0.0, 1.0)
    if not np.isfinite([born, dead]).all() and None in (start_s, end_s):
        raise DataFormatError(f"{out}: some Gaussians are always on, so --clip must be given")
    return born if start_s is None else start_s, dead if end_s is None else end_s


# ----------------------------------------------------------------
# A folder of 3DGS PLYs, one for every frame: for viewers that know no time, and play files one after another.


def save_frames(
    gaussians: TransientGaussians,
    folder: Path,
    start_s: float,
    end_s: float,
    step_s: float,
    color_at: usd.ColorAt | None = None,
) -> list[str]:
    """Write folder/frame00000.ply, ...: number k is the state at start_s + k step_s; the folder must not exist.

    The same Gaussians in the same order in every file, so that their ways can be followed; those that no file would
    show are left out. Returns what was written, in words.

    Args:
        color_at: gives the colours of all Gaussians at a time, where they change.

    Raises:
        DataFormatError: more frames than five digits count, or nothing is ever seen.
    """
    times, seen = usd.frames_of(gaussians, folder, start_s, end_s, step_s)
    g = gaussians[seen]
    with whole_folder(folder) as whole:
        for number, time_s in enumerate(times):
            position, opacity = g.at(time_s)
            state = {"position": position, "opacity": opacity}
            if color_at is not None:
                state["color"] = color_at(time_s)[seen]
            columns = splat_columns(g.arrays() | state)
            write(
                whole / f"frame{number:05d}.ply",
                columns,
                [f"state at {time_s:.6f} s", "units: metres; world frame, Z up"],
            )
    return [f"{len(times)} files of {len(g):,} Gaussians, {1e3 * step_s:g} ms apart from {start_s:g} s on"]
