"""A data card: what a packed dataset is, for people and for the fields that data hosts read."""

from __future__ import annotations

import json

from gof.dataset.dataset import Dataset
from gof.dataset.truth import Truth


def card(dataset: Dataset, licence: str, authors: tuple[str, ...], total: int) -> str:
    """Markdown under a YAML head.

    Args:
        total: bytes of the files.
    Raises:
        DataFormatError: the true velocity cannot be read.
    """
    said = description_lines(dataset, total)
    made = dataset.description.provenance
    parts = [
        "---",
        f"license: {_quoted(licence.lower())}",
        f"pretty_name: {_quoted(dataset.description.name)}",
        "tags: [fire, gaussian-splatting, 4d, velocity, benchmark]",
        "---",
        f"# {_plain(dataset.description.name)}",
        "",
        f"Made by {_plain(', '.join(authors))}. Licence: {_plain(licence)}.",
        "",
        "| what | |",
        "|---|---|",
        *(f"| {what} | {_plain(found)} |" for what, found in said.items()),
        "",
        "Frames of `splits.test` in dataset.json are held out: no method may use them, nor flow from or to them.",
        "",
        "## What made it",
        "",
        "```json",
        json.dumps(made, indent=1, sort_keys=True).replace("```", "'''"),
        "```",
        "",
        "## To open it",
        "",
        "    gof unpack ARCHIVE.tar --out data       every file is compared with its checksum",
        "    cd data/NAME && sha256sum -c SHA256SUMS  the same, without gof",
        "",
    ]
    return "\n".join(parts)


def description_lines(dataset: Dataset, total: int) -> dict[str, str]:
    """What a reader wants to know first."""
    about = dataset.description
    sizes = sorted({f"{entry.width}x{entry.height}" for entry in about.cameras})
    roles = [entry.role for entry in about.cameras]
    held_out = ", ".join(map(str, about.splits.test))
    lines = {
        "kind": "simulated, with true velocities" if dataset.has_velocity else "a capture of a real fire",
        "cameras": f"{roles.count('train')} to train on, {roles.count('eval')} to evaluate; {', '.join(sizes)} pixels",
        "frames": f"{len(about.time_s)} over {about.time_s[-1]:g} s; held out: {held_out}",
        "effects": ", ".join(about.effects) or "none",
        "size": f"{total / 1e6:.1f} MB",
    }
    if dataset.has_velocity:
        store = dataset.velocity
        cells = "x".join(map(str, store.resolution))
        lines["velocity"] = f"velocity.zarr, {cells} cells at {len(store)} times, m/s in world axes, at cell centres"
        lines["digest of the truth"] = f"{Truth.of(dataset).sha256} (docs/benchmark.md says what it is of)"
    return lines


def _quoted(text: str) -> str:
    return json.dumps(text).replace("<", "\\u003c")  # a JSON string is a YAML string; no tag on a host's page


def _plain(text: str) -> str:
    """On one line, and not the end of a cell."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
