"""OpenUSD stages with splats, written by OpenUSD's own library as other programs write them."""

import numpy as np
import pytest


def has_openusd():
    try:
        from pxr import Usd
    except ImportError:
        return False
    return Usd.GetVersion() >= (0, 26, 3)


def openusd():
    """OpenUSD with splats, or a skip that says why not."""
    pytest.importorskip("pxr", reason="OpenUSD is not installed: pip install '.[usd]'")
    from pxr import Usd

    if not has_openusd():
        pytest.skip("this OpenUSD is older than 26.3, which has splats: Blender's own, where bpy was imported before")
    return Usd


def new(path, up="Z", metres=1.0, rate=50.0, start=None):
    """An empty stage; what is None is not authored."""
    Usd = openusd()
    from pxr import UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    if up:
        UsdGeom.SetStageUpAxis(stage, up)
    if metres:
        UsdGeom.SetStageMetersPerUnit(stage, metres)
    if rate:
        stage.SetTimeCodesPerSecond(rate)
    if start is not None:
        stage.SetStartTimeCode(start)
    return stage


def splats(stage, path, samples, **still):
    """A prim of splats. samples: {time code: {attribute: array}}; still: attributes at all times."""
    from pxr import UsdVol

    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, path).GetPrim()
    for code, attributes in [(None, still), *samples.items()]:
        for name, values in attributes.items():
            author(prim, name, values, code)
    return prim


def author(prim, name, values, code=None):
    """Set an attribute by its name in the schema: sh, degree and quaternions wxyz in plain words."""
    from pxr import Sdf, Usd, Vt

    values = np.asarray(values)
    time = Usd.TimeCode.Default() if code is None else code
    if name == "degree":
        prim.GetAttribute("radiance:sphericalHarmonicsDegree").Set(int(values))
        return
    kinds = Sdf.ValueTypeNames
    kind, array = {
        "positions": (kinds.Point3fArray, Vt.Vec3fArray),
        "scales": (kinds.Float3Array, Vt.Vec3fArray),
        "opacities": (kinds.FloatArray, Vt.FloatArray),
        "opacitiesh": (kinds.HalfArray, Vt.HalfArray),
        "scalesh": (kinds.Half3Array, Vt.Vec3hArray),
        "orientations": (kinds.QuatfArray, Vt.QuatfArray),
        "sh": (kinds.Float3Array, Vt.Vec3fArray),
        "velocities": (kinds.Vector3fArray, Vt.Vec3fArray),
        "primvars:id": (kinds.Int64Array, Vt.Int64Array),
        "primvars:displayColor": (kinds.Color3fArray, Vt.Vec3fArray),
    }[name]
    if name == "orientations":
        values = np.roll(values, -1, axis=-1)  # in its arrays the real part is the last
    plain = np.int64 if kind == kinds.Int64Array else np.float16 if name.endswith("h") and name != "sh" else np.float32
    name = {"sh": "radiance:sphericalHarmonicsCoefficients"}.get(name, name)
    values = np.ascontiguousarray(values, plain)
    prim.CreateAttribute(name, kind).Set(array.FromNumpy(values) if values.size else array(), time)
