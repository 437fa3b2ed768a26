"""`gof.render.gsplat.rasterization`: the whole call of gsplat 1.6, and what its strategies do with the info."""

import inspect

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.render import reference
from tests.render.scenes import camera, gaussians

torch = pytest.importorskip("torch")
pytest.importorskip("drjit")

from gof.render.gsplat import rasterization  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")

# gsplat 1.6.0's own arguments in their order, with their defaults where it has them (gsplat/rendering.py there).
SIGNATURE = """means quats scales opacities colors viewmats Ks width height near_plane=0.01 far_plane=1e10
radius_clip=0.0 eps2d=0.3 sh_degree=None packed=True tile_size=None backgrounds=None render_mode='RGB' sparse_grad=False
absgrad=False rasterize_mode='classic' channel_chunk=32 distributed=False camera_model='pinhole' segmented=False
covars=None with_ut=False with_eval3d=False return_normals=False global_z_order=True rays=None radial_coeffs=None
tangential_coeffs=None thin_prism_coeffs=None ftheta_coeffs=None lidar_coeffs=None external_distortion_coeffs=None
rolling_shutter=GLOBAL viewmats_rs=None ut_params=None extra_signals=None extra_signals_sh_degree=None
renderer_config=None""".split()


class Global:
    """As an enumeration's member of that name is."""

    name = "GLOBAL"


def close(have, want):
    """Up to pixels at the edge of a Gaussian that is just seen or just not."""
    have, want = np.asarray(have.detach()), np.asarray(want)
    np.testing.assert_allclose(have, want, atol=5 / 255)
    assert (np.abs(have - want) > 2e-4).mean() < 5e-3


def arguments(g, cams, grad=False):
    names = ("means", "quats", "scales", "opacities", "colors")
    tensors = {
        n: torch.tensor(v, dtype=torch.float32, requires_grad=grad) for n, v in zip(names, g.values(), strict=True)
    }
    poses = torch.tensor(np.stack([c.world_to_camera for c in cams]), dtype=torch.float32)
    Ks = torch.tensor(np.stack([c.K for c in cams]), dtype=torch.float32)
    return tensors | {"viewmats": poses, "Ks": Ks, "width": cams[0].width, "height": cams[0].height}


def other_camera(cam):
    W = cam.world_to_camera.copy()
    W[:3, 3] += [0.3, 0.02, -0.2]
    return type(cam)("b", cam.width, cam.height, cam.K, W)


def test_gsplat_draws_with_its_own_clamp():
    cam, g = camera(40, 30), gaussians(60, 7, 0.15)
    g["opacity"][:] = 1.0
    image, alpha, info = rasterization(**arguments(g, [cam]), packed=False)
    want, opaque, _ = reference.render(*g.values(), cam, max_alpha=0.999)
    close(image[0], want)
    close(alpha[0, ..., 0], opaque)
    assert info["radii"].shape == (1, 60, 2) and info["means2d"].shape == (1, 60, 2) and info["n_cameras"] == 1
    with pytest.raises(DataFormatError, match="info\\['conics'\\]"):
        info["conics"]


@pytest.mark.parametrize("absgrad", [False, True])
def test_packed_rows_are_those_drawn_with_their_gradients(absgrad):
    cams = [camera(40, 30), other_camera(camera(40, 30))]
    g = gaussians(50, 8, 0.02, spread=1.2)
    weights = torch.tensor(np.random.default_rng(0).normal(size=(2, 30, 40, 3)), dtype=torch.float32)
    infos = []
    for packed in (False, True):
        image, _, info = rasterization(**arguments(g, cams, grad=True), packed=packed, absgrad=absgrad)
        info["means2d"].retain_grad()
        (image * weights).sum().backward()
        infos.append(info)
    whole, rows = infos
    drawn = (whole["radii"] > 0).all(-1)
    assert 0 < drawn.sum() < 100
    assert whole["gaussian_ids"] is None and torch.equal(rows["gaussian_ids"], torch.where(drawn)[1])
    assert torch.equal(rows["camera_ids"], torch.where(drawn)[0])
    assert torch.equal(rows["radii"], whole["radii"][drawn])
    assert rows["means2d"].grad.abs().max() > 0
    np.testing.assert_allclose(rows["means2d"].grad, whole["means2d"].grad[drawn], rtol=1e-3, atol=1e-5)
    if absgrad:
        np.testing.assert_allclose(rows["means2d"].absgrad, whole["means2d"].absgrad[drawn], rtol=1e-3, atol=1e-5)


def test_the_arguments_are_gsplats_in_their_order():
    ours = inspect.signature(rasterization).parameters
    assert list(ours) == [word.partition("=")[0] for word in SIGNATURE]
    for word in SIGNATURE:
        name, _, default = word.partition("=")
        if not default:
            assert ours[name].default is inspect.Parameter.empty
        elif name != "rolling_shutter":  # gsplat's own enumeration
            assert ours[name].default == eval(default), name


def test_every_default_may_be_given_by_name_and_by_position():
    given = arguments(gaussians(20, 1, 0.1), [camera(20, 16)])
    defaults = {word.partition("=")[0]: word.partition("=")[2] for word in SIGNATURE[9:]}
    values = {name: Global() if text == "GLOBAL" else eval(text) for name, text in defaults.items()}
    want = rasterization(**given)[0]
    assert torch.equal(rasterization(**given, **values)[0], want)
    in_order = [given[word] for word in SIGNATURE[:9]]
    assert torch.equal(rasterization(*in_order, *values.values())[0], want)
    assert torch.equal(rasterization(**given, segmented=True, tile_size=16, channel_chunk=3)[0], want)


@pytest.mark.parametrize(
    "changed, said",
    [
        ({"camera_model": "fisheye"}, "only 'pinhole'"),
        ({"with_ut": True}, "only False"),
        ({"distributed": True}, "only False"),
        ({"return_normals": True}, "only False"),
        ({"global_z_order": False}, "only True"),
        ({"rays": torch.zeros(1, 20, 16, 6)}, "only None"),
        ({"radial_coeffs": torch.zeros(1, 4)}, "only None"),
        ({"extra_signals": torch.zeros(4, 2)}, "only None"),
        ({"renderer_config": object()}, "only None"),
        ({"render_mode": "RGB-Ed"}, "render_mode 'RGB-Ed'"),
    ],
)
def test_what_is_not_drawn_is_refused(changed, said):
    with pytest.raises(DataFormatError, match=said) as caught:
        rasterization(**arguments(gaussians(4), [camera(20, 16)]), **changed)
    assert next(iter(changed)) in str(caught.value)
    with pytest.raises(TypeError, match="fov"):
        rasterization(**arguments(gaussians(4), [camera(20, 16)]), fov=3)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("absgrad", [False, True])
@pytest.mark.parametrize("count", [40, 0])
def test_a_strategy_counts_what_it_sees(packed, absgrad, count):
    """The running sums of Adaptive Density Control (gsplat's DefaultStrategy), written out camera by camera."""
    cams, g = [camera(40, 30), other_camera(camera(40, 30))], gaussians(count, 8, 0.02, spread=1.2)
    image, _, info = rasterization(**arguments(g, cams, grad=True), packed=packed, absgrad=absgrad)
    info["means2d"].retain_grad()
    (image**2).sum().backward()
    gradient = info["means2d"].absgrad if absgrad else info["means2d"].grad
    assert (info["width"], info["height"], info["n_cameras"]) == (40, 30, 2)
    if packed:
        seen, rows, radii = info["gaussian_ids"], gradient, info["radii"]
    else:
        drawn = (info["radii"] > 0.0).all(dim=-1)
        seen, rows, radii = torch.where(drawn)[1], gradient[drawn], info["radii"][drawn]
    assert rows.shape == (len(seen), 2) and radii.max(dim=-1).values.shape == seen.shape
    visible = np.zeros(count)
    for cam in cams if count else ():
        middle = reference.project(*list(g.values())[:4], cam)[0]
        ahead = g["position"] @ cam.world_to_camera[2, :3] + cam.world_to_camera[2, 3] > 0.01
        visible += ahead & (np.abs(middle - [20, 15]) < [20, 15]).all(-1)  # the centre is in the picture
    counted = np.bincount(seen.numpy(), minlength=count)
    assert (counted >= visible).all() and counted.max(initial=0) <= 2


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("absgrad", [False, True])
def test_gsplats_own_strategy_runs_on_it(packed, absgrad):
    """What it adds up, before it changes the Gaussians, which needs CUDA."""
    strategies = pytest.importorskip("gsplat.strategy", exc_type=ImportError)  # it compiles itself when imported
    strategy = strategies.DefaultStrategy(absgrad=absgrad, refine_scale2d_stop_iter=9)
    cams, g = [camera(40, 30), other_camera(camera(40, 30))], gaussians(40, 8, 0.05, spread=0.8)
    given = arguments(g, cams, grad=True)
    state = strategy.initialize_state()
    image, _, info = rasterization(**given, packed=packed, absgrad=absgrad)
    strategy.step_pre_backward({"means": given["means"]}, {}, state, 1, info)
    (image**2).mean().backward()
    strategy.step_post_backward({"means": given["means"]}, {}, state, 1, info, packed=packed)
    _, _, whole = rasterization(**given, packed=False)
    assert torch.equal(state["count"], (whole["radii"] > 0).all(-1).sum(0).float()) and state["count"].max() == 2
    assert torch.equal(state["radii"], whole["radii"].amax((0, 2)) / 40)
    assert ((state["grad2d"] > 0) <= (state["count"] > 0)).all() and state["grad2d"].max() > 0
