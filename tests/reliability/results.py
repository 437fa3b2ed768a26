"""Results to damage: ours in both formats and both readers, and other methods'."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.reliability.datasets import colmap
from tests.reliability.format import Format


def formats() -> dict[str, Format]:
    """By name."""
    from gof.core import ftgs
    from gof_blender.core.errors import GofError

    ply, npz, add_on = "result.ply", "result.npz", {"refusals": (GofError,), "share": 2}
    return {
        "result .ply": Format(lambda f: gaussians(harmonics=4).save(f / ply), _read_transient(ply), share=2),
        "result .npz": Format(lambda f: gaussians().save(f / npz), _read_transient(npz), share=2),
        "result .ply, add-on": Format(lambda f: gaussians().save(f / ply), _read_in_blender(ply), **add_on),
        "result .npz, add-on": Format(lambda f: gaussians().save(f / npz), _read_in_blender(npz), **add_on),
        "FTGS .ply": Format(
            lambda f: ftgs.save(gaussians(), f / "r.ftgs.ply", 0, 1), _read_foreign("r.ftgs.ply"), share=2
        ),
        "FreeTimeGS .npz": Format(_free_time_npz, _read_foreign("canonical_4d.npz"), share=2),
        "FreeTimeGS in a COLMAP world": Format(_free_time_world, _read_in_colmap_world, "**/*.[nt][px]*", named=False),
        "SpacetimeGaussians .ply": Format(_spacetime, _read_spacetime),
        "4DGS of Yang, cfg_args": Format(_yang, _read_foreign("chkpnt7.pth")),
        "trajectory .npz": Format(_trajectory, _read_foreign("t.npz", None), share=2),
        "sequence of .ply": Format(_still_plys, _read_foreign()),
        "checkpoint .pth": Format(_checkpoint, _read_foreign("chkpnt7.pth"), share=2),
    }


def gaussians(n: int = 12, harmonics: int = 0):
    from gof.core.gaussians import TransientGaussians

    rng = np.random.default_rng(0)
    return TransientGaussians(
        position=rng.normal(size=(n, 3)),
        velocity=rng.normal(size=(n, 3)),
        t_mu=rng.random(n),
        t_sigma=np.where(rng.random(n) < 0.2, np.inf, 0.1),
        scale=rng.uniform(0.01, 0.1, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.random(n),
        color=rng.random((n, harmonics, 3) if harmonics else (n, 3)),
        dynamic=rng.random(n) < 0.8,
    )


def _free_time_npz(folder: Path) -> None:
    rng, shapes = (
        np.random.default_rng(0),
        {"means": 3, "scales": 3, "quats": 4, "times": 1, "durations": 1, "velocities": 3},
    )
    arrays = {name: rng.normal(size=(9, k)).astype("f4") for name, k in shapes.items()}
    np.savez(
        folder / "canonical_4d.npz",
        **arrays,
        opacities=np.zeros(9, "f4"),
        sh0=np.zeros((9, 1, 3), "f4"),
        shN=np.zeros((9, 3, 3), "f4"),
        n_frames=np.array(9),
    )


def _free_time_world(folder: Path) -> None:
    """FreeTimeGS beside the COLMAP model that its world was normalised from."""
    _free_time_npz(folder)
    (folder / "colmap").mkdir()
    colmap(folder / "colmap")


def _spacetime(folder: Path) -> None:
    from gof.core.ply import splat_columns, write

    rng = np.random.default_rng(0)
    columns = splat_columns(gaussians(9).arrays())
    names = ["trbf_center", "trbf_scale", *(f"motion_{i}" for i in range(9)), *(f"omega_{i}" for i in range(4))]
    write(folder / "point_cloud.ply", columns | {name: rng.normal(size=9) for name in names}, [])


def _yang(folder: Path) -> None:
    import torch

    n, zeros = 8, torch.zeros
    turns = torch.randn(n, 4), torch.randn(n, 4)
    shared = (1, torch.randn(n, 3), zeros(n, 1, 3), zeros(n, 15, 3), zeros(n, 3), turns[0], zeros(n, 1), zeros(n))
    learned = (zeros(n, 1), zeros(n, 1), zeros(n, 1), {"state": {}, "param_groups": []}, 1.0)
    state = (*shared, *learned, torch.rand(n, 1), zeros(n, 1), turns[1], True, zeros(0), 2)
    torch.save((state, 7), folder / "chkpnt7.pth")
    (folder / "cfg_args").write_text("Namespace(sh_degree=3, source_path='a', prefilter_var=0.02, gaussian_dim=4)")


def _trajectory(folder: Path) -> None:
    from gof.core.trajectory import Trajectory

    rng = np.random.default_rng(0)
    Trajectory(
        np.arange(6) * 0.1,
        rng.normal(size=(6, 5, 3)),
        rng.random((6, 5)),
        rng.uniform(0.1, 1, (5, 3)),
        rng.normal(size=(6, 5, 4)),
    ).save(folder / "t.npz")


def _still_plys(folder: Path) -> None:
    from gof.core.ply import splat_columns, write

    for number in range(3):
        write(folder / f"{number:03d}.ply", splat_columns(gaussians(5).arrays()), [])


def _checkpoint(folder: Path) -> None:
    import torch

    n, zeros = 8, torch.zeros
    state = (
        1,
        torch.randn(n, 3),
        torch.randn(n, 3),
        zeros(n, 1, 3),
        zeros(n, 3, 3),
        zeros(n, 3),
        torch.randn(n, 4),
        zeros(n, 1),
        zeros(n, 1),
        torch.ones(n, 1),
        torch.ones(n, dtype=torch.bool),
        zeros(n),
        zeros(n, 1),
        zeros(n, 1),
        {"state": {}, "param_groups": []},
        1.0,
    )
    torch.save((state, 7), folder / "chkpnt7.pth")
    (folder / "scale_bounds.json").write_text('{"dynamic_scale_min": 0.001, "dynamic_scale_max": 0.03}')


def _read_transient(name: str) -> Callable[[Path], Any]:
    def read(folder: Path):
        from gof.core.gaussians import TransientGaussians

        return TransientGaussians.load(folder / name)

    return read


def _read_in_blender(name: str) -> Callable[[Path], Any]:
    def read(folder: Path):
        from gof_blender.pure.io import cloud as clouds

        clouds.count(folder / name)
        return clouds.load(folder / name)

    return read


def _read_foreign(name: str = "", time_unit_s: float | None = 0.5) -> Callable[[Path], Any]:
    def read(folder: Path):
        from gof.io.importers import ImportOptions, read_result

        return read_result(folder / name, ImportOptions(time_unit_s=time_unit_s)).gaussians

    return read


def _read_in_colmap_world(folder: Path):
    from gof.io.importers import ImportOptions, read_result

    options = ImportOptions(time_unit_s=0.5, world=folder / "colmap", world_by="freetime")
    return read_result(folder / "canonical_4d.npz", options).gaussians


def _read_spacetime(folder: Path):
    motion = _read_foreign("point_cloud.ply")(folder)
    return [motion.state_at(time_s) for time_s in (0.0, 0.3)]
