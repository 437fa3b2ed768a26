"""Stand-ins for compiled modules, argument by argument against the renderer's float64 twin."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gof.core.errors import DataFormatError, MissingDependencyError
from gof.render import reference
from tests.render.scenes import camera, gaussians

torch = pytest.importorskip("torch")
pytest.importorskip("drjit")

from gof.on_cpu import gaussian_rasterizer as inria  # noqa: E402
from gof.on_cpu import small_modules  # noqa: E402
from gof.on_cpu.export import as_drawn  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")
NEAR, FAR = 0.2, 100.0


def clip_matrix(cam) -> np.ndarray:
    """Camera to clip space as an OpenGL-like frustum through the picture's edges, w = z (written for this test)."""
    K, (W, H) = cam.K, (cam.width, cam.height)
    left, right = -K[0, 2] / K[0, 0], (W - K[0, 2]) / K[0, 0]
    top, bottom = -K[1, 2] / K[1, 1], (H - K[1, 2]) / K[1, 1]
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2 / (right - left), -(right + left) / (right - left)
    P[1, 1], P[1, 2] = 2 / (bottom - top), -(bottom + top) / (bottom - top)
    P[2, 2], P[2, 3], P[3, 2] = FAR / (FAR - 0.01), -FAR * 0.01 / (FAR - 0.01), 1
    return P


def settings(cam, kind=inria.GaussianRasterizationSettings, **changed):
    view = torch.tensor(cam.world_to_camera, dtype=torch.float32)
    values = {
        "image_height": cam.height,
        "image_width": cam.width,
        "tanfovx": cam.width / (2 * cam.K[0, 0]),
        "tanfovy": cam.height / (2 * cam.K[1, 1]),
        "bg": torch.zeros(3),
        "scale_modifier": 1.0,
        "viewmatrix": view.T,
        "projmatrix": torch.tensor((clip_matrix(cam) @ cam.world_to_camera).T, dtype=torch.float32),
        "sh_degree": 0,
        "campos": torch.tensor(cam.position, dtype=torch.float32),
        "prefiltered": False,
        "debug": False,
    }
    return kind(**values | changed)


def arguments(g, grad=False, **changed):
    """The rasteriser's, of Gaussians; quaternions of any length are made unit ones."""
    rotation = g["rotation"] / np.linalg.norm(g["rotation"], axis=1, keepdims=True)
    values = {
        "means3D": g["position"],
        "opacities": g["opacity"][:, None],
        "colors_precomp": g["color"],
        "scales": g["scale"],
        "rotations": rotation,
    } | changed
    tensors = {
        name: None if v is None else torch.tensor(v, dtype=torch.float32, requires_grad=grad)
        for name, v in values.items()
    }
    means2d = torch.zeros(len(g["position"]), 3, requires_grad=grad) + 0  # as its callers make it: not a leaf
    if grad:
        means2d.retain_grad()
    return tensors | {"means2D": means2d}


def close(have, want):
    """Up to pixels at the edge of a Gaussian that is just seen or just not."""
    have, want = np.asarray(have.detach()), np.asarray(want)
    np.testing.assert_allclose(have, want, atol=5 / 255)
    assert (np.abs(have - want) > 2e-4).mean() < 5e-3


def covariance_of(scale, quaternion):
    """R S S^T R^T with R of the quaternion as it is; written out for one that is not of unit length."""
    w, x, y, z = quaternion.T
    R = np.empty((len(w), 3, 3))
    R[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1)
    R[:, 1] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1)
    R[:, 2] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1)
    M = R * scale[:, None, :]
    return M @ M.transpose(0, 2, 1)


def test_picture_depth_radii_background_and_near_plane():
    cam, g = camera(40, 30), gaussians(80, 1, 0.08)
    g["position"][:5] = cam.position + 0.15 * cam.world_to_camera[2, :3]  # nearer than 0.2
    background = np.array([0.1, 0.2, 0.3])
    draw = inria.module("depth").GaussianRasterizer(settings(cam, bg=torch.tensor(background, dtype=torch.float32)))
    color, radii, depth = draw(**arguments(g))
    want, _, z = reference.render(*g.values(), cam, background, near=NEAR)
    close(color.permute(1, 2, 0), want)
    close(depth[0], z)
    assert depth.shape == (1, 30, 40) and radii.dtype == torch.int32 and not radii[:5].any() and radii.any()
    plain = inria.module("plain").GaussianRasterizer(draw.raster_settings)(**arguments(g))
    assert len(plain) == 2 and torch.equal(plain[0], color)
    assert not draw.markVisible(torch.tensor(g["position"][:5], dtype=torch.float32)).any()


def test_scale_modifier_and_precomputed_covariance():
    cam, g = camera(40, 30), gaussians(30, 2, 0.05)
    draw = inria.module("plain").GaussianRasterizer(settings(cam, scale_modifier=1.7))
    want, _, _ = reference.render(*(g | {"scale": 1.7 * g["scale"]}).values(), cam, near=NEAR)
    close(draw(**arguments(g))[0].permute(1, 2, 0), want)
    axes = reference.rotation_matrix(g["rotation"]) * 1.7 * g["scale"][:, None]
    sigma = axes @ axes.transpose(0, 2, 1)
    six = sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    given = arguments(g, cov3D_precomp=six, scales=None, rotations=None)
    close(draw(**given)[0].permute(1, 2, 0), want)


def test_quaternions_are_not_normalised():
    cam, g = camera(40, 30), gaussians(30, 3, 0.05)
    g["rotation"] *= 0.9 / np.linalg.norm(g["rotation"], axis=1, keepdims=True)
    sigma = covariance_of(g["scale"], g["rotation"])
    want, _, _ = reference.render(*g.values(), cam, near=NEAR, covariance=sigma)
    drawn = inria.module("plain").GaussianRasterizer(settings(cam))(**arguments(g, rotations=g["rotation"]))[0]
    close(drawn.permute(1, 2, 0), want)
    unit, _, _ = reference.render(*g.values(), cam, near=NEAR)
    assert np.abs(unit - want).max() > 0.05, "the two are told apart"


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_of_a_lower_degree_than_stored(degree):
    cam, g = camera(40, 30), gaussians(40, 4, 0.08)
    shs = np.random.default_rng(0).normal(0, 0.4, (40, 16, 3)).astype(np.float32)
    drawn = inria.module("plain").GaussianRasterizer(settings(cam, sh_degree=degree))
    image = drawn(**arguments(g, shs=shs, colors_precomp=None))[0]
    color = reference.harmonics_color(shs, g["position"], cam.position, degree)
    want, _, _ = reference.render(*(g | {"color": color}).values(), cam, near=NEAR)
    close(image.permute(1, 2, 0), want)


def test_gradients_equal_central_differences():
    """Of every argument, and of the 2D means per half picture."""
    cam, g = camera(24, 20), gaussians(8, 5, 0.12)
    g["opacity"] = 0.1 + 0.5 * g["opacity"]
    g["rotation"] *= 0.8 / np.linalg.norm(g["rotation"], axis=1, keepdims=True)
    weights = np.random.default_rng(0).normal(size=(20, 24, 3))
    tensors = arguments(g, grad=True, rotations=g["rotation"])
    image = inria.module("depth").GaussianRasterizer(settings(cam))(**tensors)[0]
    (image.permute(1, 2, 0) * torch.tensor(weights, dtype=torch.float32)).sum().backward()

    def cost(shift=0.0, **changed):
        now = g | changed
        sigma = covariance_of(now["scale"], now["rotation"])
        drawn = reference.render(*now.values(), cam, near=NEAR, covariance=sigma, shift=shift)
        return (drawn[0] * weights).sum()

    def differences(values, cost_of, step=1e-6):
        out = np.empty(values.shape)
        for index in np.ndindex(*values.shape):
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[index] += sign * step
                ends.append(cost_of(moved))
            out[index] = (ends[0] - ends[1]) / (2 * step)
        return out

    names = {"means3D": "position", "scales": "scale", "rotations": "rotation", "colors_precomp": "color"}
    for argument, name in (names | {"opacities": "opacity"}).items():
        want = differences(g[name], lambda v, name=name: cost(**{name: v}))
        have = tensors[argument].grad.numpy().reshape(want.shape)
        assert np.abs(want).max() > 0
        np.testing.assert_allclose(have, want, atol=5e-3 * np.abs(want).max(), err_msg=argument)
    want = differences(np.zeros((8, 2)), lambda v: cost(shift=v)) * [12, 10]  # px in half a picture
    have = tensors["means2D"].grad.numpy()
    np.testing.assert_allclose(have[:, :2], want, atol=5e-3 * np.abs(want).max())
    assert not have[:, 2].any()


def test_absolute_gradients_go_to_a_tensor_of_their_own():
    """Sums over pixels of absolute gradients, by drawing each pixel's part alone; the other tensor gets the sum."""
    g, cam = gaussians(4, seed=8), camera(12, 9)
    weight = np.random.default_rng(2).normal(size=(3, 9, 12)).astype(np.float32)

    def told(mask, densify):
        tensors = arguments(g, grad=True)
        if densify:
            tensors["means2D_densify"] = torch.zeros(4, 3, requires_grad=True) + 0
            tensors["means2D_densify"].retain_grad()
        color, _, _ = inria.module("depth").GaussianRasterizer(settings(cam))(**tensors)
        (color * torch.tensor(weight * mask)).sum().backward()
        return [tensors[name].grad.numpy() for name in ("means2D", "means2D_densify") if name in tensors]

    plain, absolute = told(np.ones((9, 12), np.float32), densify=True)
    pixels = np.eye(9 * 12, dtype=np.float32).reshape(-1, 9, 12)
    alone = np.stack([told(pixel, densify=False)[0] for pixel in pixels])
    assert np.abs(alone).max() > 0
    np.testing.assert_allclose(absolute, np.abs(alone).sum(0), rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(plain, alone.sum(0), rtol=1e-3, atol=1e-4)


def test_exchanged_fields_of_view_are_named():
    """As D-NeRF readers of Grid4D and Deformable-3DGS have them: the angle across given as the one down."""
    cam, focal = camera(40, 30), 50.0
    swapped = np.array([[focal * 40 / 30, 0, 20], [0, focal * 30 / 40, 15], [0, 0, 1]])
    wrong = replace(cam, K=swapped)
    with pytest.raises(DataFormatError, match="exchanged.*40x30.*'nerfds'"):
        inria.module("depth").GaussianRasterizer(settings(wrong))(**arguments(gaussians(3)))


def test_what_contradicts_itself_is_refused():
    cam, g = camera(40, 30), gaussians(4)
    with pytest.raises(TypeError, match="antialiasing"):
        settings(cam, antialiasing=True)
    draw = inria.module("plain").GaussianRasterizer(settings(cam))
    with pytest.raises(TypeError, match="theta"):
        draw(**arguments(g), theta=None)
    with pytest.raises(DataFormatError, match="either 'shs' or 'colors_precomp'"):
        draw(**arguments(g, colors_precomp=None))
    with pytest.raises(DataFormatError, match="either 'scales' and 'rotations', or 'cov3D_precomp'"):
        draw(**arguments(g, scales=None))
    for changed, said in ({"tanfovx": 0.3}, "focal lengths"), ({"campos": torch.ones(3)}, "'campos'"):
        with pytest.raises(DataFormatError, match=said):
            inria.module("plain").GaussianRasterizer(settings(cam, **changed))(**arguments(g))


def spacetime(cam, **changed):
    own = {"sh_degree_t": 0, "timestamp": 0.5, "time_duration": 1.0, "rot_4d": True, "gaussian_dim": 4}
    return settings(cam, inria.SpacetimeSettings, **own, force_sh_3d=False, **changed)


def test_the_variant_with_time():
    cam, g = camera(40, 30), gaussians(60, 6, 0.08)
    axes = reference.rotation_matrix(g["rotation"]) * g["scale"][:, None]
    six = (axes @ axes.transpose(0, 2, 1))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    flow = np.random.default_rng(0).normal(size=(60, 2))
    draw = inria.module("spacetime").GaussianRasterizer(spacetime(cam))
    given = arguments(g, cov3D_precomp=six, scales=None, rotations=None)
    color, radii, depth, alpha, moved, back = draw(**given, flow_2d=torch.tensor(flow, dtype=torch.float32))
    want, opaque, z = reference.render(*g.values(), cam, near=NEAR)
    close(color.permute(1, 2, 0), want)
    close(alpha[0], opaque)
    close(depth[0], z)
    close(moved.permute(1, 2, 0), reference.render(*(g | {"color": flow}).values(), cam, near=NEAR)[0])
    assert radii.shape == (60,)
    np.testing.assert_allclose(back, six, rtol=1e-5)
    assert not draw(**given, flow_2d=torch.zeros(60, 2))[4].any()
    with pytest.raises(DataFormatError, match="only those of rot_4d=True"):
        draw(**arguments(g))


def in_four_dimensions(n, seed=0):
    """Raw Gaussians of 4DGS (Yang) and what the importer, which was checked against its CUDA code, makes of them."""
    from gof.io.importers import yang

    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(2, n, 4))
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    raw = {
        "ts": rng.uniform(0, 1, (n, 1)),
        "scales": np.exp(rng.normal(np.log(0.08), 0.3, (n, 3))),
        "scales_t": rng.uniform(0.1, 0.3, (n, 1)),
        "rotations": unit[0],
        "rotations_r": unit[1],
    }
    scale = np.concatenate([raw["scales"], raw["scales_t"]], 1)
    return raw, *yang.condition_on_time(yang.covariance_4d(scale, unit[0], unit[1]))


@pytest.mark.parametrize("prefilter", [-1.0, 0.02])
def test_gaussians_in_four_dimensions_are_conditioned_on_the_time(prefilter):
    cam, g = camera(40, 30), gaussians(60, 6, 0.08)
    raw, velocity, sigma, variance = in_four_dimensions(60)
    shs = np.random.default_rng(1).normal(0, 0.3, (60, 48, 3))
    own = spacetime(cam, sh_degree=3)._replace(sh_degree_t=2)
    given = arguments(g, grad=True, colors_precomp=None, shs=shs, **raw)
    color, radii, depth, alpha, _, six = inria.module("spacetime").GaussianRasterizer(own)(
        **given, prefilter_var=prefilter
    )
    delay = 0.5 - raw["ts"][:, 0]
    window = np.exp(-0.5 * delay**2 / (variance + max(prefilter, 0)))
    lives = window > 0.05
    assert 5 < lives.sum() < 60
    mean = g["position"] + velocity * delay[:, None]
    swing = sum(np.cos(2 * np.pi * k * delay)[:, None, None] * shs[:, 16 * k : 16 * k + 16] for k in range(3))
    shown = {
        "position": mean[lives],
        "rotation": g["rotation"][lives],
        "scale": g["scale"][lives],
        "opacity": (g["opacity"] * window)[lives],
        "color": reference.harmonics_color(swing, mean, cam.position, 3)[lives],
    }
    want, opaque, z = reference.render(*shown.values(), cam, near=NEAR, covariance=sigma[lives])
    close(color.permute(1, 2, 0), want)
    close(alpha[0], opaque)
    close(depth[0], z)
    upper = sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] * lives[:, None]
    np.testing.assert_allclose(six.detach(), upper, atol=1e-6)
    assert radii.shape == (60,) and not radii[~lives].any() and radii[lives].any()
    color.sum().backward()
    for name in ("means3D", "means2D", "ts", "scales", "scales_t", "rotations", "rotations_r", "shs", "opacities"):
        gradient = given[name].grad
        assert gradient[lives].abs().max() > 0 and not gradient[~lives].any(), name
    with pytest.raises(DataFormatError, match="need sh_degree 3"):
        inria.module("spacetime").GaussianRasterizer(own._replace(sh_degree=2))(**given)


def test_gradients_through_the_time_equal_central_differences():
    cam, g = camera(24, 20), gaussians(6, 5, 0.12)
    g["opacity"] = 0.1 + 0.5 * g["opacity"]
    raw, *_ = in_four_dimensions(6, seed=3)
    raw["scales_t"][:] = 0.4  # all live, also where a difference is taken
    weights = np.random.default_rng(0).normal(size=(20, 24, 3))
    given = arguments(g, grad=True, **raw)
    image = inria.module("spacetime").GaussianRasterizer(spacetime(cam))(**given)[0]
    (image.permute(1, 2, 0) * torch.tensor(weights, dtype=torch.float32)).sum().backward()

    def cost(name, values):
        from gof.io.importers import yang

        now = raw | {name: values}
        scale = np.concatenate([now["scales"], now["scales_t"]], 1)
        covariance = yang.covariance_4d(scale, now["rotations"], now["rotations_r"])
        velocity, sigma, variance = yang.condition_on_time(covariance)
        delay = 0.5 - now["ts"]
        window = np.exp(-0.5 * delay[:, 0] ** 2 / variance)
        shown = g | {"position": g["position"] + velocity * delay, "opacity": g["opacity"] * window}
        return (reference.render(*shown.values(), cam, near=NEAR, covariance=sigma)[0] * weights).sum()

    for name in raw:
        want = np.empty(raw[name].shape)
        for index in np.ndindex(*want.shape):
            step = np.zeros(want.shape)
            step[index] = 1e-6
            want[index] = (cost(name, raw[name] + step) - cost(name, raw[name] - step)) / 2e-6
        have = given[name].grad.numpy()
        if name.startswith("rotations"):  # the twin's are unit ones: along themselves they do not count
            have = have - (have * raw[name]).sum(1, keepdims=True) * raw[name]
        assert np.abs(want).max() > 0
        np.testing.assert_allclose(have, want, atol=5e-3 * np.abs(want).max(), err_msg=name)


def test_distances_to_three_neighbours():
    points = np.random.default_rng(0).normal(size=(50, 3))
    square = ((points[:, None] - points[None]) ** 2).sum(-1)
    want = np.sort(square, 1)[:, 1:4].mean(1)
    have = small_modules.simple_knn().distCUDA2(torch.tensor(points, dtype=torch.float32))
    np.testing.assert_allclose(have, want, rtol=1e-5)
    assert small_modules.mean_squared_distance(torch.zeros(1, 3)).tolist() == [0.0]


def test_ssim_and_its_edge():
    rng = np.random.default_rng(0)
    a, b = rng.random((30, 24, 3)), rng.random((30, 24, 3))
    first, second = (torch.tensor(v.transpose(2, 0, 1)[None], dtype=torch.float64) for v in (a, b))
    want = 1 - reference.l1_ssim(a, b, ssim_weight=1)
    assert float(small_modules.fused_ssim().fused_ssim(first, second)) == pytest.approx(want, abs=1e-9)
    # Five pixels at the edge see zeros from outside; without them, another program's mean over whole windows.
    other = pytest.importorskip("pytorch_msssim").ssim(first, second, data_range=1.0, win_size=11, win_sigma=1.5)
    assert float(small_modules.mean_ssim(first, second, padding="valid")) == pytest.approx(float(other), abs=1e-6)
    with pytest.raises(ValueError, match="padding"):
        small_modules.mean_ssim(first, second, padding="reflect")


def test_the_pixel_grid():
    grid = small_modules.kornia().create_meshgrid(2, 3, normalized_coordinates=False)
    assert grid.shape == (1, 2, 3, 2) and grid[0, 1, 2].tolist() == [2.0, 1.0]


def test_ellipsoids_of_quaternions_of_any_length_are_those_that_are_drawn():
    """A quaternion of another length is no rotation: scales and unit quaternions give the same covariance again."""
    rng = np.random.default_rng(6)
    scale = rng.uniform(0.01, 0.1, (50, 3)) * rng.choice([-1, 1], (50, 3))  # a network may turn the sign
    quaternion = rng.normal(size=(50, 4))
    quaternion *= rng.uniform(0.7, 1.4, (50, 1)) / np.linalg.norm(quaternion, axis=1, keepdims=True)
    scale[0] = 0.02  # a ball
    w, x, y, z = quaternion.T
    turned = np.array(  # the matrix that rasterisers form of a quaternion, whatever its length
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    want = np.einsum("nij,nj,nkj->nik", turned, scale**2, turned)
    found, unit = as_drawn(torch.tensor(scale), torch.tensor(quaternion))
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1, atol=1e-12)
    axes = Rotation.from_quat(unit[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(np.einsum("nij,nj,nkj->nik", axes, found**2, axes), want, atol=1e-12)
    proper = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    found, unit = as_drawn(torch.tensor(np.abs(scale)), torch.tensor(proper))
    np.testing.assert_allclose(found, np.abs(scale), atol=1e-9)  # in the order that they were given in
    np.testing.assert_allclose(np.abs((unit[1:] * proper[1:]).sum(1)), 1, atol=1e-9)


def test_settings_in_python_stand_over_their_base(tmp_path):
    """As mmengine merges them: name by name within dictionaries, wholly where one says so."""
    (tmp_path / "base.py").write_text("import os\nA = dict(x=1, y=dict(z=2, w=3))\nB = dict(p=1)\nC = [1, 2]\n")
    (tmp_path / "mine.py").write_text(
        "_base_ = './base.py'\nA = dict(y=dict(z=5))\nB = dict(_delete_=True, q=2)\nC = [3]\nD = len(C)\n"
    )
    read = small_modules.mmcv().Config.fromfile(str(tmp_path / "mine.py"))
    assert read == {"A": {"x": 1, "y": {"z": 5, "w": 3}}, "B": {"q": 2}, "C": [3], "D": 1}
    (tmp_path / "mine.py").write_text("_base_ = ['base.py']\n")
    assert small_modules.mmcv().Config.fromfile(tmp_path / "mine.py")["A"]["y"] == {"z": 2, "w": 3}


def test_a_module_that_is_not_used_may_be_imported_and_no_more():
    unused = small_modules.Unused("open3d")
    assert unused.geometry.PointCloud is not None
    with pytest.raises(MissingDependencyError, match=r"open3d\.io\.read_point_cloud"):
        unused.io.read_point_cloud("file.ply")


def test_lpips_left_out_is_no_number_and_no_loss():
    metric = small_modules.NoPerceptualLoss(net_type="alex")
    image = torch.zeros(1, 3, 8, 8)
    assert torch.isnan(metric(image, image))
    with pytest.raises(MissingDependencyError, match="without-lpips"):
        metric(image.requires_grad_(), image)
