"""OpenUSD files: the closed form in their text, and by OpenUSD's own library where it is installed."""

import ast
import importlib.util
import json
import re

import numpy as np
import pytest

from gof.commands.convert import main
from gof.core.errors import DataFormatError, MissingDependencyError, NonFiniteError
from gof.core.harmonics import C0
from gof.io import usd
from tests.conftest import random_gaussians
from tests.io import stages

START_S, END_S, STEP_S = 0.1, 0.4, 0.05


def written(folder, name="a.usda", **changes):
    """Gaussians that are all seen in some frame, some of them without end, and their file."""
    n = 60
    rng = np.random.default_rng(5)
    life = np.where(rng.random(n) < 0.2, np.inf, rng.uniform(0.03, 0.1, n))
    fields = {"t_mu": rng.uniform(START_S, END_S, n), "t_sigma": life, "opacity": rng.uniform(0.3, 1, n)}
    g = random_gaussians(n)
    g = type(g)(**g.arrays() | fields | {"gas_velocity": rng.normal(0, 2, (n, 3))} | changes)
    usd.save(g, folder / name, START_S, END_S, STEP_S, 'gof "reconstruct"')
    return g, folder / name


def parsed(path):
    """Attributes of a .usda by name: an array, or arrays by frame."""
    text, found = path.read_text(), {}
    for kind, name, body in re.findall(
        r"^    (\w+\[\]) ([\w:.]+) = (\[.*?\](?=$| \()|\{.*?^    \})", text, re.M | re.S
    ):
        value = ast.literal_eval(body)
        found[name] = {k: np.array(v) for k, v in value.items()} if isinstance(value, dict) else np.array(value)
        assert kind in ("float[]", "float3[]", "point3f[]", "quatf[]", "vector3f[]"), name
    return text, found


def closed_form(g, time_s):
    """Places and opacities from the formula, in double precision."""
    since = np.where(g.dynamic, time_s - g.t_mu.astype(float), 0)
    with np.errstate(divide="ignore"):
        fade = np.exp(-0.5 * (since / g.t_sigma.astype(float)) ** 2)
    return g.position + since[:, None] * g.velocity.astype(float), g.opacity * fade


def test_the_text_says_the_closed_form(tmp_path):
    g, path = written(tmp_path)
    text, found = parsed(path)
    assert text.startswith("#usda 1.0\n") and 'def ParticleField3DGaussianSplat "flame"' in text
    for line in ("metersPerUnit = 1", 'upAxis = "Z"', "timeCodesPerSecond = 20.0", "startTimeCode = 0"):
        assert line in text
    assert "endTimeCode = 6" in text and "sphericalHarmonicsDegree = 0" in text and r"\"reconstruct\"" in text
    places, opacities = found["positions.timeSamples"], found["opacities.timeSamples"]
    assert list(places) == [0, 6] and list(opacities) == list(range(7))
    for k in (0, 3, 6):
        wanted, fade = closed_form(g, START_S + k * STEP_S)
        between = places[0] + (places[6] - places[0]) * k / 6  # as players interpolate
        np.testing.assert_allclose(between, wanted, atol=1e-6)
        np.testing.assert_allclose(opacities[k], np.where(fade >= 1 / 255, fade, 0), atol=1e-6)
    np.testing.assert_allclose(found["scales"], g.scale, rtol=1e-6)
    np.testing.assert_allclose(found["orientations"], g.rotation, atol=1e-6)  # the real part first, as in all of USD
    sh = found["radiance:sphericalHarmonicsCoefficients"]
    np.testing.assert_allclose(0.5 + C0 * sh, g.color, atol=1e-6)
    always = ~g.dynamic | np.isinf(g.t_sigma)
    np.testing.assert_allclose(found["primvars:velocity"], np.where(g.dynamic[:, None], g.velocity, 0), rtol=1e-6)
    np.testing.assert_allclose(found["primvars:gas_velocity"][g.dynamic], g.gas_velocity[g.dynamic], rtol=1e-6)
    np.testing.assert_allclose(found["primvars:t_sigma"], np.where(always, 0, g.t_sigma), rtol=1e-6)
    np.testing.assert_allclose(found["primvars:t_mu"], np.where(g.dynamic, g.t_mu, 0), rtol=1e-6)
    np.testing.assert_allclose(found["primvars:peak_opacity"], g.opacity, rtol=1e-6)


def test_boxes_hold_what_is_seen(tmp_path):
    g, path = written(tmp_path)
    boxes = parsed(path)[1]["extent.timeSamples"]
    for k, (low, high) in boxes.items():
        places, fade = closed_form(g, START_S + k * STEP_S)
        seen = places[fade > 1 / 255 + 1e-6]
        assert (low < seen.min(0)).all() and (seen.max(0) < high).all()
        assert (high - low < np.ptp(seen, axis=0) + 6 * g.scale.max() + 1e-6).all()


def test_what_no_frame_shows_is_left_out_and_harmonics_are_kept(tmp_path):
    t_mu = np.full(60, 0.25)
    t_mu[:10] = 9.0
    color = np.random.default_rng(0).normal(0, 0.3, (60, 9, 3))
    short = {"dynamic": np.ones(60, bool), "t_sigma": np.full(60, 0.05)}
    g, path = written(tmp_path, t_mu=t_mu, color=color, **short)
    text, found = parsed(path)
    assert len(found["scales"]) == 50 and "sphericalHarmonicsDegree = 2" in text
    sh = found["radiance:sphericalHarmonicsCoefficients"].reshape(50, 9, 3)  # by particle, then by coefficient
    np.testing.assert_allclose(sh, g.color[10:], rtol=1e-6)


def test_openusds_own_library_reads_it(tmp_path):
    stages.openusd()
    from pxr import Usd, UsdGeom, UsdValidation, UsdVol

    for name in ("a.usda", "a.usdc"):
        g, path = written(tmp_path, name)
        stage = Usd.Stage.Open(str(path))
        prim = stage.GetDefaultPrim()
        assert prim.IsA(UsdVol.ParticleField3DGaussianSplat) and UsdGeom.GetStageUpAxis(stage) == "Z"
        known = prim.GetPrimDefinition().GetPropertyNames()
        own = [prop.GetName() for prop in prim.GetAuthoredProperties() if prop.GetName() not in known]
        assert own and all(name.startswith("primvars:") for name in own)
        places = UsdVol.ParticleFieldPositionAttributeAPI(prim).GetPositionsAttr()
        opacities = UsdVol.ParticleFieldOpacityAttributeAPI(prim).GetOpacitiesAttr()
        for k in (0, 2.5, 6):
            wanted, fade = closed_form(g, START_S + k * STEP_S)
            np.testing.assert_allclose(np.array(places.Get(k)), wanted, atol=1e-6)
            if k != 2.5:
                np.testing.assert_allclose(np.array(opacities.Get(k)), np.where(fade >= 1 / 255, fade, 0), atol=1e-6)
        turns = UsdVol.ParticleFieldOrientationAttributeAPI(prim).GetOrientationsAttr().Get()
        found = [[turn.GetReal(), *turn.GetImaginary()] for turn in turns]
        np.testing.assert_allclose(found, g.rotation, atol=1e-6)
        context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
        assert not [error.GetErrorAsString() for error in context.Validate(stage)]


def test_gof_convert_to_usd(tmp_path):
    g = random_gaussians(20)
    g.dynamic[:], g.t_mu[:], g.t_sigma[:] = True, 0.2, 0.05
    g.save(tmp_path / "a.npz")
    words = [str(tmp_path / "a.npz"), str(tmp_path / "a.usda")]
    with pytest.raises(DataFormatError, match="need --frame-time"):
        main(words)
    with pytest.raises(DataFormatError, match="can be seen between"):
        main([*words, "--frame-time", "0.1", "--clip", "7", "8"])
    with pytest.raises(DataFormatError, match=r"frames from 0\.0 s to 3000\.0 s"):
        main([*words, "--frame-time", "0.01", "--clip", "0", "3000"])
    assert not list(tmp_path.glob("*.usda")) and not list(tmp_path.glob(".*partial*"))
    assert main([*words, "--frame-time", "0.1", "--clip", "0", "0.4", "--json", str(tmp_path / "j")]) == 0
    assert any("5 frames" in note for note in json.loads((tmp_path / "j").read_text())["notes"])
    if importlib.util.find_spec("pxr") is None:
        with pytest.raises(MissingDependencyError, match=r"\[usd\]"):
            main([words[0], str(tmp_path / "a.usdc"), "--frame-time", "0.1", "--clip", "0", "0.4"])
    g.position[0] = g.velocity[0] = 3e38
    with pytest.raises(NonFiniteError, match="positions"):
        usd.save(g, tmp_path / "b.usda", 0.0, 0.4, 0.1)
    assert not (tmp_path / "b.usda").exists()


@pytest.mark.blender
def test_the_openusd_of_blender_reads_what_we_write(tmp_path):
    """Blender 4.5 brings one that is older than the schema of splats: it knows the attributes all the same."""
    pytest.importorskip("bpy", reason="the bpy wheel is not installed")
    from tests.blender.runs import in_blender

    g, _ = written(tmp_path, "a.usda")
    names = ["a.usda"]
    if stages.has_openusd():  # which .usdc needs
        names.append(written(tmp_path, "a.usdc")[1].name)
    found = in_blender(
        """
        from pathlib import Path
        import numpy as np
        python = Path(bpy.__file__).resolve().parents[3] / "python" / "lib"
        sys.path[:0] = map(str, [*python.glob("python3*/site-packages"), python / "site-packages"])
        import pxr
        from pxr import Usd
        assert Path(pxr.__file__).is_relative_to(python), "not another one beside it"
        for name in sys.argv[2:]:
            stage = Usd.Stage.Open(sys.argv[1] + "/" + name)
            prim = stage.GetDefaultPrim()
            values = {k: np.array(prim.GetAttribute("positions").Get(k)).tolist() for k in (0, 3, 6)}
            values |= {"turns": np.array(prim.GetAttribute("orientations").Get()).tolist()}
            values |= {"velocity": np.array(prim.GetAttribute("primvars:velocity").Get()).tolist()}
            result[name] = values | {"type": str(prim.GetTypeName())}
        """,
        tmp_path,
        *names,
    )
    assert list(found) == names
    for values in found.values():
        assert values["type"] == "ParticleField3DGaussianSplat"
        for k in (0, 3, 6):
            np.testing.assert_allclose(values[str(k)], closed_form(g, START_S + k * STEP_S)[0], atol=1e-6)
        np.testing.assert_allclose(np.roll(values["turns"], 1, axis=1), g.rotation, atol=1e-6)
        np.testing.assert_allclose(values["velocity"], np.where(g.dynamic[:, None], g.velocity, 0), rtol=1e-6)
