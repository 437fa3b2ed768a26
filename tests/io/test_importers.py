"""Every foreign layout against truths that are computed another way than the importer does."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch")

from gof.errors import DataFormatError, GofError  # noqa: E402
from gof.io.colmap import read_colmap  # noqa: E402
from gof.io.importers import ImportOptions, Source, detect, read_result  # noqa: E402
from gof.io.importers.alignment import align_cameras, read_cameras, require_same_world  # noqa: E402
from gof.io.importers.freetime import save as save_ftgs  # noqa: E402
from gof.io.importers.normalisation import freetime_normalisation, gsplat_normalisation  # noqa: E402
from gof.motion import Motion, State  # noqa: E402
from gof.trajectory import Trajectory  # noqa: E402
from tests.conftest import arc, random_gaussians  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.lookalikes import logistic, yang_covariance  # noqa: E402

# ---------------------------------------------------------------- the paper's code


def test_authors_checkpoint(tmp_path):
    path, raw = lookalikes.authors(tmp_path / "model")
    got = read_result(path)
    g, d = got.gaussians, raw["dynamic"]
    assert got.method == "authors" and len(g) == 30 and (g.dynamic == d).all()
    np.testing.assert_allclose(g.velocity, raw["velocity"] * 1000, rtol=1e-6)  # per millisecond -> per second
    np.testing.assert_allclose(g.t_mu, raw["t_mu"][:, 0] / 1000, rtol=1e-6)
    np.testing.assert_allclose(g.scale[d], 0.001 + 0.029 * logistic(raw["scaling"][d]), rtol=1e-5)
    np.testing.assert_allclose(g.scale[~d], np.exp(raw["scaling"][~d]), rtol=1e-5)
    for t_ms in (0.0, 33.0, 80.0):  # position and opacity of its renderer, in its units
        dt = t_ms - raw["t_mu"]
        position, opacity = g.at(t_ms / 1000)
        np.testing.assert_allclose(position[d], (raw["xyz"] + dt * raw["velocity"])[d], atol=1e-5)
        np.testing.assert_allclose(
            opacity[d], (logistic(raw["opacity"]) * np.exp(-(dt**2) / (2 * raw["t_sigma"] ** 2)))[d, 0], atol=1e-5
        )
    assert read_result(tmp_path / "model").path == path  # the folder finds its newest checkpoint


def test_authors_without_bounds_or_with_wrong_ones(tmp_path):
    path, _ = lookalikes.authors(tmp_path / "model")
    bounds = tmp_path / "model/point_cloud/iteration_7000/scale_bounds.json"
    bounds.write_text(json.dumps({"dynamic_scale_min": 0.1}))
    with pytest.raises(DataFormatError, match="dynamic_scale_max"):
        read_result(path)
    bounds.unlink()
    with pytest.raises(DataFormatError, match=r"scale_bounds\.json is missing"):
        read_result(path)


@pytest.mark.parametrize("write", [lookalikes.released_ply, lookalikes.released_checkpoint])
def test_authors_release_gives_back_the_scene_it_holds(tmp_path, write):
    scene = lookalikes.released_scene()
    path = write(tmp_path / "model", scene)
    got = read_result(path)
    g, moves = got.gaussians, scene["dynamic"]
    assert got.method == "authors" and any("scale bounds" in n for n in got.notes)
    np.testing.assert_array_equal(g.dynamic, moves)
    np.testing.assert_allclose(g.velocity[moves], scene["velocity"][moves], rtol=1e-5)
    for name in ("position", "scale", "opacity", "color"):
        np.testing.assert_allclose(getattr(g, name), scene[name], rtol=2e-4, atol=1e-6, err_msg=name)
    for name in ("t_mu", "t_sigma"):
        np.testing.assert_allclose(getattr(g, name), scene[name], rtol=1e-5, err_msg=name)
    np.testing.assert_allclose(np.abs((g.rotation * scene["rotation"]).sum(1)), 1, atol=1e-5)
    still = g.at(5.0)[0][~moves]  # long after: the background stays, whatever its velocity column says
    np.testing.assert_allclose(still, scene["position"][~moves], atol=1e-6)
    assert read_result(tmp_path / "model").path == path  # the folder finds it
    shifted = read_result(path, ImportOptions(time_zero_s=-0.01)).gaussians
    np.testing.assert_allclose(shifted.t_mu, scene["t_mu"] - 0.01, atol=1e-6)


def test_authors_release_with_its_bounds_lost_or_absent(tmp_path):
    scene = lookalikes.released_scene()
    path = lookalikes.released_ply(tmp_path / "model", scene)
    (path.parent / "point_cloud_scale_bounds.json").unlink()
    with pytest.raises(DataFormatError, match=r"point_cloud_scale_bounds\.json is missing"):
        read_result(path)
    for bounds, said in (((0.3, 0.1), "not 0 < min < max"), ((0.1, None), "needs numbers")):
        with pytest.raises(DataFormatError, match=said):
            read_result(lookalikes.released_checkpoint(tmp_path / said, scene, bounds=bounds))
    without = read_result(lookalikes.released_checkpoint(tmp_path / "none", scene, bounds=(None, None)))
    raw = lookalikes.released_raw(scene)["scaling"]  # its code then takes all sizes as logarithms
    np.testing.assert_allclose(without.gaussians.scale, np.exp(raw), rtol=1e-4)


def test_authors_ply_has_no_velocity(tmp_path):
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(0), 4).items()}
    lookalikes.splat_ply(tmp_path / "point_cloud.ply", raw, {k: np.ones(4) for k in ("t_mu", "t_sigma", "is_dynamic")})
    with pytest.raises(DataFormatError, match="no velocities"):
        read_result(tmp_path / "point_cloud.ply")


# ---------------------------------------------------------------- Yang


def test_yang_against_the_density_in_space_time(tmp_path):
    """Velocity by finite differences of the most likely place at each time; shape and window from the 4D density."""
    raw = lookalikes.yang(tmp_path / "chkpnt30000.pth")
    got = read_result(tmp_path / "chkpnt30000.pth")
    g, S = got.gaussians, yang_covariance(raw)
    assert got.method == "yang" and any("colours" in n for n in got.notes)
    for i in range(len(g)):
        precision = np.linalg.inv(S[i])

        def likeliest(t, precision=precision, i=i):  # the maximum over x of the density at time t
            return raw["xyz"][i] - np.linalg.solve(precision[:3, :3], precision[:3, 3]) * (t - raw["t"][i, 0])

        difference = (likeliest(0.7 + 1e-3) - likeliest(0.7 - 1e-3)) / 2e-3
        np.testing.assert_allclose(g.velocity[i], difference, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(g[i : i + 1].at(0.7)[0][0], likeliest(0.7), atol=1e-4)
        R = Rotation.from_quat(g.rotation[i, [1, 2, 3, 0]]).as_matrix()
        conditional = R @ np.diag(g.scale[i].astype(float) ** 2) @ R.T
        np.testing.assert_allclose(
            conditional, np.linalg.inv(precision[:3, :3]), rtol=1e-3, atol=1e-3 * np.trace(conditional)
        )
        # integrating the density over space leaves exp(-dt^2 / (2 S_tt))
        ratio = g[i : i + 1].at(0.4)[1][0] / logistic(raw["opacity"][i, 0])
        assert ratio == pytest.approx(np.exp(-((0.4 - raw["t"][i, 0]) ** 2) / (2 * S[i][3, 3])), rel=1e-3, abs=1e-6)
    det = np.exp(raw["scaling"].astype(float).sum(1) + raw["scaling_t"][:, 0]) / np.sqrt(S[:, 3, 3])
    np.testing.assert_allclose(g.scale.astype(float).prod(1), det, rtol=1e-4)  # the DVE weight's volume


def test_yang_before_and_since_september_2024(tmp_path):
    """One file, two meanings: its commit 900c592 reversed the order of the axes that the quaternions turn."""
    raw = lookalikes.yang(tmp_path / "chkpnt30000.pth")
    for date, flip in (("2024-09-14", False), ("2024-09-15", True), (None, True)):
        S = yang_covariance(raw, flip)
        got = read_result(tmp_path / "chkpnt30000.pth", ImportOptions(code_date=date))
        np.testing.assert_allclose(got.gaussians.velocity, S[:, :3, 3] / S[:, 3, 3, None], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(got.gaussians.t_sigma, np.sqrt(S[:, 3, 3]), rtol=1e-5)
        assert any("--code-date" in note for note in got.notes) == (date is None)


def test_yang_with_a_wider_window(tmp_path):
    """prefilter_var stands in cfg_args beside the checkpoint; it widens the temporal window and nothing else."""
    raw = lookalikes.yang(tmp_path / "chkpnt_best.pth")
    S = yang_covariance(raw)
    (tmp_path / "cfg_args").write_text("Namespace(sh_degree=3, source_path='a', prefilter_var=0.02, x=[1])")
    got = read_result(tmp_path)  # the folder's best, where it has no other
    np.testing.assert_allclose(got.gaussians.t_sigma, np.sqrt(S[:, 3, 3] + 0.02), rtol=1e-5)
    np.testing.assert_allclose(got.gaussians.velocity, S[:, :3, 3] / S[:, 3, 3, None], rtol=1e-4, atol=1e-5)
    assert not any("--code-date" in note for note in got.notes)
    for text in ("Namespace(prefilter_var=-1.0)", "Namespace(a=-'b')", "import os", "Namespace(" * 9999, "\0", "f(x"):
        (tmp_path / "cfg_args").write_text(text)
        np.testing.assert_allclose(read_result(tmp_path).gaussians.t_sigma, np.sqrt(S[:, 3, 3]), rtol=1e-5)


def test_times_that_are_shares_of_the_clip_are_asked_about(tmp_path):
    """Trained on the D-NeRF layout of our own dataset: its time runs from 0 to 1 however long the clip is."""
    lookalikes.yang(tmp_path / "a.pth", n=300)
    clip = ImportOptions(frame_time_s=0.01, clip_s=(0.0, 0.35))
    with pytest.raises(DataFormatError, match=r"--time-unit.*0\.35 if they are shares"):
        read_result(tmp_path / "a.pth", clip)
    assert read_result(tmp_path / "a.pth", replace(clip, time_unit_s=0.35)).gaussians.t_mu.max() <= 0.35
    lookalikes.yang(tmp_path / "b.pth", n=300, times=(-0.03, 0.38))  # seconds, as its own initialisation spreads them
    read_result(tmp_path / "b.pth", clip)
    lookalikes.yang(tmp_path / "c.pth", n=300, times=(0, 35 / 30))  # frames at 30 a second, as n3v2blender writes
    with pytest.raises(DataFormatError, match="the clip lasts 0.35 s"):
        read_result(tmp_path / "c.pth", clip)


def test_yang_time_unit_and_the_3d_variant(tmp_path):
    raw = lookalikes.yang(tmp_path / "a.pth")
    a, b = (
        read_result(tmp_path / "a.pth").gaussians,
        read_result(tmp_path / "a.pth", ImportOptions(time_unit_s=0.5, time_zero_s=2)).gaussians,
    )
    np.testing.assert_allclose(b.velocity, 2 * a.velocity, rtol=1e-5)
    np.testing.assert_allclose(b.t_mu, 2 + 0.5 * raw["t"][:, 0], rtol=1e-5)
    lookalikes.yang(tmp_path / "b.pth", rot_4d=False)
    with pytest.raises(DataFormatError, match="rot_4d=False"):
        read_result(tmp_path / "b.pth")


# ---------------------------------------------------------------- FreeTimeGS


def test_freetime_checkpoint_and_canonical_npz(tmp_path):
    raw = lookalikes.freetime(tmp_path / "results/ckpts/ckpt_29999.pt")
    np.savez(tmp_path / "canonical_4d.npz", **raw, n_frames=61, start_frame=0, end_frame=61, use_velocity=True)
    options = ImportOptions(frame_time_s=0.02)  # 61 frames: the sequence lasts 1.2 s
    for path in (tmp_path / "results", tmp_path / "canonical_4d.npz"):
        got = read_result(path, options)
        g = got.gaussians
        assert got.method == "freetime" and any("normalises" in n for n in got.notes)
        for tau in (0.0, 0.25, 0.9):
            dt = tau - raw["times"]
            position, opacity = g.at(1.2 * tau)
            np.testing.assert_allclose(position, raw["means"] + dt * raw["velocities"], atol=1e-5)
            window = np.exp(-0.5 * (dt[:, 0] / np.maximum(np.exp(raw["durations"][:, 0].astype(float)), 0.02)) ** 2)
            np.testing.assert_allclose(opacity, logistic(raw["opacities"]) * window, atol=2e-5)
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "canonical_4d.npz")


def test_freetime_variants_are_refused(tmp_path):
    lookalikes.freetime(tmp_path / "a.pt", drop=("velocities",))
    with pytest.raises(DataFormatError, match="nine of FreeTimeGS"):
        read_result(tmp_path / "a.pt")


def test_ftgs_ply_there_and_back(tmp_path):
    for sh in (0, 4, 16):
        g = random_gaussians(25, sh_coefficients=sh)
        g.t_sigma[np.flatnonzero(g.dynamic)[:3]] = 0.03  # too short for it
        path = save_ftgs(g, tmp_path / f"{sh}.ftgs.ply", start_s=-0.5, end_s=1.5, frames=51)
        back = read_result(path, ImportOptions(frame_time_s=0.04, time_zero_s=-0.5)).gaussians
        shortest = 0.02 * 2.0  # s: its renderer never uses less than 2 % of the sequence
        for t in (0.0, 0.3, 1.0):
            dt = np.where(g.dynamic, t - g.t_mu.astype(float), 0.0)
            position, opacity = back.at(t)
            np.testing.assert_allclose(position, g.position + dt[:, None] * g.velocity, atol=2e-5)
            window = np.exp(-0.5 * (dt / np.maximum(g.t_sigma, shortest)) ** 2)
            np.testing.assert_allclose(opacity, g.opacity * window, atol=2e-5)
        np.testing.assert_allclose(back.velocity, np.where(g.dynamic[:, None], g.velocity, 0), atol=1e-5)
        np.testing.assert_allclose(back.scale, g.scale, rtol=1e-4)
    header = (tmp_path / "0.ftgs.ply").read_bytes().split(b"end_header")[0].decode()
    assert (
        "comment ftgs_version 1\ncomment time_units normalized\ncomment sh_degree 0\ncomment use_velocity 1" in header
    )
    assert "property float velocity_2" in header and "format binary_little_endian 1.0" in header


def test_ftgs_ply_of_another_version(tmp_path):
    path = save_ftgs(random_gaussians(3), tmp_path / "a.ftgs.ply", 0, 1, 10)
    path.write_bytes(path.read_bytes().replace(b"ftgs_version 1", b"ftgs_version 2"))
    with pytest.raises(DataFormatError, match="ftgs_version 2"):
        read_result(path)


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
        {k: np.linalg.inv(_moved(other, np.linalg.inv(p))) for k, p in poses.items()}, 2.5 * points
    )
    np.testing.assert_allclose(np.abs((2.5 * points) @ again[:3, :3].T + again[:3, 3]), np.abs(moved), atol=1e-9)


def _moved(similarity, camera_to_world):
    out = similarity @ camera_to_world
    out[:3, :3] /= np.cbrt(np.linalg.det(out[:3, :3]))
    return out


def trained(g, T):
    """Gaussians in metres, as a trainer holds them after the similarity T (4, 4)."""
    s = np.cbrt(np.linalg.det(T[:3, :3]))
    turn = Rotation.from_matrix(T[:3, :3] / s)
    rotation = (turn * Rotation.from_quat(g.rotation[:, [1, 2, 3, 0]])).as_quat()[:, [3, 0, 1, 2]]
    return replace(
        g,
        position=g.position @ T[:3, :3].T + T[:3, 3],
        velocity=g.velocity @ T[:3, :3].T,
        scale=s * g.scale,
        rotation=rotation,
    )


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


@pytest.mark.parametrize(
    "said",
    [
        {"time_units": "seconds"},
        {"model_spec": {"time_units": "frames"}},
        {"model_spec": {"duration_activation": "sigmoid"}},
        {"use_marginal_gating": True},
        {"use_color_velocity": True},
        {"color_correction": {"a": torch.ones(3)}},
        {"model_spec": [1]},
        {"n_frames": "61"},
    ],
    ids=str,
)
def test_variants_of_freetime_are_refused(tmp_path, said):
    """What the method's own validate_vanilla_checkpoint refuses is refused here."""
    lookalikes.freetime(tmp_path / "ckpt_1.pt", extra=said)
    with pytest.raises(DataFormatError, match="ckpt_1.pt"):
        read_result(tmp_path / "ckpt_1.pt", ImportOptions(time_unit_s=2.0))
    plain = {"time_units": "normalized", "color_correction": None, "use_marginal_gating": False}
    lookalikes.freetime(tmp_path / "ckpt_2.pt", extra=plain | {"model_spec": {"min_duration": 0.001}})
    short = read_result(tmp_path / "ckpt_2.pt", ImportOptions(time_unit_s=2.0)).gaussians.t_sigma
    assert 0.002 <= short.min() < 0.02 * 2


def test_an_ftgs_ply_of_ours_comes_back_without_options(tmp_path):
    """Which seconds its times 0 and 1 are, and what it cannot hold, is said and written."""
    from gof.io.convert import convert
    from gof.io.importers import Imported

    g = replace(random_gaussians(30), t_sigma=np.full(30, 0.005))
    said = convert(Imported(g, "gof", tmp_path / "a.npz"), tmp_path / "a.ftgs.ply", 0.1, 0.45)
    assert "0.1..0.45 s" in said[0] and "shorter than the format's least" in said[1]
    back = read_result(tmp_path / "a.ftgs.ply").gaussians
    np.testing.assert_allclose(back.t_mu[g.dynamic], g.t_mu[g.dynamic], atol=1e-6)
    np.testing.assert_allclose(back.velocity[g.dynamic], g.velocity[g.dynamic], rtol=1e-5)


# ---------------------------------------------------------------- trajectories


def swirl(t, start, rate=9.0):
    c, s = np.cos(rate * t), np.sin(rate * t)
    return np.stack([c * start[:, 0] - s * start[:, 1], s * start[:, 0] + c * start[:, 1], start[:, 2] + 0.5 * t], -1)


def make_trajectory(times, n=40, rate=9.0):
    start = np.random.default_rng(2).normal(size=(n, 3))
    position = np.stack([swirl(t, start, rate) for t in times])
    return Trajectory(
        times, position, np.full((len(times), n), 0.5), np.full((n, 3), 0.02), np.tile([1.0, 0, 0, 0], (n, 1))
    ), start


def test_half_steps_and_ends_of_a_swirl():
    """A 1.5 Hz swirl at 25 frames per second: velocities of half steps are right to 0.6 %, of whole steps to 2.4 %."""
    rate = 2 * np.pi * 1.5
    errors = {}
    for name, times in (("whole", np.arange(0, 1.001, 0.04)), ("half", np.arange(0, 1.001, 0.02))):
        trajectory, start = make_trajectory(times, rate=rate)
        h = 1e-6
        for label, t in (("inside", 0.4), ("end", 1.0)):
            truth = (swirl(t + h, start, rate) - swirl(t - h, start, rate)) / (2 * h)
            v = trajectory.state_at(t).velocity
            errors[name, label] = np.linalg.norm(v - truth) / np.linalg.norm(truth)
    assert errors["half", "inside"] < 0.006 and 0.02 < errors["whole", "inside"] < 0.027
    assert errors["half", "end"] < 0.02 and errors["half", "end"] < errors["whole", "end"] / 3
    # changing by 3x its own error when the step doubles (differences of second order)
    assert make_trajectory(np.arange(0, 1.001, 0.04), rate=rate)[0].difference_change() == pytest.approx(
        3 * errors["whole", "inside"], rel=0.3
    )


def test_quadratic_motion_is_exact_on_uneven_times_and_linear_between_samples():
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.7])
    x0 = np.random.default_rng(0).normal(size=(6, 3)) + 1000  # far from the origin
    position = np.stack([x0 + 2 * t + 3 * t**2 * np.array([1, 0, -1]) for t in times])
    trajectory = Trajectory(
        times, position, np.ones((5, 6)) * times[:, None], np.full((6, 3), 0.1), np.tile([1.0, 0, 0, 0], (6, 1))
    )
    for t in times:
        np.testing.assert_allclose(
            trajectory.state_at(t).velocity, np.broadcast_to(2 + 6 * t * np.array([1, 0, -1]), (6, 3)), atol=5e-3
        )
    between = trajectory.state_at(0.2)
    np.testing.assert_allclose(between.opacity, 0.2, atol=1e-6)
    np.testing.assert_allclose(between.velocity[0], [2 + 3 * 0.35, 2, 2 - 3 * 0.35], atol=5e-3)
    with pytest.raises(DataFormatError, match="outside"):
        trajectory.state_at(0.8)


def test_trajectory_file(tmp_path):
    trajectory, _ = make_trajectory(np.arange(5) * 0.1)
    got = read_result(trajectory.save(tmp_path / "t.npz", "by hand"))
    assert got.method == "trajectory" and isinstance(got.gaussians, Trajectory) and "differences" in got.notes[0]
    np.testing.assert_array_equal(got.gaussians.position, trajectory.position)
    np.savez(tmp_path / "bad.npz", schema="gof-trajectory/1", time_s=np.arange(3))
    with pytest.raises(DataFormatError, match="position"):
        read_result(tmp_path / "bad.npz")
    np.savez(
        tmp_path / "worse.npz",
        schema="gof-trajectory/1",
        time_s=np.array([0, 0.2, 0.1]),
        position=np.zeros((3, 2, 3)),
        opacity=np.zeros((3, 2)),
        scale=np.ones((2, 3)),
        rotation=np.ones((2, 4)),
    )
    with pytest.raises(DataFormatError, match="increasing"):
        read_result(tmp_path / "worse.npz")


def test_ply_sequence(tmp_path):
    rng = np.random.default_rng(1)
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(rng, 12).items()}
    start = raw["xyz"].astype(float)
    for k in range(6):
        raw["xyz"] = swirl(0.02 * k, start, 5.0).astype(np.float32)
        lookalikes.splat_ply(tmp_path / "seq" / f"time_{k:05d}.ply", raw)
    got = read_result(tmp_path / "seq", ImportOptions(time_unit_s=0.02, time_zero_s=1.0))
    assert got.method == "ply-sequence" and len(got.gaussians.time_s) == 6
    v = got.gaussians.state_at(1.06).velocity
    truth = (swirl(0.06 + 1e-6, start, 5.0) - swirl(0.06 - 1e-6, start, 5.0)) / 2e-6
    assert np.linalg.norm(v - truth) / np.linalg.norm(truth) < 0.005
    np.testing.assert_allclose(got.gaussians.opacity[0], logistic(raw["opacity"][:, 0]), rtol=1e-5)
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "seq")
    lookalikes.splat_ply(tmp_path / "seq/time_00006.ply", {k: v[:5] for k, v in raw.items()})
    with pytest.raises(DataFormatError, match="same Gaussians"):
        read_result(tmp_path / "seq", ImportOptions(time_unit_s=0.02))


def test_a_sequence_of_the_wrong_clock_or_kind_is_asked_about(tmp_path):
    """Half steps taken for frames, numbers of training steps, a file per picture, numbers with a point."""
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(1), 5).items()}

    def write(folder, names, places):
        for name, place in zip(names, places, strict=True):
            lookalikes.splat_ply(tmp_path / folder / name, raw | {"xyz": raw["xyz"] + place})

    clip = ImportOptions(frame_time_s=0.01, clip_s=(0.0, 0.35))
    write("half", [f"{k:03d}.ply" for k in range(71)], np.linspace(0, 1, 71))
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "half", clip)
    assert read_result(tmp_path / "half", replace(clip, time_unit_s=0.005)).gaussians.covered_s[1] == pytest.approx(
        0.35
    )
    write("4dgs", [f"4dgs_{k:05d}.ply" for k in range(36)], np.linspace(0, 1, 36))
    assert len(read_result(tmp_path / "4dgs", clip).gaussians.time_s) == 36
    write("steps", ["point_cloud_7000.ply", "point_cloud_30000.ply"], [0, 1])
    with pytest.raises(DataFormatError, match="steps of a training"):
        read_result(tmp_path / "steps", ImportOptions(time_unit_s=0.01))
    write("cameras", [f"time_{k:05d}.ply" for k in range(9)], np.repeat([0, 1, 2], 3))
    with pytest.raises(DataFormatError, match="same positions"):
        read_result(tmp_path / "cameras", ImportOptions(time_unit_s=0.01))
    for name, files in {"point": ["a_0.25.ply", "a_0.5.ply"], "two": ["a0.ply", "a1.ply", "b0.ply"]}.items():
        write(name, files, range(len(files)))
        with pytest.raises(DataFormatError, match="no format"):
            read_result(tmp_path / name, ImportOptions(time_unit_s=0.01))


def test_ranges_of_a_trajectory(tmp_path):
    """Logarithms and logits are no sizes and opacities; seconds are no shares of the clip."""
    trajectory, _ = make_trajectory(np.linspace(0, 1, 5))
    for wrong, rule in (
        ({"scale": np.log(trajectory.scale)}, "not its log"),
        ({"opacity": trajectory.opacity * 9}, "logit"),
    ):
        with pytest.raises(DataFormatError, match=rule):
            replace(trajectory, **wrong)
    replace(trajectory, opacity=np.full_like(trajectory.opacity, 1 + 1e-7))
    path = trajectory.save(tmp_path / "t.npz")
    assert len(read_result(path, ImportOptions(clip_s=(0.0, 1.0))).notes) == 1
    assert "are they seconds" in read_result(path, ImportOptions(clip_s=(0.0, 0.35))).notes[1]


# ---------------------------------------------------------------- a function of time


def test_a_function_of_time_is_a_result(tmp_path):
    """Velocities of a function that has none are differences of it; worlds, ends, files and wrong states."""
    _, start = make_trajectory(np.linspace(0, 1, 5))
    n = len(start)

    def state(t, **changes):
        fields = {"position": swirl(t, start), "opacity": np.full(n, 0.5), "scale": np.full((n, 3), 0.1)}
        return State(**fields | {"rotation": np.tile([1.0, 0, 0, 0], (n, 1))} | changes)

    motion = Motion(state, (0.0, 1.0), times_s=np.linspace(0, 1, 9))
    assert len(motion) == n and motion.life() == (0, 1)
    for t in (0.0, 0.4, 1.0):
        truth = (swirl(t + 1e-6, start) - swirl(t - 1e-6, start)) / 2e-6
        np.testing.assert_allclose(motion.state_at(t).velocity, truth, atol=0.05 if t in (0, 1) else 1e-4)
    T = similarity()
    np.testing.assert_allclose(
        motion.transformed(T).transformed(np.linalg.inv(T)).state_at(0.4).position, swirl(0.4, start), atol=1e-5
    )
    saved = read_result(motion.save(tmp_path / "m.npz")).gaussians
    np.testing.assert_allclose(saved.state_at(0.5).velocity, motion.state_at(0.5).velocity, atol=1e-6)
    with pytest.raises(DataFormatError, match="outside"):
        motion.state_at(1.1)
    with pytest.raises(GofError, match="times_s"):
        Motion(state).save(tmp_path / "n.npz")
    for wrong in (
        {"scale": np.full((n, 3), -2.0)},
        {"opacity": np.full(n, 3.0)},
        {"position": np.full((n, 3), np.nan)},
    ):
        with pytest.raises(GofError, match="the function: state at 0.5 s"):
            Motion(lambda t, wrong=wrong: state(t, velocity=np.zeros((n, 3)), **wrong)).state_at(0.5)


@pytest.mark.parametrize("full", [False, True])
def test_spacetime_gaussians(tmp_path, full):
    """Positions, velocities and opacities of its renderer, one Gaussian at a time, from the raw numbers."""
    raw = lookalikes.spacetime(tmp_path / "p.ply", full=full)
    with pytest.raises(DataFormatError, match="--time-unit.*0.36 if that was"):
        read_result(tmp_path / "p.ply", ImportOptions(frame_time_s=0.01, clip_s=(0.0, 0.35)))
    got = read_result(tmp_path / "p.ply", ImportOptions(time_unit_s=0.5, time_zero_s=1.0))
    for t in (1.0, 1.2, 1.5):
        state = got.gaussians.state_at(t)
        for i in range(20):
            d = (t - 1.0) / 0.5 - raw["trbf_center"][i, 0]
            m = raw["motion"][i]
            place = [raw["xyz"][i, k] + m[k] * d + m[3 + k] * d**2 + m[6 + k] * d**3 for k in range(3)]
            speed = [(m[k] + 2 * m[3 + k] * d + 3 * m[6 + k] * d**2) / 0.5 for k in range(3)]
            q = raw["rot"][i] + d * raw["omega"][i]
            alpha = logistic(raw["opacity"][i, 0]) * np.exp(-((d / np.exp(raw["trbf_scale"][i, 0])) ** 2))
            np.testing.assert_allclose(state.position[i], place, rtol=1e-5, atol=1e-6)
            np.testing.assert_allclose(state.velocity[i], speed, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(state.rotation[i], q / np.linalg.norm(q), atol=1e-6)
            np.testing.assert_allclose(state.opacity[i], alpha, atol=1e-6)
    np.testing.assert_allclose(got.gaussians.state_at(1.2).scale, np.exp(raw["scale"]), rtol=1e-5)
    assert ("decoder" in got.notes[1]) == full
    got.gaussians.save(tmp_path / "t.npz")
    assert "velocities as stored" in read_result(tmp_path / "t.npz").notes


# ---------------------------------------------------------------- recognised, refused, dangerous


@pytest.mark.parametrize("option", ["world", "code_date", "time_unit_s", "time_zero_s", "world_by"])
def test_options_that_would_be_ignored_are_an_error(tmp_path, gaussians, option):
    """A path that does not exist included; and the numbers that are no times."""
    gaussians.save(tmp_path / "a.npz")
    given = {"world": tmp_path / "nothing", "code_date": "2024-01-01", "time_unit_s": 2.0, "time_zero_s": 1.0}
    options = ImportOptions(**{option: given.get(option, "gsplat")})
    with pytest.raises(DataFormatError, match="--" + option.removesuffix("_s").replace("_", "-")):
        read_result(tmp_path / "a.npz", options)
    path, _ = lookalikes.authors(tmp_path / "model")
    if not option.startswith("time"):
        with pytest.raises(DataFormatError, match="would change nothing"):
            read_result(path, options)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(GofError, match="--time-unit"):
            ImportOptions(time_unit_s=wrong)
    with pytest.raises(GofError, match="--time-zero"):
        ImportOptions(time_zero_s=np.nan)
    with pytest.raises(GofError, match="--code-date"):
        ImportOptions(code_date="yesterday")


def test_tensors_that_are_no_plain_arrays_are_named(tmp_path):
    """Sparse, meta, quantised, nested, complex, of no rows; keys that are no text; archives that are packed."""
    import zipfile

    path, _ = lookalikes.authors(tmp_path / "model")
    state, iteration = torch.load(path, weights_only=False)
    odd = {
        "sparse": state[1].detach().to_sparse(),
        "meta": torch.zeros(30, 3, device="meta"),
        "quantised": torch.quantize_per_tensor(state[1].detach(), 0.1, 0, torch.qint8),
        "complex": state[1].detach().to(torch.complex64),
        "conjugated": state[1].detach().to(torch.complex64).conj(),
        "empty": torch.zeros(0, 3),
        "bool": torch.zeros(30, 3, dtype=torch.bool).to_sparse(),
    }
    for name, tensor in odd.items():
        torch.save(((*state[:1], tensor, *state[2:]), iteration), path)
        with pytest.raises(DataFormatError, match="chkpnt7000.pth"):
            read_result(path)
            pytest.fail(name)
    torch.save({1: torch.zeros(3), (2, 3): 4}, tmp_path / "keys.pth")
    with pytest.raises(DataFormatError, match="no layout gof knows"):
        read_result(tmp_path / "keys.pth")
    torch.save(torch.zeros(30_000_000), tmp_path / "big.pth")
    with zipfile.ZipFile(tmp_path / "big.pth") as big, zipfile.ZipFile(tmp_path / "p.pth", "w", 8) as packed:
        for name in big.namelist():
            packed.writestr(name, big.read(name))
    with pytest.raises(DataFormatError, match="unpacks to"):
        read_result(tmp_path / "p.pth")


def test_what_cannot_be_read_is_named_as_a_user_knows_it(tmp_path):
    torch.save((Bomb(), 3), tmp_path / "x.pth")
    with pytest.raises(DataFormatError) as said:
        read_result(tmp_path / "x.pth")
    assert "holds exec besides" in str(said.value) and "option" not in str(said.value) and "\x1b" not in str(said.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataFormatError, match="SpacetimeGaussians"):
        read_result(tmp_path / "empty")
    torch.save({"linear.0.weight": torch.zeros(2), "gaussian_warp.weight": torch.zeros(3)}, tmp_path / "deform.pth")
    np.savez(tmp_path / "params.npz", means3D=np.zeros((4, 5, 3)), unnorm_rotations=np.zeros((4, 5, 4)))
    np.savez(tmp_path / "t.npz", time_s=np.arange(4), position=np.zeros((4, 5, 3)))
    (tmp_path / "wu").mkdir()
    torch.save({}, tmp_path / "wu/deformation.pth")
    for name, reason in (
        ("deform.pth", "Deformable-3DGS"),
        ("params.npz", "Dynamic3DGaussians"),
        ("t.npz", "schema"),
        ("wu", "Wu"),
    ):
        with pytest.raises(DataFormatError, match=reason):
            read_result(tmp_path / name)


def test_methods_without_velocities_are_explained(tmp_path):
    lookalikes.wu(tmp_path / "chkpnt_fine_14000.pth")
    torch.save((torch.nn.Linear(2, 2).state_dict(), torch.nn.Linear(2, 3).state_dict()), tmp_path / "deform.pth")
    (tmp_path / "grid4d/deform").mkdir(parents=True)
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(0), 4).items()}
    lookalikes.splat_ply(tmp_path / "static.ply", raw)
    for name, reason in (
        ("chkpnt_fine_14000.pth", "Wu"),
        ("deform.pth", "Grid4D"),
        ("grid4d", "Grid4D"),
        ("static.ply", "neither time nor velocity"),
    ):
        with pytest.raises(DataFormatError, match=reason):
            read_result(tmp_path / name)


class Bomb:
    def __reduce__(self):
        return (exec, ("import pathlib; pathlib.Path('exploded').touch()",))


@pytest.mark.parametrize("kind", ["zip", "legacy", "plain", "npz"])
def test_no_pickle_is_executed(tmp_path, kind, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / ("x.npz" if kind == "npz" else "x.pth")
    if kind == "plain":
        path.write_bytes(pickle.dumps(((1, Bomb()), 2)))
    elif kind == "npz":
        np.savez(path, schema=np.array("gof-linear/1"), x0=np.array([Bomb()], object))
    else:
        torch.save((Bomb(), 3), path, _use_new_zipfile_serialization=kind == "zip")
    with pytest.raises(DataFormatError, match=r"x\.(pth|npz)"):
        read_result(path)
    assert not (tmp_path / "exploded").exists()


def test_wrong_layouts_are_named(tmp_path):
    cases = {
        "shape": lambda s: (*s[:1], torch.zeros(30, 4), *s[2:]),
        "nan": lambda s: (*s[:1], s[1] * np.nan, *s[2:]),
        "type": lambda s: (*s[:2], [1, 2], *s[3:]),
    }
    for name, change in cases.items():
        path, _ = lookalikes.authors(tmp_path / name)
        state, iteration = torch.load(path, weights_only=False)
        torch.save((change(state), iteration), path)
        with pytest.raises(DataFormatError, match=r"'(xyz|velocity)'"):
            read_result(path)
    torch.save({"a": torch.zeros(3)}, tmp_path / "other.pth")
    with pytest.raises(DataFormatError, match="no layout gof knows"):
        read_result(tmp_path / "other.pth")
    (tmp_path / "cut.pth").write_bytes(path.read_bytes()[:500])
    with pytest.raises(DataFormatError, match="readable PyTorch"):
        read_result(tmp_path / "cut.pth")
    with pytest.raises(DataFormatError, match="no such"):
        read_result(tmp_path / "nothing.pth")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataFormatError, match="no format"):
        read_result(tmp_path / "empty")


def test_own_files(tmp_path, gaussians):
    for name in ("a.npz", "a.ply"):
        gaussians.save(tmp_path / name)
        assert detect(Source(tmp_path / name)) == "gof"
        np.testing.assert_allclose(read_result(tmp_path / name).gaussians.velocity, gaussians.velocity)


# ---------------------------------------------------------------- worlds


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
    elsewhere = {k: _moved(similarity(1.0), p) for k, p in ours.items()}
    with pytest.raises(DataFormatError, match="--align"):
        require_same_world(elsewhere, ours, tmp_path)
    assert "nothing says" in require_same_world({"a": np.eye(4)}, ours, tmp_path)


def similarity(scale=2.5, seed=0):
    matrix = np.eye(4)
    matrix[:3, :3] = scale * Rotation.random(random_state=seed).as_matrix()
    matrix[:3, 3] = [1, -2, 3]
    return matrix


@pytest.mark.parametrize("count", [2, 3, 8])
def test_cameras_give_the_similarity_back(count):
    target = {c.name: c.world_to_camera for c in arc(count)}
    T = similarity()
    source = {k: np.linalg.inv(_moved(np.linalg.inv(T), np.linalg.inv(p))) for k, p in target.items()}
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
    from gof.cameras import Camera
    from gof.render import render

    T = similarity(scale=1.7)
    g = random_gaussians(40, sh_coefficients=16)
    g.color *= 0.3
    camera = arc(1, width=40, height=40)[0]
    moved = Camera(camera.name, 40, 40, camera.K, np.linalg.inv(_moved(T, np.linalg.inv(camera.world_to_camera))))
    a = render(g, camera, 0.4, background=(0, 0, 0))["color"]
    b = render(g.transformed(T), moved, 0.4, background=(0, 0, 0))["color"]
    assert a.max() > 0.1
    np.testing.assert_allclose(a, b, atol=2e-4)
    np.testing.assert_allclose(g.transformed(T).velocity, g.velocity @ T[:3, :3].T, atol=1e-5)
    mirrored = T.copy()
    mirrored[:3, 0] *= -1
    with pytest.raises(GofError, match="similarity"):
        g.transformed(mirrored)
