"""A cloud against the true velocity: the truth at its centres as one more attribute, and views of the difference.

The true velocity is that at each Gaussian's centre at its brightest time (t_mu), a quick look for the eye. DVE, the
score, weighs each Gaussian's whole extent and its opacity over time: `gof evaluate` computes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from ..core.fields import VelocitySequence
from . import gaussian_nodes, point_cloud

VIEW_OF = "gof_view_of"  # custom property: the cloud, which may be renamed
ARROWS = 3000  # of one view; more are a thicket


@dataclass(frozen=True)
class CentreError:
    """Velocity error at the centres of the moving Gaussians inside the domain, m/s."""

    median: float
    relative: float  # root mean square error over root mean square true speed
    compared: int


def add_truth(object_: bpy.types.Object, truth: VelocitySequence) -> CentreError:
    """Store the true velocity as gs_true_velocity; a Gaussian that rests or lies outside the domain gets its own.

    The cloud's own coordinates are the dataset's world, so it may have been moved since.
    """
    mesh = object_.data
    velocity, t_mu = point_cloud.column(mesh, "gs_gas_velocity", 3), point_cloud.column(mesh, "gs_t_mu", 1)[:, 0]
    true, inside = truth.sample(positions(mesh), t_mu)
    # Gas that was found to rest where its light moves is compared, too: that is an error like any other.
    moving = (velocity != 0).any(1) | (point_cloud.column(mesh, "gs_velocity", 3) != 0).any(1)
    compared = inside & moving
    true[~compared] = velocity[~compared]
    point_cloud.add_column(mesh, "gs_true_velocity", true)
    error = np.linalg.norm(velocity - true, axis=1)[compared].astype(float)
    power = float((true[compared].astype(float) ** 2).sum())
    return CentreError(
        float(np.median(error)) if len(error) else float("nan"),
        float(np.sqrt((error**2).sum() / power)) if power > 0 else float("nan"),
        int(compared.sum()),
    )


def positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Centres at t_mu, (N, 3) float32 m, in the cloud's own coordinates."""
    out = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def seen_by(view: bpy.types.Object) -> bpy.types.Object | None:
    """Return the cloud that a view shows; None where it is gone."""
    of = view[VIEW_OF]
    return bpy.data.objects.get(of) if isinstance(of, str) else of  # older versions of the add-on kept its name


def show(object_: bpy.types.Object) -> list[bpy.types.Object]:
    """Return three views beside the cloud, of the same points: coloured by error; true velocity and error as arrows.

    Arrows have one length per m/s and colours one range in all of them. Views of an earlier call are replaced.
    """
    for other in [other for other in bpy.data.objects if VIEW_OF in other and seen_by(other) == object_]:
        bpy.data.objects.remove(other)
    settings = point_cloud.inputs(object_)
    across = np.percentile(positions(object_.data)[:, 0], [1, 99])  # without the runaways
    width = 1.5 * float(across[1] - across[0])
    fastest = point_cloud.value_range(object_.data, "speed")[1]
    views = []
    for number, (name, mode, color, vectors) in enumerate(
        (
            ("Error", gaussian_nodes.QUICK, "error", "velocity"),
            ("True Velocity", "arrows", "speed", "true velocity"),
            ("Error Arrows", "arrows", "error", "error"),
        ),
        1,
    ):
        view = point_cloud.add_view(object_.data, f"{object_.name} {name}")
        view[VIEW_OF] = object_
        view.matrix_world = object_.matrix_world
        view.location = object_.matrix_world @ Vector((number * width, 0, 0))
        inputs = point_cloud.inputs(view)
        for key in ("Start Frame", "Time Scale", "Opacity Cut", "Line Time"):
            inputs[key] = settings[key]
        inputs["Mode"] = gaussian_nodes.MODES.index(mode)
        inputs["Arrows Show"] = gaussian_nodes.VECTORS.index(vectors)
        inputs["Color By"] = gaussian_nodes.COLORS.index(color)
        inputs["Color Min"], inputs["Color Max"] = 0.0, fastest
        if mode == "arrows":
            inputs["Share"] = min(1.0, ARROWS / len(object_.data.vertices))
        views.append(view)
    return views
