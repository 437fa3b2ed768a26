"""`rasterize`: gsplat's shapes and conventions, against the float64 twin; its autograd, against differences."""

import numpy as np
import pytest

from gof.errors import DataFormatError, NonFiniteError
from tests.render.scenes import camera, gaussians

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
    for name, key in zip((*NAMES, "viewmats"), (*g, None), strict=True):
        value = views if key is None else g[key]
        want, got = [], []
        for _ in range(12):
            pick = tuple(r.integers(0, k) for k in ((2, 3, 4) if key is None else value.shape))
            ends = []
            for sign in (1, -1):
                moved = {k: v.copy() for k, v in g.items()}, views.copy()
                (moved[1] if key is None else moved[0][key])[pick] += sign * 1e-6
                ends.append(objective(*moved))
            want.append((ends[0] - ends[1]) / 2e-6)
            got.append(float(tensors[name].grad[pick]))
        want = np.array(want)
        assert np.abs(want).max() > 0, name
        np.testing.assert_allclose(got, want, atol=3e-3 * np.abs(want).max(), err_msg=name)


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
    _, (_, _, clipped) = call(g, cams[:1], radius_clip=float(meta["radii"][0].median()) + 1e-4)
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
    with pytest.raises(DataFormatError, match="absgrad"):
        call(g, cams, absgrad=True, packed=False)
    with pytest.raises(DataFormatError, match="sh_degree 2"):
        call(g | {"color": np.ones((6, 4, 3))}, cams, sh_degree=2)
    bad = g["opacity"].copy()
    bad[3] = np.inf
    with pytest.raises(NonFiniteError, match=r"'opacity' .* \[3\]"):
        call(g | {"opacity": bad}, cams)
    _, (image, _, _) = call(g, cams, grad=True)
    image.sum().backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="twice"):
        image.sum().backward()
