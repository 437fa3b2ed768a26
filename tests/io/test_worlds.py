"""Results in worlds of their own: normalisations, similarities by cameras, float32 far from zero."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch")

from gof.core.colmap import read_colmap  # noqa: E402
from gof.core.errors import DataFormatError, GofError  # noqa: E402
from gof.core.ftgs import save as save_ftgs  # noqa: E402
from gof.io.importers import ImportOptions, read_result  # noqa: E402
from gof.io.importers.alignment import align_cameras, read_cameras, require_same_world  # noqa: E402
from gof.io.importers.normalisation import freetime_normalisation, gsplat_normalisation  # noqa: E402
from tests.conftest import arc, random_gaussians  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.motions import moved_camera, similarity, trained  # noqa: E402


@pytest.fixture(scope="module")
def colmap_scene():
    rng = np.random.default_rng(5)
    poses = {f"cam{i}.png": c.world_to_camera for i, c in enumerate(arc(5, radius=4.0, target=(2.0, -1.0, 3.0)))}
    return poses, rng.normal(size=(400, 3)) * [3, 1, 0.4] @ Rotation.from_euler(
        "xyz", [20, 50, 10], degrees=True
    ).as_matrix() + [2, -1, 3]


@pytest.mark.parametrize("write", [lookalikes.colmap_binary, lookalikes.colmap_text])
def test_colmap_models_are_read(tmp_path, colmap_scene, write):
    poses, points = colmap_scene
    write(tmp_path / "sparse/0", poses, points)
    got, cloud = read_colmap(tmp_path)
    assert set(got) == set(poses)
    for name in poses:
        np.testing.assert_allclose(got[name], poses[name], atol=1e-12)
    np.testing.assert_allclose(cloud, points, atol=1e-12)


def test_cut_off_colmap_model(tmp_path, colmap_scene):
    lookalikes.colmap_binary(tmp_path, *colmap_scene)
    data = (tmp_path / "images.bin").read_bytes()
    (tmp_path / "images.bin").write_bytes(data[:200])
    with pytest.raises(DataFormatError, match="cut off"):
        read_colmap(tmp_path)
    with pytest.raises(DataFormatError, match="no COLMAP"):
        read_colmap(tmp_path / "nothing")


def test_gsplats_normalisation_has_the_properties_it_promises(colmap_scene):
    poses, points = colmap_scene
    T = gsplat_normalisation(poses, points)
    s = np.cbrt(np.linalg.det(T[:3, :3]))
    moved = points @ T[:3, :3].T + T[:3, 3]
    # up to -y; then the middle of where the optical axes pass the origin, and the median distance from it as the unit
    camera = np.stack([np.linalg.inv(p) for p in poses.values()])
    up = -camera[:, :3, 1].mean(0)
    axis = np.cross(up, [0, -1, 0])
    angle = np.arccos(-up[1] / np.linalg.norm(up))
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    centre, forward = camera[:, :3, 3], camera[:, :3, 2]
    along = [
        minimize_scalar(lambda x, c=c, f=f: np.sum((c + x * f) ** 2)).x for c, f in zip(centre, forward, strict=True)
    ]
    focus = np.median((centre + np.array(along)[:, None] * forward) @ turn.T, 0)
    unit = np.median(np.linalg.norm(centre @ turn.T - focus, axis=1))
    assert s == pytest.approx(1 / unit, rel=1e-6)
    middle = np.median(points @ turn.T, 0) @ turn  # the median of every coordinate, there; it becomes the origin
    np.testing.assert_allclose(T[:3, :3] @ middle + T[:3, 3], 0, atol=1e-9)
    covariance = np.cov(moved, rowvar=False)
    np.testing.assert_allclose(covariance, np.diag(np.diag(covariance)), atol=1e-10)
    assert (np.diff(np.diag(covariance)) < 0).all() and s > 0
    # another similarity of the same scene is normalised to the same points, up to the signs of the axes
    other = np.eye(4)
    other[:3, :3] = 2.5 * np.eye(3)  # (a turned world changes what "closest to the origin" means, as in the trainer)
    again = gsplat_normalisation(
        {k: np.linalg.inv(moved_camera(other, np.linalg.inv(p))) for k, p in poses.items()}, 2.5 * points
    )
    np.testing.assert_allclose(np.abs((2.5 * points) @ again[:3, :3].T + again[:3, 3]), np.abs(moved), atol=1e-9)


def on_points(points):
    """Gaussians that began on COLMAP points and moved a little, as trained ones do."""
    g = random_gaussians(len(points))
    off = np.random.default_rng(0).normal(0, 0.02, points.shape)
    return replace(g, position=points + off, dynamic=np.ones(len(g), bool), t_sigma=np.full(len(g), 0.3))


@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (-1, -1)])
def test_the_world_of_freetimegsvanilla_is_found_again(tmp_path, colmap_scene, signs):
    """Its own normalisation, in whichever signs its machine gave the axes; velocities, sizes, turns come back too."""
    poses, points = colmap_scene
    lookalikes.colmap_binary(tmp_path / "sparse/0", poses, points)
    T, g = lookalikes.freetime_world(poses, points, signs), on_points(points)
    save_ftgs(trained(g, T), tmp_path / "a.ftgs.ply", 0.0, 2.0, 11)
    (tmp_path / "n.json").write_text(json.dumps({"training_to_world": np.linalg.inv(T).tolist()}))
    for world in (tmp_path, tmp_path / "n.json"):
        got = read_result(tmp_path / "a.ftgs.ply", ImportOptions(time_unit_s=2.0, world=world))
        back = got.gaussians
        np.testing.assert_allclose(back.position, g.position, atol=1e-4)
        np.testing.assert_allclose(back.velocity, g.velocity, atol=1e-4)
        np.testing.assert_allclose(back.scale, g.scale, rtol=1e-4)
        np.testing.assert_allclose(np.abs((back.rotation * g.rotation).sum(1)), 1, atol=1e-5)
    ours = freetime_normalisation(poses, points)
    np.testing.assert_allclose(np.abs(T[:3, :3]), np.abs(ours[:3, :3]), atol=1e-9)


def test_a_result_of_gsplats_trainer_is_told_from_it(tmp_path, colmap_scene):
    poses, points = colmap_scene
    lookalikes.colmap_binary(tmp_path / "sparse/0", poses, points)
    g = on_points(points)
    save_ftgs(trained(g, gsplat_normalisation(poses, points)), tmp_path / "a.ftgs.ply", 0.0, 2.0, 11)
    got = read_result(tmp_path / "a.ftgs.ply", ImportOptions(time_unit_s=2.0, world=tmp_path))
    np.testing.assert_allclose(got.gaussians.position, g.position, atol=1e-4)
    assert "gsplat" in got.notes[-1]


def test_a_world_that_nothing_tells_apart_is_asked_for(tmp_path, colmap_scene):
    """A flame alone lies on no COLMAP point: no guess."""
    poses, points = colmap_scene
    lookalikes.colmap_binary(tmp_path / "sparse/0", poses, points)
    lookalikes.freetime(tmp_path / "ckpt_1.pt")
    options = ImportOptions(time_unit_s=2.0, world=tmp_path)
    with pytest.raises(DataFormatError, match="--world-by"):
        read_result(tmp_path / "ckpt_1.pt", options)
    for by, T in (("freetime", freetime_normalisation), ("gsplat", gsplat_normalisation)):
        got = read_result(tmp_path / "ckpt_1.pt", replace(options, world_by=by))
        raw = lookalikes.freetime(tmp_path / "ckpt_1.pt")
        back = np.linalg.inv(T(poses, points))
        np.testing.assert_allclose(got.gaussians.position, raw["means"] @ back[:3, :3].T + back[:3, 3], atol=1e-3)
    with pytest.raises(DataFormatError, match="give --world too"):
        read_result(tmp_path / "ckpt_1.pt", ImportOptions(time_unit_s=2.0, world_by="gsplat"))


def test_results_that_float32_has_rounded_away_are_named(tmp_path):
    """Unix time and UTM coordinates: lives and sizes of nothing; a day's seconds and a kilometre are still read."""
    g = replace(
        random_gaussians(30), t_sigma=np.full(30, 0.02), scale=np.full((30, 3), 0.01), dynamic=np.ones(30, bool)
    )
    for change, what in (({"t_mu": g.t_mu + 1.76e9}, "clock"), ({"position": g.position + [5e5, 4.2e6, 100]}, "world")):
        path = replace(g, **change).save(tmp_path / f"{what}.npz")
        with pytest.raises(GofError, match=f"the result's {what} reaches"):
            read_result(path)
    for change in ({"t_mu": g.t_mu + 600}, {"position": g.position + [1000.0, 0, 0]}):
        read_result(replace(g, **change).save(tmp_path / "fine.npz"))
    lookalikes.yang(tmp_path / "chkpnt1.pth")
    with pytest.raises(GofError, match="the result's clock"):
        read_result(tmp_path / "chkpnt1.pth", ImportOptions(time_unit_s=0.35, time_zero_s=1.76e9))


def test_cameras_of_one_folder_are_named_by_their_files(tmp_path):
    """Our own COLMAP view: static/cam_0.png."""
    poses = {f"static/{c.name}.png": c.world_to_camera for c in arc(3)}
    lookalikes.colmap_binary(tmp_path, poses, np.zeros((3, 3)))
    assert set(read_cameras(tmp_path)) == {"cam_0", "cam_1", "cam_2"}
    ours = {c.name: c.world_to_camera for c in arc(3)}
    assert "and 0 degrees" in require_same_world(read_cameras(tmp_path), ours, tmp_path)
    elsewhere = {k: moved_camera(similarity(1.0), p) for k, p in ours.items()}
    with pytest.raises(DataFormatError, match="--align"):
        require_same_world(elsewhere, ours, tmp_path)
    assert "nothing says" in require_same_world({"a": np.eye(4)}, ours, tmp_path)


@pytest.mark.parametrize("count", [2, 3, 8])
def test_cameras_give_the_similarity_back(count):
    target = {c.name: c.world_to_camera for c in arc(count)}
    T = similarity()
    source = {k: np.linalg.inv(moved_camera(np.linalg.inv(T), np.linalg.inv(p))) for k, p in target.items()}
    got = align_cameras(source, target)
    np.testing.assert_allclose(got.matrix, T, atol=1e-9)
    assert got.position_rms_m < 1e-9 and got.rotation_max_deg < 1e-5 and got.scale == pytest.approx(2.5)
    noisy = {
        k: p + np.pad(np.random.default_rng(0).normal(0, 0.02, (3, 1)), ((0, 1), (3, 0))) for k, p in source.items()
    }
    noisy[next(iter(noisy))] = source[next(iter(source))]
    assert align_cameras(noisy, target).position_rms_m > 1e-3
    with pytest.raises(GofError, match="two cameras"):
        align_cameras({"cam_0": np.eye(4)}, target)


def test_turned_gaussians_look_the_same_from_turned_cameras():
    """Colours included: rendering the moved Gaussians from moved cameras gives the same picture."""
    from gof.core.cameras import Camera
    from gof.render import render

    T = similarity(scale=1.7)
    g = random_gaussians(40, sh_coefficients=16)
    g.color *= 0.3
    camera = arc(1, width=40, height=40)[0]
    moved = Camera(camera.name, 40, 40, camera.K, np.linalg.inv(moved_camera(T, np.linalg.inv(camera.world_to_camera))))
    a = render(g, camera, 0.4, background=(0, 0, 0))["color"]
    b = render(g.transformed(T), moved, 0.4, background=(0, 0, 0))["color"]
    assert a.max() > 0.1
    np.testing.assert_allclose(a, b, atol=2e-4)
    np.testing.assert_allclose(g.transformed(T).velocity, g.velocity @ T[:3, :3].T, atol=1e-5)
    mirrored = T.copy()
    mirrored[:3, 0] *= -1
    with pytest.raises(GofError, match="similarity"):
        g.transformed(mirrored)
