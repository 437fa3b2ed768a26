"""Write files to test a reader of results with, by docs/formats.md alone: nothing here is code of `gof`.

    python tests/conformance.py FOLDER

`read/` holds those that a reader must read. `read/expected.json` says what is in each: position and opacity at three
times, the gas' velocity, its uncertainty (null: unknown), display colour, whether it is emissive, and the datum that
places and times count from (not added to them). `refuse/` holds those that it must refuse, each named after its cause.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

TIMES_S = (0.0, 0.05, 0.2)
C0 = 0.28209479177387814  # of the constant spherical harmonic
FIELDS = {
    "x0": np.array([[0, 0, 0.5], [0.1, -0.2, 0.6], [0, 0.05, 1.0], [-0.3, 0.4, 0.1]], np.float32),
    "v": np.array([[0, 0, 1.5], [0.25, -0.5, 2.0], [0, 0, 0], [0, 0, 0]], np.float32),
    "t_mu_s": np.array([0.0, 0.05, 0.1, 0.0], np.float32),
    "t_sigma_s": np.array([0.02, 0.1, np.inf, np.inf], np.float32),
    "scale": np.array([[0.01, 0.02, 0.03], [0.005, 0.005, 0.04], [0.1, 0.1, 0.1], [0.02, 0.3, 0.2]], np.float32),
    "rotation": np.array([[1, 0, 0, 0], [0.5, 0.5, 0.5, 0.5], [0.6, 0, 0.8, 0], [0, 0, 0, 1]], np.float32),
    "alpha": np.array([0.5, 0.25, 0.75, 0.9], np.float32),
    "rgb": np.array([[1, 0.5, 0.1], [0.9, 0.2, 0.0], [1, 1, 1], [0.2, 0.3, 0.4]], np.float32),
    "dynamic": np.array([True, True, True, False]),
}
GAS = {"v_gas": FIELDS["v"] + np.float32(0.5) * FIELDS["dynamic"][:, None]}
UNCERTAIN = {"v_sd": np.array([0.1, 0.2, np.inf, np.inf], np.float32)}
HARMONICS = {"sh": np.concatenate([(FIELDS["rgb"][:, None] - 0.5) / C0, np.full((4, 3, 3), 0.1)], 1).astype(np.float32)}
DATUM = np.array([4.5e5, 5.4e6, 320.0, 1.7e9])
COMMENTS = {"plain": ["gof-transient 1"], "emissive": ["gof-transient 3"]}
COMMENTS["datum"] = ["gof-transient 2", "datum x y z t: " + " ".join(map(repr, DATUM.tolist()))]


def npz(**changes) -> dict[str, np.ndarray]:
    """Return the fields of a file; None takes one away."""
    fields = {"schema": np.array("gof-linear/1"), "source": np.array("conformance"), **FIELDS, **changes}
    return {name: value for name, value in fields.items() if value is not None}


def columns(**changes) -> dict[str, np.ndarray]:
    """Return the properties of a PLY file by name."""
    f = FIELDS
    found = {name: f["x0"][:, k] for k, name in enumerate("xyz")}
    found |= {name: np.zeros(4) for name in ("nx", "ny", "nz")}
    found |= {f"f_dc_{k}": (f["rgb"][:, k] - 0.5) / C0 for k in range(3)}
    found["opacity"] = np.log(f["alpha"] / (1 - f["alpha"]))
    found |= {f"scale_{k}": np.log(f["scale"][:, k]) for k in range(3)}
    found |= {f"rot_{k}": f["rotation"][:, k] for k in range(4)}
    found |= {"t_mu": f["t_mu_s"], "t_sigma": f["t_sigma_s"]}
    found |= {f"v{name}": f["v"][:, k] for k, name in enumerate("xyz")}
    found["is_dynamic"] = f["dynamic"]
    found |= changes
    return {name: values for name, values in found.items() if values is not None}


def ply(comments: list[str], properties: dict[str, np.ndarray], count: int = 4) -> bytes:
    kinds = [(name, "u1" if name == "is_dynamic" else "<f4") for name in properties]
    rows = np.zeros(4, kinds)
    for name, values in properties.items():
        rows[name] = values
    head = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    head += [f"element vertex {count}"]
    head += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds]
    return "\n".join([*head, "end_header\n"]).encode() + rows.tobytes()


def expected(gas: bool = False, uncertain: bool = False, emissive: bool = False, datum: bool = False) -> dict:
    """Return what a file holds: state at TIMES_S, from the formulas of the page."""
    f = {name: np.asarray(values, np.float64) for name, values in FIELDS.items()}
    moves, states = FIELDS["dynamic"], []
    for time in TIMES_S:
        age = np.where(moves, time - f["t_mu_s"], 0.0)
        opacity = f["alpha"] * np.exp(-0.5 * (age / f["t_sigma_s"]) ** 2)
        place = f["x0"] + age[:, None] * f["v"]
        states.append({"time_s": time, "position": place.tolist(), "opacity": opacity.tolist()})
    velocity = (GAS["v_gas"] if gas else FIELDS["v"]).astype(np.float64)
    said = {"states": states, "gas_velocity": velocity.tolist(), "color": f["rgb"].tolist(), "emissive": emissive}
    said["velocity_sd"] = [float(x) if np.isfinite(x) else None for x in UNCERTAIN["v_sd"]] if uncertain else [None] * 4
    return said | ({"datum": DATUM.tolist()} if datum else {})


def wrong(name: str, row: int, value) -> dict[str, np.ndarray]:
    """Return one field with one wrong row."""
    values = FIELDS[name].copy()
    values[row] = value
    return {name: values}


READ_NPZ = {
    "plain": (npz(), {}),
    "gas": (npz(**GAS), {"gas": True}),
    "uncertain": (npz(**GAS, **UNCERTAIN), {"gas": True, "uncertain": True}),
    "harmonics": (npz(rgb=None, **HARMONICS), {}),
    "emissive": (npz(emissive=np.array(True)), {"emissive": True}),
    "datum": (npz(schema=np.array("gof-linear/2"), datum=DATUM), {"datum": True}),
}
GAS_COLUMNS = {f"gas_v{name}": GAS["v_gas"][:, k] for k, name in enumerate("xyz")}
READ_PLY = {
    "plain": (ply(COMMENTS["plain"], columns()), {}),
    "gas": (ply(COMMENTS["plain"], columns(**GAS_COLUMNS)), {"gas": True}),
    "uncertain": (
        ply(COMMENTS["plain"], columns(**GAS_COLUMNS, v_sd=UNCERTAIN["v_sd"])),
        {"gas": True, "uncertain": True},
    ),
    "emissive": (ply(COMMENTS["emissive"], columns()), {"emissive": True}),
    "datum": (ply(COMMENTS["datum"], columns()), {"datum": True}),
}
REFUSE_NPZ = {
    "newer_schema": npz(schema=np.array("gof-linear/9")),
    "no_schema": npz(schema=None),
    "field_missing": npz(alpha=None),
    "field_unknown": npz(v_gass=FIELDS["v"]),
    "two_colors": npz(**HARMONICS),
    "datum_missing": npz(schema=np.array("gof-linear/2")),
    "rows_differ": npz(alpha=FIELDS["alpha"][:3]),
    "columns_differ": npz(scale=FIELDS["scale"][:, :2]),
    "not_finite": npz(**wrong("x0", 1, np.nan)),
    "velocity_infinite": npz(**wrong("v", 0, np.inf)),
    "opacity_above_one": npz(**wrong("alpha", 2, 1.5)),
    "opacity_negative": npz(**wrong("alpha", 2, -0.1)),
    "scale_not_positive": npz(**wrong("scale", 0, 0)),
    "lifetime_not_positive": npz(**wrong("t_sigma_s", 1, 0)),
    "rotation_zero": npz(**wrong("rotation", 3, 0)),
    "uncertainty_negative": npz(v_sd=-UNCERTAIN["v_sd"]),
    "emissive_not_bool": npz(emissive=np.array(1.0)),
    "text_for_numbers": npz(alpha=np.array(["a", "b", "c", "d"])),
    "pickle": npz(alpha=np.array([0.5, None, 1, 2], object)),
}
REFUSE_PLY = {
    "newer_schema": ply(["gof-transient 9"], columns()),
    "field_missing": ply(COMMENTS["plain"], columns(t_mu=None)),
    "field_unknown": ply(COMMENTS["plain"], columns(gas_speed=np.zeros(4))),
    "gas_in_part": ply(COMMENTS["plain"], columns(gas_vx=np.zeros(4))),
    "datum_missing": ply(["gof-transient 2"], columns()),
    "not_finite": ply(COMMENTS["plain"], columns(x=[0, np.nan, 0, 0])),
    "lifetime_not_positive": ply(COMMENTS["plain"], columns(t_sigma=[0.1, -1, 1, 1])),
    "rows_missing": ply(COMMENTS["plain"], columns(), count=5),
    "cut_off": ply(COMMENTS["plain"], columns())[:-7],
}


def write(folder: Path) -> None:
    for name in ("read", "refuse"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    said = {}
    for name, (fields, what) in READ_NPZ.items():
        np.savez(folder / "read" / f"{name}.npz", **fields)
        said[f"{name}.npz"] = expected(**what)
    for name, (data, what) in READ_PLY.items():
        (folder / "read" / f"{name}.ply").write_bytes(data)
        said[f"{name}.ply"] = expected(**what)
    (folder / "read" / "expected.json").write_text(json.dumps(said, indent=1) + "\n")
    for name, fields in REFUSE_NPZ.items():
        np.savez(folder / "refuse" / f"{name}.npz", **fields)
    whole = (folder / "read" / "plain.npz").read_bytes()
    (folder / "refuse" / "cut_off.npz").write_bytes(whole[: len(whole) // 2])
    for name, data in REFUSE_PLY.items():
        (folder / "refuse" / f"{name}.ply").write_bytes(data)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
