"""`rasterize`: gsplat's shapes and conventions, against the float64 twin; its autograd, against differences."""

import numpy as np
import pytest

from gof.core.errors import DataFormatError, NonFiniteError
from tests.render.scenes import camera, found_once, gaussians

torch = pytest.importorskip("torch")
pytest.importorskip("drjit")

from gof.render import rasterize, reference  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")

NAMES = ("means", "quats", "scales", "opacities", "colors")


def call(g, cams, grad=False, **kwargs):
    tensors = {
        n: torch.tensor(v, dtype=torch.float32, requires_grad=grad) for n, v in zip(NAMES, g.values(), strict=True)
    }
    tensors["viewmats"] = torch.tensor(
        np.stack([c.world_to_camera for c in cams]), dtype=torch.float32, requires_grad=grad
    )
    Ks = torch.tensor(np.stack([c.K for c in cams]), dtype=torch.float32)
    return tensors, rasterize(**tensors, Ks=Ks, width=cams[0].width, height=cams[0].height, **kwargs)


def two_cameras():
    a, b = camera(40, 30), camera(40, 30)
    W = b.world_to_camera.copy()
    W[:3, 3] += [0.05, 0.02, -0.2]
    return [a, type(a)("b", 40, 30, b.K, W)]


@pytest.mark.parametrize("mode", ["RGB", "D", "ED", "RGB+D", "RGB+ED"])
def test_batch_of_cameras_equals_twin_in_every_mode(mode):
    cams, g = two_cameras(), gaussians(80, 1, 0.08)
    background = np.array([[0.1, 0.2, 0.3], [0.9, 0.5, 0.0]], np.float32)
    _, (colors, alphas, meta) = call(g, cams, render_mode=mode, backgrounds=torch.tensor(background))
    assert alphas.shape == (2, 30, 40, 1) and meta["means2d"].shape == (2, 80, 2) and meta["n_cameras"] == 2
    for i, cam in enumerate(cams):
        color, alpha, depth = reference.render(*g.values(), cam, background[i])
        mean = np.divide(depth, alpha, out=np.zeros_like(depth), where=alpha > 1e-6)
        want = {
            "RGB": color,
            "D": depth[..., None],
            "ED": mean[..., None],
            "RGB+D": np.dstack([color, depth]),
            "RGB+ED": np.dstack([color, mean]),
        }
        np.testing.assert_allclose(colors[i].detach(), want[mode], atol=1.7 / 255 * 3)
        assert (np.abs(colors[i].detach().numpy() - want[mode]) > 1e-4).mean() < 5e-3
        np.testing.assert_allclose(
            meta["means2d"][i].detach(), reference.project(*list(g.values())[:4], cam)[0], atol=1e-3
        )


@pytest.mark.parametrize("degree", [None, 0, 1, 2, 3])
@pytest.mark.long
def test_autograd_equals_central_differences(degree):
    cams, g = two_cameras(), gaussians(15, 3, 0.12)
    r = np.random.default_rng(0)
    if degree is not None:
        g["color"] = r.normal(0, 0.3, (15, (degree + 1) ** 2, 3)).astype(np.float32).astype(float)
    weights = r.normal(size=(2, 30, 40, 3))
    tensors, (colors, alphas, meta) = call(g, cams, grad=True, sh_degree=degree)
    ((colors * torch.tensor(weights, dtype=torch.float32)).sum() + (alphas**2).sum()).backward()
    assert meta["means2d"].grad.shape == (2, 15, 2) and meta["means2d"].grad.abs().max() > 0

    def objective(g, views):
        total = 0.0
        for i, cam in enumerate(cams):
            moved = object.__new__(type(cam))
            moved.__dict__.update(cam.__dict__ | {"world_to_camera": views[i]})
            R, t = views[i][:3, :3], views[i][:3, 3]
            color = (
                g["color"] if degree is None else reference.harmonics_color(g["color"], g["position"], -R.T @ t, degree)
            )
            image, alpha, _ = reference.render(g["position"], g["rotation"], g["scale"], g["opacity"], color, moved)
            total += (image * weights[i]).sum() + (alpha**2).sum()
        return total

    views = np.stack([c.world_to_camera for c in cams])

    def differences(key):
        value = views if key is None else g[key]
        picks = [tuple(r.integers(0, k) for k in ((2, 3, 4) if key is None else value.shape)) for _ in range(12)]
        want = []
        for pick in picks:
            ends = []
            for sign in (1, -1):
                moved = {k: v.copy() for k, v in g.items()}, views.copy()
                (moved[1] if key is None else moved[0][key])[pick] += sign * 1e-6
                ends.append(objective(*moved))
            want.append((ends[0] - ends[1]) / 2e-6)
        return picks, np.array(want)

    for name, key in zip((*NAMES, "viewmats"), (*g, None), strict=True):
        picks, want = found_once(("autograd", degree, name), lambda key=key: differences(key))
        got = [float(tensors[name].grad[pick]) for pick in picks]
        assert np.abs(want).max() > 0, name
        np.testing.assert_allclose(got, want, atol=3e-3 * np.abs(want).max(), err_msg=name)


@pytest.mark.parametrize("degree", [None, 2])
def test_a_world_far_from_zero_is_drawn_as_around_zero(degree):
    """UTM coordinates: nothing is lost where places come in float64."""
    cams, g = two_cameras(), gaussians(15, 3, 0.12)
    if degree is not None:
        g["color"] = np.random.default_rng(0).normal(0, 0.3, (15, 9, 3))
    drawn = []
    for shift in (np.zeros(3), np.array([5e5, 5e6, 100.0])):
        views = np.stack([c.world_to_camera for c in cams])
        views[:, :3, 3] -= views[:, :3, :3] @ shift
        double = {name: torch.tensor(value, dtype=torch.float64) for name, value in zip(NAMES, g.values(), strict=True)}
        double["means"] += torch.tensor(shift)
        double["viewmats"] = torch.tensor(views)
        for tensor in double.values():
            tensor.requires_grad_()
        Ks = torch.tensor(np.stack([c.K for c in cams]))
        colors, alphas, _ = rasterize(**double, Ks=Ks, width=40, height=30, sh_degree=degree)
        (colors.sum() + (alphas**2).sum()).backward()
        moves = double["viewmats"].grad[:, :3, 3]
        drawn.append([colors.detach(), double["means"].grad, double["quats"].grad, moves])
    for near, far in zip(*drawn, strict=True):
        assert (near - far).abs().max() < 2e-5 * near.abs().max()


@pytest.mark.long
def test_optimisation_with_torch_adam_recovers_a_picture():
    cams, g = two_cameras()[:1], gaussians(30, 5, 0.1)
    target = torch.tensor(reference.render(*g.values(), cams[0])[0], dtype=torch.float32)
    start = {k: v.copy() for k, v in g.items()}
    start["color"] *= 0.3
    start["position"] += 0.02
    tensors, _ = call(start, cams, grad=True)
    opt = torch.optim.Adam([tensors["means"], tensors["colors"]], lr=1e-2)
    Ks, losses = torch.tensor(cams[0].K[None], dtype=torch.float32), []
    for _ in range(40):
        image, _, _ = rasterize(**tensors, Ks=Ks, width=40, height=30)
        loss = ((image[0] - target) ** 2).mean()
        opt.zero_grad()
        loss.backward()
        opt.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.1 * losses[0]


def test_per_camera_colours_near_far_and_radius():
    cams, g = two_cameras(), gaussians(20, 2, 0.05)
    g["color"] = np.stack([g["color"], g["color"] * 0])
    _, (colors, _, meta) = call(g, cams)
    assert colors[0].max() > 0.01 and colors[1].abs().max() == 0
    g["color"] = g["color"][0]
    depth = np.sort(cams[0].to_camera(g["position"])[:, 2])
    _, (_, _, cut) = call(g, cams[:1], near_plane=float(depth[5] + 1e-4), far_plane=float(depth[12] - 1e-4))
    assert int((cut["radii"][0] > 0).sum()) == 6
    _, covariance, *_ = reference.project(*list(g.values())[:4], cams[0])
    radius = 3 * np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    np.testing.assert_array_equal(meta["radii"][0], np.ceil(radius))
    _, (_, _, clipped) = call(g, cams[:1], radius_clip=float(np.median(radius)))
    assert int((clipped["radii"][0] > 0).sum()) == 10


def test_float64_and_no_grad_inputs():
    cams, g = two_cameras()[:1], gaussians(10, 2, 0.05)
    t = {n: torch.tensor(v, dtype=torch.float64, requires_grad=True) for n, v in zip(NAMES, g.values(), strict=True)}
    views, Ks = torch.tensor(cams[0].world_to_camera[None]), torch.tensor(cams[0].K[None])
    rasterize(**t, viewmats=views, Ks=Ks, width=40, height=30)[0].sum().backward()
    assert t["means"].grad.dtype == torch.float64 and t["means"].grad.abs().max() > 0
    with torch.no_grad():
        image, _, _ = rasterize(**t, viewmats=views, Ks=Ks, width=40, height=30)
    assert not image.requires_grad


def test_errors_name_the_argument():
    cams, g = two_cameras()[:1], gaussians(6)
    with pytest.raises(DataFormatError, match="'quats'"):
        call(g | {"rotation": np.ones((6, 3))}, cams)
    with pytest.raises(DataFormatError, match="render_mode 'rgb'"):
        call(g, cams, render_mode="rgb")
    with pytest.raises(DataFormatError, match="sparse_grad"):
        call(g, cams, sparse_grad=True, packed=False)
    for degree, coefficients in ((2, 4), (4, 25), (-1, 4)):
        with pytest.raises(DataFormatError, match=f"'sh_degree' is {degree}"):
            call(g | {"color": np.ones((6, coefficients, 3))}, cams, sh_degree=degree)
    with pytest.raises(DataFormatError, match="'colors' has 9 channels"):
        call(g | {"color": np.ones((6, 9))}, cams)
    with pytest.raises(DataFormatError, match="'absgrad' with 9 channels"):
        call(g | {"color": np.ones((6, 8))}, cams, absgrad=True, render_mode="RGB+D")
    for name in ("near_plane", "eps2d"):
        with pytest.raises(DataFormatError, match=f"'{name}' is 0"):
            call(g, cams, **{name: 0})
    for alpha in (1.0, 0.0):
        with pytest.raises(DataFormatError, match="'max_alpha'"):
            call(g, cams, max_alpha=alpha)
    for parameter, argument in zip(g, NAMES, strict=True):
        bad = g[parameter].copy()
        bad[3] = np.inf
        with pytest.raises(NonFiniteError, match=rf"'{argument}' .* \[3\]") as caught:
            call(g | {parameter: bad}, cams)
        assert isinstance(caught.value, ValueError)
    _, (image, _, _) = call(g, cams, grad=True)
    image.sum().backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="twice"):
        image.sum().backward()


def with_covariances(g, grad=False):
    """The arguments of `rasterize` with covariances instead of rotation and scale, and these covariances."""
    axes = reference.rotation_matrix(g["rotation"]) * g["scale"][:, None, :]
    covariance = (axes @ axes.transpose(0, 2, 1)).astype(np.float32)
    values = {"means": g["position"], "covars": covariance, "opacities": g["opacity"], "colors": g["color"]}
    tensors = {n: torch.tensor(v, dtype=torch.float32, requires_grad=grad) for n, v in values.items()}
    return tensors | {"quats": None, "scales": None}, covariance.astype(float)


def of_camera(cam):
    return {
        "viewmats": torch.tensor(cam.world_to_camera[None]),
        "Ks": torch.tensor(cam.K[None]),
        "width": cam.width,
        "height": cam.height,
    }


@pytest.mark.parametrize("size, mode", [(0.08, "classic"), (1e-4, "antialiased"), (1e3, "classic")])
def test_covariances_draw_what_their_rotations_and_scales_do(size, mode):
    cam, g = camera(40, 30), gaussians(40, 1, size)
    tensors, _ = with_covariances(g)
    _, (want, _, meta) = call(g, [cam], rasterize_mode=mode)
    got, _, same = rasterize(**tensors, **of_camera(cam), rasterize_mode=mode)
    np.testing.assert_allclose(got, want, atol=2e-4)
    np.testing.assert_allclose(same["radii"], meta["radii"], atol=1)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_gradients_of_covariances_equal_central_differences(mode):
    cam, g = camera(24, 20), gaussians(12, 3, 0.12)
    tensors, covariance = with_covariances(g, grad=True)
    weights = np.random.default_rng(0).normal(size=(20, 24, 3))
    image, _, _ = rasterize(**tensors, **of_camera(cam), rasterize_mode=mode)
    (image[0] * torch.tensor(weights, dtype=torch.float32)).sum().backward()
    got = tensors["covars"].grad.numpy()
    assert not got[:, [1, 2, 2], [0, 0, 1]].any()  # the lower triangle is not read

    def cost(covariance):
        drawn = reference.render(*g.values(), cam, antialias=mode == "antialiased", covariance=covariance)
        return (drawn[0] * weights).sum()

    entries = [(k, i, j) for k in range(12) for i, j in zip(*np.triu_indices(3), strict=True)]

    def differences():
        want = []
        for k, i, j in entries:
            ends = []
            for sign in (1, -1):
                moved = covariance.copy()
                moved[k, i, j] += sign * 1e-8
                moved[k, j, i] = moved[k, i, j]
                ends.append(cost(moved))
            want.append((ends[0] - ends[1]) / 2e-8)
        return want

    want, have = found_once(("covariances", mode), differences), [got[entry] for entry in entries]
    assert np.abs(want).max() > 0
    np.testing.assert_allclose(have, want, atol=3e-3 * np.abs(want).max())


def test_covariances_stand_alone():
    cam, g = camera(), gaussians(4)
    tensors, _ = with_covariances(g)
    with pytest.raises(DataFormatError, match="'covars' stands instead"):
        rasterize(**tensors | {"quats": torch.ones(4, 4)}, **of_camera(cam))
    with pytest.raises(DataFormatError, match="'quats' has shape None"):
        rasterize(**tensors | {"covars": None}, **of_camera(cam))
    with pytest.raises(DataFormatError, match=r"'covars' has shape \(4, 6\)"):
        rasterize(**tensors | {"covars": torch.ones(4, 6)}, **of_camera(cam))
    with pytest.raises(NonFiniteError, match="'covars'"):
        rasterize(**tensors | {"covars": tensors["covars"] * np.nan}, **of_camera(cam))


def test_radii_are_whole_and_zero_outside_the_picture():
    cam, g = camera(40, 30), gaussians(30, 2, 0.02, spread=1.5)
    _, (_, _, meta) = call(g, [cam])
    mean, covariance, _, _, visible = reference.project(*list(g.values())[:4], cam)
    radius = 3 * np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    size = np.array([cam.width, cam.height])
    inside = visible & ((mean + radius[:, None] > 0) & (mean - radius[:, None] < size)).all(1)
    assert 0 < inside.sum() < 30 and meta["radii"].dtype == torch.int32
    np.testing.assert_array_equal(meta["radii"][0], np.where(inside, np.ceil(radius), 0))


def test_a_lower_degree_than_is_stored():
    cams, g = two_cameras(), gaussians(20, 3, 0.1)
    g["color"] = np.random.default_rng(0).normal(0, 0.3, (20, 16, 3)).astype(np.float32)
    tensors, (high, _, _) = call(g, cams, grad=True, sh_degree=1)
    high.sum().backward()
    _, (low, _, _) = call(g | {"color": g["color"][:, :4]}, cams, sh_degree=1)
    np.testing.assert_array_equal(high.detach(), low)
    grad = tensors["colors"].grad
    assert grad.shape == (20, 16, 3) and grad[:, :4].abs().max() > 0 and not grad[:, 4:].any()


@pytest.mark.parametrize("mode", ["RGB", "RGB+D"])
def test_absolute_gradients_of_the_2d_means(mode):
    """Sum over pixels of |dL/d(mean)|, which densification by AbsGS reads; no cancellation between two sides."""
    cams, g = two_cameras(), gaussians(8, 3, 0.1)
    weights = np.random.default_rng(0).normal(size=(2, 30, 40, 4 if mode == "RGB+D" else 3))
    _, (image, _, meta) = call(g, cams, grad=True, absgrad=True, render_mode=mode)
    (image * torch.tensor(weights, dtype=torch.float32)).sum().backward()
    got = meta["means2d"].absgrad.numpy()
    assert (got >= meta["means2d"].grad.abs().numpy() * (1 - 1e-4)).all()

    def differences():
        want = np.zeros((2, 8, 2))
        for c, i, axis in np.ndindex(want.shape):
            ends = []
            for sign in (1, -1):
                shift = np.zeros((8, 2))
                shift[i, axis] = sign * 1e-5
                color, _, depth = reference.render(*g.values(), cams[c], shift=shift)
                ends.append((np.dstack([color, depth])[..., : weights.shape[-1]] * weights[c]).sum(-1))
            per_pixel = np.abs(ends[0] - ends[1]) / 2e-5
            want[c, i, axis] = per_pixel[per_pixel < 50].sum()  # a pixel that crosses 1/255 jumps
        return want

    want = found_once(("absolute", mode), differences)
    assert (np.abs(got - want) <= np.maximum(5e-3 * want, 1e-3)).all(), (got, want)


def test_gsplats_clamp_is_selectable():
    cam, g = camera(24, 20), gaussians(12, 3, 0.2)
    g["opacity"] = np.where(np.arange(12) % 2 == 0, 1.0, 0.7)
    pictures = {}
    for clamp in (0.99, 0.999):
        _, (image, alpha, _) = call(g, [cam], max_alpha=clamp)
        want = reference.render(*g.values(), cam, max_alpha=clamp)
        np.testing.assert_allclose(image[0], want[0], atol=5e-5)
        np.testing.assert_allclose(alpha[0, ..., 0], want[1], atol=5e-5)
        pictures[clamp] = image
    assert (pictures[0.99] - pictures[0.999]).abs().max() > 1e-3
    weights = np.random.default_rng(0).normal(size=(20, 24, 3))
    tensors, (image, _, _) = call(g, [cam], grad=True, max_alpha=0.999)
    (image[0] * torch.tensor(weights, dtype=torch.float32)).sum().backward()
    want = []
    for i in range(12):
        ends = []
        for sign in (1, -1):
            opacity = g["opacity"].copy()
            opacity[i] += sign * 1e-7
            ends.append(
                (reference.render(*(g | {"opacity": opacity}).values(), cam, max_alpha=0.999)[0] * weights).sum()
            )
        want.append((ends[0] - ends[1]) / 2e-7)
    np.testing.assert_allclose(tensors["opacities"].grad, want, atol=5e-3 * np.abs(want).max())


DEPTHS = {"RGB": 0, "D": 1, "ED": 1, "RGB+D": 1, "RGB+ED": 1}


@pytest.mark.parametrize("absgrad", [False, True])
@pytest.mark.parametrize("degree", [None, 2])
@pytest.mark.parametrize("mode", list(DEPTHS))
def test_no_gaussian_draws_the_background(mode, degree, absgrad):
    """By the image formation: alpha 0, so the background is all that is seen, and no depth."""
    cams, g = two_cameras(), gaussians(0)
    if degree is not None:
        g["color"] = np.zeros((0, 9, 3))
    background = torch.tensor([[0.1, 0.2, 0.3], [0.9, 0.5, 0.0]], requires_grad=True)
    tensors, (colors, alphas, meta) = call(
        g, cams, grad=True, render_mode=mode, backgrounds=background, sh_degree=degree, absgrad=absgrad
    )
    want = background.detach()[:, None, None, :].expand(2, 30, 40, 3)
    if mode in ("D", "ED"):
        want = want[..., :0]
    want = torch.cat([want, *[torch.zeros(2, 30, 40, 1)] * DEPTHS[mode]], -1)
    assert torch.equal(colors.detach(), want) and torch.equal(alphas.detach(), torch.zeros(2, 30, 40, 1))
    assert meta["means2d"].shape == (2, 0, 2) and meta["radii"].shape == (2, 0) and meta["n_cameras"] == 2
    (colors.sum() + alphas.sum()).backward()
    for name, tensor in tensors.items():
        assert tensor.grad.shape == tensor.shape and not tensor.grad.any(), name
    assert meta["means2d"].grad.shape == (2, 0, 2)
    if "RGB" in mode:
        assert torch.equal(background.grad, torch.full((2, 3), 30 * 40.0))


def test_no_gaussian_in_other_forms():
    cams = two_cameras()
    tensors, _ = with_covariances(gaussians(0), grad=True)
    image, _, _ = rasterize(**tensors, **of_camera(cams[0]))
    image.sum().backward()
    assert image.shape == (1, 30, 40, 3) and tensors["covars"].grad.shape == (0, 3, 3)
    _, (image, _, _) = call(gaussians(0) | {"color": np.zeros((2, 0, 4))}, cams)  # colours per camera
    assert not image.any() and image.shape == (2, 30, 40, 4) and not image.requires_grad
    probe = torch.zeros(2, 0, 2, requires_grad=True)
    _, (image, _, _) = call(gaussians(0), cams, means2d=probe)
    image.sum().backward()
    assert probe.grad.shape == (2, 0, 2)


def test_all_culled_is_as_none():
    _, (none, _, _) = call(gaussians(0), two_cameras())
    tensors, (image, alphas, meta) = call(gaussians(9), two_cameras(), grad=True, far_plane=0.1)
    assert torch.equal(image.detach(), none) and not alphas.any() and not meta["radii"].any()
    image.sum().backward()
    assert all(tensor.grad is not None and not tensor.grad.any() for tensor in tensors.values())


def test_one_gaussian_and_no_camera():
    cams, g = two_cameras(), gaussians(1, 2, 0.2)
    tensors, (colors, _, _) = call(g, cams, grad=True)
    for have, cam in zip(colors, cams, strict=True):
        np.testing.assert_allclose(have.detach(), reference.render(*g.values(), cam)[0], atol=2e-3)
    colors.sum().backward()
    assert tensors["means"].grad.shape == (1, 3) and tensors["colors"].grad.abs().sum() > 0
    t = {n: torch.tensor(v, dtype=torch.float32, requires_grad=True) for n, v in zip(NAMES, g.values(), strict=True)}
    views, Ks = torch.zeros(0, 4, 4), torch.zeros(0, 3, 3)
    colors, alphas, meta = rasterize(**t, viewmats=views, Ks=Ks, width=40, height=30, render_mode="RGB+D")
    assert colors.shape == (0, 30, 40, 4) and alphas.shape == (0, 30, 40, 1) and meta["radii"].shape == (0, 1)
    colors.sum().backward()
    assert not t["means"].grad.any()


@pytest.mark.parametrize("mode", ["D", "ED"])
@pytest.mark.parametrize("count", [30, 0])
def test_depth_needs_no_colours(mode, count):
    g, cams = gaussians(count, 1, 0.1), two_cameras()
    tensors, (want, _, _) = call(g, cams, render_mode=mode)
    tensors["colors"] = None
    Ks, size = torch.tensor(np.stack([c.K for c in cams]), dtype=torch.float32), {"width": 40, "height": 30}
    have, _, _ = rasterize(**tensors, Ks=Ks, **size, render_mode=mode, backgrounds=torch.ones(2, 3), sh_degree=3)
    assert torch.equal(have, want)
    with pytest.raises(DataFormatError, match="'colors' is None"):
        rasterize(**tensors, Ks=Ks, **size, render_mode="RGB+D")


def test_sizes_are_whole_numbers_of_any_type():
    g, cam = gaussians(10, 1, 0.1), two_cameras()[0]
    tensors, (want, _, _) = call(g, [cam])
    Ks = torch.tensor(cam.K[None], dtype=torch.float32)
    for width, height in ((torch.tensor(40), torch.tensor([30])), (np.int64(40), np.array(30))):
        have, _, meta = rasterize(**tensors, Ks=Ks, width=width, height=height)
        assert torch.equal(have, want) and type(meta["width"]) is int
    for width, said in ((0, "'width' is 0"), (-3, "'width' is -3"), (40.0, "'width' is 40.0"), (None, "'width'")):
        with pytest.raises(DataFormatError, match=said):
            rasterize(**tensors, Ks=Ks, width=width, height=30)


def test_an_entry_that_is_not_there_is_named():
    _, (_, _, meta) = call(gaussians(3), two_cameras())
    with pytest.raises(DataFormatError, match=r"info\['depths'\].*'means2d'"):
        meta["depths"]
    assert meta.get("depths") is None and "depths" not in meta
