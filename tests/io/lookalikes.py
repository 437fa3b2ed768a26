"""Files laid out exactly as other methods write them, with random content."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import torch

from tests.plys import write_ply


def logistic(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def capture(rng, n, sh_rest=15):
    """Shared raw tensors of a 3DGS descendant, as nn.Parameters."""

    def parameter(*shape, scale=1.0, shift=0.0):
        return torch.nn.Parameter(torch.tensor(rng.normal(shift, scale, shape), dtype=torch.float32))

    return {
        "xyz": parameter(n, 3),
        "f_dc": parameter(n, 1, 3),
        "f_rest": parameter(n, sh_rest, 3, scale=0.1),
        "scaling": parameter(n, 3, shift=-3.0),
        "rotation": parameter(n, 4),
        "opacity": parameter(n, 1),
    }


def optimizer_state(parameters):
    optimizer = torch.optim.Adam([{"params": [p], "lr": 1e-3, "name": k} for k, p in parameters.items()])
    sum((p**2).sum() for p in parameters.values()).backward()
    optimizer.step()
    return optimizer.state_dict()


def authors(folder: Path, n=30, iteration=7000, seed=0):
    rng = np.random.default_rng(seed)
    p = capture(rng, n)
    p["velocity"] = torch.nn.Parameter(
        torch.tensor(rng.normal(0, 1e-3, (n, 3)), dtype=torch.float32)
    )  # metres per millisecond
    t_mu = torch.nn.Parameter(torch.tensor(rng.uniform(0, 80, (n, 1)), dtype=torch.float32))
    t_sigma = torch.nn.Parameter(
        torch.tensor(rng.uniform(5, 30, (n, 1)) * rng.choice([-1, 1], (n, 1)), dtype=torch.float32)
    )
    dynamic = torch.tensor(rng.random(n) < 0.8)
    state = (
        3,
        p["xyz"],
        p["velocity"],
        p["f_dc"],
        p["f_rest"],
        p["scaling"],
        p["rotation"],
        p["opacity"],
        t_mu,
        t_sigma,
        dynamic,
        torch.zeros(n),
        torch.zeros(n, 1),
        torch.zeros(n, 1),
        optimizer_state(p),
        np.float64(4.2) * 1.1,
    )
    path = folder / f"chkpnt{iteration}.pth"
    folder.mkdir(parents=True, exist_ok=True)
    torch.save((state, iteration), path)
    bounds = folder / "point_cloud" / f"iteration_{iteration}" / "scale_bounds.json"
    bounds.parent.mkdir(parents=True)
    bounds.write_text(json.dumps({"dynamic_scale_min": 0.001, "dynamic_scale_max": 0.03}))
    return path, {k: v.detach().numpy() for k, v in p.items()} | {
        "t_mu": t_mu.detach().numpy(),
        "t_sigma": t_sigma.detach().numpy(),
        "dynamic": dynamic.numpy(),
    }


def released_scene(n=30, seed=0):
    """A flame before a still background, as plain numbers in m, s, m/s and 0..1: what `released_*` files hold."""
    rng = np.random.default_rng(seed)
    dynamic = rng.random(n) < 0.8
    dynamic[:2] = True, False
    rotation = rng.normal(size=(n, 4))
    return {
        "position": rng.normal(size=(n, 3)),
        "velocity": rng.normal(size=(n, 3)),
        "t_mu": rng.uniform(0.01, 0.08, n),
        "t_sigma": rng.uniform(0.005, 0.03, n),
        "scale": rng.uniform(0.002, 0.028, (n, 3)),
        "rotation": rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        "opacity": rng.uniform(0.05, 0.95, n),
        "color": rng.normal(size=(n, 1, 3)),
        "dynamic": dynamic,
    }


RELEASED_BOUNDS = (0.001, 0.03)  # m


def released_raw(scene):
    """The scene in the raw values of the authors' release: ms, logits, a sigmoid between the bounds, logarithms."""
    low, high = RELEASED_BOUNDS
    share = (scene["scale"] - low) / (high - low)
    dynamic = scene["dynamic"][:, None]
    return {
        "xyz": scene["position"],
        "velocity": np.where(dynamic, scene["velocity"] / 1000, 7.0),  # a still row's velocity means nothing
        "f_dc": scene["color"],
        "f_rest": np.zeros((len(dynamic), 0, 3)),
        "scaling": np.where(dynamic, np.log(share / (1 - share)), np.log(scene["scale"])),
        "rotation": 3 * scene["rotation"],  # it does not normalise what it saves
        "opacity": np.log(scene["opacity"] / (1 - scene["opacity"]))[:, None],
        "t_mu": 1000 * scene["t_mu"][:, None],
        "t_sigma": 1000 * scene["t_sigma"][:, None],
    }


def released_ply(folder: Path, scene, iteration=30000):
    """`point_cloud.ply` of the authors' release, all properties f4 in its order, and the bounds in a file beside it."""
    raw = released_raw(scene)
    path = folder / "point_cloud" / f"iteration_{iteration}" / "point_cloud.ply"
    splat_ply(
        path,
        raw,
        {"t_mu": raw["t_mu"][:, 0], "t_sigma": raw["t_sigma"][:, 0], "is_dynamic": scene["dynamic"].astype("f4")}
        | {f"velocity_{i}": raw["velocity"][:, i] for i in range(3)},
    )
    low, high = RELEASED_BOUNDS
    (path.parent / "point_cloud_scale_bounds.json").write_text(
        json.dumps({"dynamic_scale_min": low, "dynamic_scale_max": high})
    )
    return path


def released_checkpoint(folder: Path, scene, iteration=30000, bounds=RELEASED_BOUNDS):
    """`chkpnt{it}.pth` of the authors' release: the 16 entries of its ECCV demo, then both bounds as plain floats."""
    p = {k: torch.nn.Parameter(torch.tensor(v, dtype=torch.float32)) for k, v in released_raw(scene).items()}
    n = len(scene["dynamic"])
    state = (
        0,
        *(p[k] for k in ("xyz", "velocity", "f_dc", "f_rest", "scaling", "rotation", "opacity", "t_mu", "t_sigma")),
        torch.tensor(scene["dynamic"]),
        torch.zeros(n),
        torch.zeros(n, 1),
        torch.zeros(n, 1),
        optimizer_state({k: torch.nn.Parameter(v.detach().clone()) for k, v in p.items() if v.numel()}),
        np.float64(4.2) * 1.1,
        *bounds,
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"chkpnt{iteration}.pth"
    torch.save((state, iteration), path)
    return path


def yang(path: Path, n=30, seed=0, rot_4d=True, times=(0, 1)):
    rng = np.random.default_rng(seed)
    p = capture(rng, n, sh_rest=47)
    extra = {
        "t": rng.uniform(*times, (n, 1)),
        "scaling_t": rng.normal(-1, 0.5, (n, 1)),
        "rotation_r": rng.normal(size=(n, 4)),
    }
    extra = {k: torch.nn.Parameter(torch.tensor(v, dtype=torch.float32)) for k, v in extra.items()}
    state = (
        3,
        p["xyz"],
        p["f_dc"],
        p["f_rest"],
        p["scaling"],
        p["rotation"],
        p["opacity"],
        torch.zeros(n),
        torch.zeros(n, 1),
        torch.zeros(n, 1),
        torch.zeros(n, 1),
        optimizer_state(p),
        np.float64(3.3),
        extra["t"],
        extra["scaling_t"],
        extra["rotation_r"],
        rot_4d,
        torch.empty(0),
        2,
    )
    torch.save((state, 30000), path)
    return {k: v.detach().numpy() for k, v in (p | extra).items()}


def yang_covariance(raw, flip=True):
    """The method's covariance, one Gaussian at a time, written out from its definition (before 2024-09-15: no flip)."""
    out = []
    for i in range(len(raw["xyz"])):
        a, b, c, d = raw["rotation"][i].astype(float) / np.linalg.norm(raw["rotation"][i])
        p, q, r, s = raw["rotation_r"][i].astype(float) / np.linalg.norm(raw["rotation_r"][i])
        left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
        right = np.array([[p, q, r, s], [-q, p, -s, r], [-r, s, p, -q], [-s, -r, q, p]])
        turn = np.flip(left @ right, (0, 1)) if flip else left @ right
        half = turn @ np.diag(np.exp([*raw["scaling"][i].astype(float), float(raw["scaling_t"][i, 0])]))
        out.append(half @ half.T)
    return np.array(out)


def freetime(path: Path, n=30, seed=0, drop=(), extra=None, means=None):
    rng = np.random.default_rng(seed)
    n = n if means is None else len(means)
    raw = {
        "means": rng.normal(size=(n, 3)) if means is None else means,
        "scales": rng.normal(-4, 0.3, (n, 3)),
        "quats": rng.normal(size=(n, 4)),
        "opacities": rng.normal(size=n),
        "sh0": rng.normal(size=(n, 1, 3)),
        "shN": rng.normal(0, 0.2, (n, 15, 3)),
        "times": rng.uniform(0, 1, (n, 1)),
        "durations": np.log(rng.uniform(0.005, 0.3, (n, 1))),
        "velocities": rng.normal(size=(n, 3)),
    }
    splats = torch.nn.ParameterDict(
        {k: torch.nn.Parameter(torch.tensor(v, dtype=torch.float32)) for k, v in raw.items() if k not in drop}
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(
        {"step": 29999, "splats": splats.state_dict(), "optimizers": {}, "n_frames": 61, "use_velocity": True}
        | (extra or {}),
        path,
    )
    return {k: v.detach().numpy() for k, v in splats.items()}


def splat_ply(path: Path, raw: dict, extra: dict | None = None, comments=()):
    n = len(raw["xyz"])
    columns = {a: raw["xyz"][:, i] for i, a in enumerate("xyz")} | {f"n{a}": np.zeros(n) for a in "xyz"}
    columns |= {f"f_dc_{c}": raw["f_dc"][:, 0, c] for c in range(3)}
    rest = raw["f_rest"].transpose(0, 2, 1).reshape(n, -1)
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])} | {"opacity": raw["opacity"][:, 0]}
    columns |= (
        {f"scale_{i}": raw["scaling"][:, i] for i in range(3)}
        | {f"rot_{i}": raw["rotation"][:, i] for i in range(4)}
        | (extra or {})
    )
    vertex = np.empty(n, [(k, "f4") for k in columns])
    for k, v in columns.items():
        vertex[k] = v
    write_ply(path, vertex, comments=comments)


def ftgs_ply(path: Path, n=30, seed=0, n_frames=61):
    """FTGS-PLY version 1 with random content; returns the raw values under the checkpoint's names."""
    rng = np.random.default_rng(seed)
    raw = {
        "means": rng.normal(size=(n, 3)),
        "scales": rng.normal(-4, 0.3, (n, 3)),
        "quats": rng.normal(size=(n, 4)),
        "opacities": rng.normal(size=n),
        "sh0": rng.normal(size=(n, 1, 3)),
        "shN": rng.normal(0, 0.2, (n, 3, 3)),
        "times": rng.uniform(0, 1, (n, 1)),
        "durations": np.log(rng.uniform(0.005, 0.3, (n, 1))),
        "velocities": rng.normal(size=(n, 3)),
    }
    raw = {k: v.astype(np.float32) for k, v in raw.items()}
    splat_ply(
        path,
        {
            "xyz": raw["means"],
            "f_dc": raw["sh0"],
            "f_rest": raw["shN"],
            "opacity": raw["opacities"][:, None],
            "scaling": raw["scales"],
            "rotation": raw["quats"],
        },
        {
            "time": raw["times"][:, 0],
            "log_duration": raw["durations"][:, 0],
            **{f"velocity_{i}": raw["velocities"][:, i] for i in range(3)},
        },
        [
            "ftgs_version 1",
            "time_units normalized",
            "sh_degree 1",
            "use_velocity 1",
            "min_duration 0.02",
            "opacity_floor 0.0001",
            f"n_frames {n_frames}",
        ],
    )
    return raw


def wu(path: Path, n=5):
    p = capture(np.random.default_rng(0), n)
    state = (
        3,
        p["xyz"],
        {"deformation_net.grid.aabb": torch.zeros(2, 3)},
        torch.ones(n, dtype=torch.bool),
        p["f_dc"],
        p["f_rest"],
        p["scaling"],
        p["rotation"],
        p["opacity"],
        torch.zeros(n),
        torch.zeros(n, 1),
        torch.zeros(n, 1),
        optimizer_state(p),
        np.float64(2.0),
    )
    torch.save((state, 14000), path)


def colmap_binary(folder: Path, poses: dict[str, np.ndarray], points: np.ndarray):
    from scipy.spatial.transform import Rotation

    folder.mkdir(parents=True, exist_ok=True)
    images, cloud = struct.pack("<Q", len(poses)), struct.pack("<Q", len(points))
    for i, (name, pose) in enumerate(poses.items()):
        q = Rotation.from_matrix(pose[:3, :3]).as_quat()[[3, 0, 1, 2]]
        images += struct.pack("<I7dI", i + 1, *q, *pose[:3, 3], 1) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + struct.pack("<ddqddq", 1, 2, -1, 3, 4, 7)
    for i, x in enumerate(points):
        cloud += struct.pack("<Q3d3Bd", i, *x, 10, 20, 30, 0.5) + struct.pack("<Q", 2) + struct.pack("<4I", 1, 0, 2, 1)
    (folder / "images.bin").write_bytes(images)
    (folder / "points3D.bin").write_bytes(cloud)


def colmap_text(folder: Path, poses, points):
    from scipy.spatial.transform import Rotation

    folder.mkdir(parents=True, exist_ok=True)
    rows = ["# Image list with two lines of data per image:"]
    for i, (name, pose) in enumerate(poses.items()):
        q = Rotation.from_matrix(pose[:3, :3]).as_quat()[[3, 0, 1, 2]]
        rows += [
            " ".join(map(repr, [i + 1, *q.tolist(), *pose[:3, 3].tolist(), 1])) + " " + name,
            "" if i else "1.0 2.0 -1",
        ]
    (folder / "images.txt").write_text("\n".join(rows) + "\n")
    (folder / "points3D.txt").write_text(
        "# 3D points\n"
        + "".join(f"{i} {x[0]!r} {x[1]!r} {x[2]!r} 1 2 3 0.5 1 0\n" for i, x in enumerate(points.tolist()))
    )


def freetime_world(poses: dict[str, np.ndarray], points: np.ndarray, signs=(1, 1)) -> np.ndarray:
    """World to training (4, 4) as FreeTimeGsVanilla's parser (datasets/normalize.py of January 2026) makes it.

    First the cameras' mean centre to the origin, and the farthest centre to distance 1; then a turn about that origin
    onto the principal axes of the points, largest first, made right-handed by its third row. `signs`: of the first two
    axes, which its linear algebra chooses.
    """
    centres = np.array([-p[:3, :3].T @ p[:3, 3] for p in poses.values()])
    first = np.eye(4)
    first[:3] /= max(np.linalg.norm(c - centres.mean(0)) for c in centres)
    first[:3, 3] = -first[0, 0] * centres.mean(0)
    moved = (first @ np.c_[points, np.ones(len(points))].T)[:3].T
    second = np.eye(4)
    second[:3, :3] = np.linalg.svd(moved - moved.mean(0), full_matrices=False)[2]
    second[:2, :3] *= np.array(signs)[:, None]
    second[2, :3] = np.cross(second[0, :3], second[1, :3])
    return second @ first


def spacetime(path: Path, n=20, seed=0, full=False):
    """PLY of SpacetimeGaussians, properties in its order; returns the raw values."""
    rng = np.random.default_rng(seed)
    raw = {
        "xyz": rng.normal(size=(n, 3)),
        "trbf_center": rng.uniform(0, 1, (n, 1)),
        "trbf_scale": rng.normal(-1, 0.3, (n, 1)),
        "normals": np.zeros((n, 3)),
        "motion": rng.normal(size=(n, 9)),
        "f_dc": rng.uniform(0, 1, (n, 6 if full else 3)),
        "opacity": rng.normal(size=(n, 1)),
        "scale": rng.normal(-3, 0.3, (n, 3)),
        "rot": rng.normal(size=(n, 4)),
        "omega": rng.normal(size=(n, 4)),
    } | ({"f_t": rng.normal(size=(n, 3))} if full else {})
    names = {"xyz": ["x", "y", "z"], "normals": ["nx", "ny", "nz"]}
    names |= {k: [k] for k in ("trbf_center", "trbf_scale", "opacity")}
    columns = {}
    for key, values in raw.items():
        own = names.get(key, [f"{key}_{i}" for i in range(values.shape[1])])
        columns |= dict(zip(own, values.T, strict=True))
    vertex = np.empty(n, [(k, "f4") for k in columns])
    for k, v in columns.items():
        vertex[k] = v
    write_ply(path, vertex)
    return {k: v.astype(np.float32).astype(float) for k, v in raw.items()}
