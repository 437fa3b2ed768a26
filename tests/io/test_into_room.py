"""A flame in a foreign room: where it stands, how its light falls, and what of that each format holds.

Expected values are worked out here from the formula's text, with the sRGB curve of IEC 61966-2-1 written down again.
"""

import importlib.util
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.commands.convert import main
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.shining import shining_at
from gof.core.trajectory import Trajectory
from gof.io.importers import read_result
from gof.io.into_room import ALBEDO, put_into_room, read_room
from gof.render import render
from tests.conftest import look_at, random_gaussians
from tests.io.test_gltf import parse
from tests.io.test_usd import parsed
from tests.plys import read_ply, write_ply

WIDTH, ALPHA, COLOUR = 0.05, 0.4, (0.9, 0.5, 0.1)  # of the one Gaussian that is the flame
MU, SIGMA = 0.2, 0.05


def to_linear(x):
    return x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4


def to_display(x):
    return 12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055


def lit_by_hand(base, distance, channel, alpha=ALPHA, light=1.0, scale=1.0, usual=None):
    """A splat's display colour at a distance, in the room's units, from the one Gaussian.

    The room's usual splat shows `usual`, linear; without it, as this one.
    """
    width = WIDTH * scale
    power = to_linear(COLOUR[channel]) * -math.log(1 - alpha) * 2 * math.pi * width**2
    power *= ALBEDO[channel] / (to_linear(base) if usual is None else usual)
    extra = light * power / (math.pi * (distance**2 + 3 * width**2))
    return to_display(min(to_linear(base) * (1 + extra), 1))


def flame(**changes):
    """One round Gaussian that rises, drifts and flares up once."""
    values = {
        "position": [[0.3, -0.2, 1.0]],
        "velocity": [[0.0, 0.0, 0.0]],
        "t_mu": [MU],
        "t_sigma": [SIGMA],
        "scale": [[WIDTH] * 3],
        "rotation": [[1, 0, 0, 0]],
        "opacity": [ALPHA],
        "color": [COLOUR],
        "dynamic": [True],
    }
    return TransientGaussians(**{name: np.array(value) for name, value in (values | changes).items()})


def room(path, places, colours, rest=None, **columns):
    """A plain 3DGS PLY of small opaque splats; `rest` (N, 3 (K - 1)) are the higher harmonics, channel-major."""
    n = len(places)
    kinds = {**{axis: np.array(places, float)[:, i] for i, axis in enumerate("xyz")}}
    kinds |= {f"f_dc_{c}": (np.array(colours, float)[:, c] - 0.5) / C0 for c in range(3)}
    kinds |= {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])} if rest is not None else {}
    kinds |= {"opacity": np.full(n, 5.0)} | {f"scale_{i}": np.full(n, np.log(0.01)) for i in range(3)}
    kinds |= {f"rot_{i}": np.full(n, float(i == 0)) for i in range(4)} | columns
    vertex = np.zeros(n, [(name, "<f4") for name in kinds])
    for name, values in kinds.items():
        vertex[name] = values
    return write_ply(path, vertex)


def place(folder, **keys):
    path = folder / "place.json"
    path.write_text(json.dumps({"room": "room.ply"} | keys))
    return path


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_a_splat_at_a_known_distance(tmp_path, scale):
    """The flame's one Gaussian stands in the origin; 3-4-5 triangles and a splat in the flame's own middle."""
    places, colours = [[3, 0, 4], [0, 0, -0.5], [0, 0, 0]], [[0.2, 0.5, 0.8], [0.5, 0.5, 0.5], [0.1, 0.1, 0.1]]
    room(tmp_path / "room.ply", places, colours)
    standing = put_into_room(flame(), place(tmp_path, scale=scale, light=300.0))
    lit, note = standing.lit([MU])
    changed = 0
    for n, distance in enumerate((5.0, 0.5, 0.0)):
        usual = sum(map(to_linear, (0.2, 0.5, 0.8))) / 3  # brighter than both greys
        usual = sorted([usual, to_linear(0.5), to_linear(0.1)])[1]
        expected = [lit_by_hand(colours[n][c], distance, c, light=300.0, scale=scale, usual=usual) for c in range(3)]
        np.testing.assert_allclose(lit.color[n], expected, atol=2e-6)
        changed += max(np.subtract(expected, colours[n])) >= 1 / 255
    assert lit.color[1, 0] > colours[1][0] + 0.1, "the light is seen at all"
    np.testing.assert_allclose(lit.position, np.array([*places, [0, 0, 0]]) / scale, atol=1e-6)
    np.testing.assert_allclose(lit.scale, [[0.01 / scale] * 3] * 3 + [[WIDTH] * 3], rtol=1e-5)
    np.testing.assert_allclose(standing.size, math.sqrt(3) * WIDTH, rtol=1e-6)
    assert f"changes {changed} of the room's 3 splats" in note


def test_the_light_is_what_a_camera_sees_of_the_flame(tmp_path):
    """A flame's picture from r away: its linear values times the solid angle of a pixel are P / r^2.

    But for two things that are known: the renderer draws alpha, not the thickness, and nothing fainter than 1/255; over
    a Gaussian's picture that leaves (alpha - 1/255) of -log(1 - alpha).
    """
    alpha, r, focal = 0.1, 4.0, 800.0
    g = flame(opacity=[alpha])
    camera = look_at("front", [0.3, -0.2 - r, 1.0], [0.3, -0.2, 1.0], width=161, height=161, focal_px=focal)
    seen = render(g, camera, MU)["alpha"].astype(np.float64).sum() / focal**2  # a pixel's angle, near the middle
    seen *= -math.log(1 - alpha) / (alpha - 1 / 255)
    room(tmp_path / "room.ply", [[9, 9, 9]], [[0.5] * 3])
    _, power = put_into_room(g, tmp_path / "room.ply")._lamp(MU)
    np.testing.assert_allclose(power / r**2, [to_linear(c) * seen for c in COLOUR], rtol=0.005)


def test_turn_scale_and_up(tmp_path):
    """By hand: a quarter turn takes +x to +y; a room with Y down is laid upright, in metres, with its origin kept."""
    room(tmp_path / "room.ply", [[1, 2, 3]], [[0.5] * 3])
    g = flame(velocity=[[1.0, 0, 2.0]], gas_velocity=[[0, 3.0, 0]], velocity_sd=[0.5], scale=[[0.1, 0.2, 0.3]])
    straight, turned = ([1, 0, 2], [0, 3, 0]), ([0, 1, 2], [-3, 0, 0])
    cases = [
        ({}, straight, [1, 2, 3], [7, 8, 9]),
        ({"turn_deg": 90}, turned, [1, 2, 3], [7, 8, 9]),
        ({"up": [0, -1, 0]}, straight, [1, 3, -2], [7, 9, -8]),
        ({"up": [0, -5, 0], "turn_deg": 90}, turned, [1, 3, -2], [7, 9, -8]),
        ({"up": [0, 0, -1]}, straight, [1, -2, -3], [7, -8, -9]),
        ({"up": [1, 0, 0]}, straight, [-3, 2, 1], [-9, 8, 7]),
    ]
    for keys, (light, gas), wall, foot in cases:
        standing = put_into_room(g, place(tmp_path, scale=4.0, at=[7, 8, 9], start_s=1.5, **keys))
        np.testing.assert_allclose(standing.room.position, [np.divide(wall, 4)], atol=1e-6, err_msg=str(keys))
        placed = standing.flame
        np.testing.assert_allclose(placed.velocity, [light], atol=1e-6, err_msg=str(keys))
        np.testing.assert_allclose(placed.gas_velocity, [gas], atol=1e-6)
        np.testing.assert_allclose(placed.at(MU + 1.5)[0], [np.divide(foot, 4)], atol=1e-5)
        np.testing.assert_allclose(placed.velocity_sd, 0.5, rtol=1e-6)
        np.testing.assert_allclose(placed.scale, [[0.1, 0.2, 0.3]], rtol=1e-5)
        np.testing.assert_allclose(placed.t_mu, MU + 1.5, rtol=1e-6)


def test_a_column_stands_on_its_foot_and_not_on_a_stray_one(tmp_path):
    """50 equal Gaussians from 1 m up; a faint one below, a bright one beside the column's top."""
    n = 52
    position = np.column_stack([np.full(n, 2.0), np.full(n, -1.0), 1 + 0.02 * np.arange(n)])
    position[50], position[51] = [2, -1, -5], [4, -1, 1.9]
    opacity = np.where(np.arange(n) == 50, 0.004, 0.5)
    many = {name: np.repeat(values, n, 0) for name, values in flame().arrays().items()}
    g = TransientGaussians(**many | {"position": position, "opacity": opacity, "t_sigma": np.full(n, np.inf)})
    room(tmp_path / "room.ply", [[0, 0, 0]], [[0.5] * 3])
    standing = put_into_room(g, tmp_path / "room.ply")
    np.testing.assert_allclose(standing.flame.position[0], [0, 0, 0], atol=1e-6)
    assert "foot stands at (0, 0, 0) of room.ply" in standing.notes[0] and "JSON" in standing.notes[0]


def test_harmonics_stay_and_colours_keep_their_bounds(tmp_path):
    """Nothing goes beyond white, and what lies outside [0, 1] already stays; only the constant harmonic changes."""
    rest = np.random.default_rng(0).normal(0, 0.1, (4, 9))
    colours = [[0.4] * 3, [1.0] * 3, [1.3] * 3, [-0.1] * 3]
    room(tmp_path / "room.ply", [[0.2, 0, 0]] * 4, colours, rest)
    standing = put_into_room(flame(), place(tmp_path, light=1e9))
    lit, _ = standing.lit([MU])
    assert lit.color.shape == (5, 4, 3)
    np.testing.assert_array_equal(lit.color[:4, 1:], rest.astype(np.float32).reshape(4, 3, 3).transpose(0, 2, 1))
    np.testing.assert_allclose(0.5 + C0 * lit.color[:4, 0], [[1.0] * 3, *colours[1:]], atol=2e-6)
    np.testing.assert_allclose(lit.color[4], [(np.array(COLOUR) - 0.5) / C0, *np.zeros((3, 3))], atol=1e-6)
    with_harmonics = put_into_room(random_gaussians(30, sh_coefficients=16), place(tmp_path))
    assert with_harmonics.lit([0.3])[0].color.shape == (4 + len(with_harmonics.flame), 16, 3)


def test_units_do_not_matter(tmp_path):
    """The same room three times as large, lying on its side, turned and moved: the same light on it."""
    g = random_gaussians(60)
    places, colours = np.random.default_rng(1).normal(0, 1, (50, 3)), np.random.default_rng(2).random((50, 3))
    room(tmp_path / "room.ply", places, colours)
    one = put_into_room(g, place(tmp_path, light=20.0)).lit([0.4])[0]
    turn = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])  # a quarter about z, then z goes to -y
    room(tmp_path / "room.ply", 3 * places @ turn.T + [5, 6, 7], colours)
    keys = {"at": [5, 6, 7], "scale": 3.0, "turn_deg": 90, "up": [0, -1, 0], "light": 20.0}
    other = put_into_room(g, place(tmp_path, **keys)).lit([0.4])[0]
    assert np.abs(one.color[:50] - colours).max() > 0.05
    np.testing.assert_allclose(other.color, one.color, atol=1e-5)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # laid upright, (5, 6, 7) / 3 is (5, 7, -6) / 3
    np.testing.assert_allclose(other.position, one.position @ quarter.T + np.array([5, 7, -6]) / 3, atol=1e-5)


@pytest.mark.parametrize("name", ["lit.npz", "lit.ply"])
def test_one_file_holds_both_in_the_mean_light(tmp_path, capsys, name):
    """The room first, still and endless; the flame's velocities are not touched. The mean is over 32 instants."""
    room(tmp_path / "room.ply", [[0, 0.4, 0], [0, 0.8, 0]], [[0.4] * 3, [0.6] * 3])
    n = 5  # one after another, 20 ms apart: a lamp that flickers
    many = {key: np.repeat(values, n, 0) for key, values in flame(velocity=[[0.0, 0, 0.0]]).arrays().items()}
    TransientGaussians(**many | {"t_mu": MU + 0.02 * np.arange(n), "t_sigma": np.full(n, 0.01)}).save(
        tmp_path / "f.npz"
    )
    into = place(tmp_path, light=8.0)
    assert main([str(tmp_path / "f.npz"), str(tmp_path / name), "--into", str(into)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "its mean is written" in said and "flickers between" in said and "light 8" in said
    back = read_result(tmp_path / name).gaussians
    assert back.dynamic.tolist() == [False] * 2 + [True] * n and np.isinf(back.t_sigma[:2]).all()
    np.testing.assert_allclose(back.at(1e6)[0][:2], [[0, 0.4, 0], [0, 0.8, 0]], atol=1e-6)
    np.testing.assert_array_equal(back.velocity, 0)
    first, last = MU + 0.05 * 0.08, MU + 0.95 * 0.08  # quantiles of five even times
    extra = np.zeros(2)
    for t in first + (last - first) * (np.arange(32) + 0.5) / 32:
        alphas = [ALPHA * math.exp(-0.5 * ((t - MU - 0.02 * k) / 0.01) ** 2) for k in range(n)]
        thick = sum(-math.log(1 - a) for a in alphas if a >= 1 / 255)
        extra += 8 * thick * 2 * WIDTH**2 / (np.array([0.16, 0.64]) + 3 * WIDTH**2) / 32
    usual = (to_linear(0.4) + to_linear(0.6)) / 2
    for c in range(3):
        lamp = to_linear(COLOUR[c]) * ALBEDO[c] / usual
        expected = [to_display(to_linear(b) * (1 + lamp * e)) for b, e in zip((0.4, 0.6), extra, strict=True)]
        np.testing.assert_allclose(back.color[:2, c], expected, atol=1e-5)


def test_frames_hold_each_its_own_light(tmp_path):
    """A folder of PLYs, USD as text, and the instant of a GLB: the light of that moment, by the closed form."""
    base, distance = 0.3, 0.5
    room(tmp_path / "room.ply", [[0, distance, 0]], [[base] * 3])
    flame().save(tmp_path / "f.npz")
    into = ["--into", str(place(tmp_path, light=20.0))]
    clip = ["--clip", "0.1", "0.3", "--frame-time", "0.05", *into]
    assert main([str(tmp_path / "f.npz"), str(tmp_path / "frames"), *clip]) == 0
    assert main([str(tmp_path / "f.npz"), str(tmp_path / "a.usda"), *clip]) == 0
    usd = parsed(tmp_path / "a.usda")[1]["radiance:sphericalHarmonicsCoefficients.timeSamples"]
    assert sorted(usd) == list(range(5))
    seen = []
    for k in range(5):
        alpha = ALPHA * math.exp(-0.5 * ((0.1 + 0.05 * k - MU) / SIGMA) ** 2)
        expected = [(lit_by_hand(base, distance, c, alpha, 20.0) - 0.5) / C0 for c in range(3)]
        vertex, _ = read_ply(tmp_path / f"frames/frame{k:05d}.ply")
        np.testing.assert_allclose([vertex[f"f_dc_{c}"][0] for c in range(3)], expected, atol=1e-5)
        np.testing.assert_allclose(usd[k][0], expected, atol=1e-5)
        np.testing.assert_allclose(usd[k][1], (np.array(COLOUR) - 0.5) / C0, atol=1e-5)
        seen.append(expected[0])
    assert seen[2] > max(seen[0], seen[4]) + 0.1
    assert main([str(tmp_path / "f.npz"), str(tmp_path / "a.glb"), "--time", "0.25", *into]) == 0
    _, attributes = parse((tmp_path / "a.glb").read_bytes())
    expected = (lit_by_hand(base, distance, 0, ALPHA * math.exp(-0.5), 20.0) - 0.5) / C0
    assert attributes["KHR_gaussian_splatting:SH_DEGREE_0_COEF_0"][0, 0] == pytest.approx(expected, abs=1e-5)


@pytest.mark.skipif(importlib.util.find_spec("pxr") is None, reason="OpenUSD's library is not installed")
def test_a_usdc_is_read_back(tmp_path, capsys):
    room(tmp_path / "room.ply", [[0, 0.5, 0], [0, 1, 0]], [[0.3] * 3] * 2)
    flame().save(tmp_path / "f.npz")
    clip = ["--clip", "0.1", "0.3", "--frame-time", "0.05", "--into", str(place(tmp_path, light=20.0))]
    assert main([str(tmp_path / "f.npz"), str(tmp_path / "a.usdc"), *clip]) == 0
    back = read_result(tmp_path / "a.usdc").gaussians
    assert back.dynamic.tolist() == [False, False, True]
    assert back.color[0, 0] == pytest.approx(lit_by_hand(0.3, 0.5, 0, ALPHA * math.exp(-2), 20.0), abs=1e-5)
    assert "pictures from the front agree" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("name", ["a.4dgs", "a.tsog", "a.dgs", "a.ftgs.ply"])
def test_small_files_that_move_hold_the_room(tmp_path, name):
    """Still in the middle of a flame that moves, in the mean light of the stated clip; within the formats' steps."""
    room(tmp_path / "room.ply", [[0, 0.5, 0.1], [0.2, 1, 0]], [[0.3] * 3, [0.5] * 3])
    flame(velocity=[[0.0, 0, 0.0]]).save(tmp_path / "f.npz")
    into = place(tmp_path, light=200.0)
    assert main([str(tmp_path / "f.npz"), str(tmp_path / name), "--clip", "0.15", "0.25", "--into", str(into)]) == 0
    back = read_result(tmp_path / name).gaussians
    lit, _ = put_into_room(flame(), into).lit(0.15 + 0.1 * (np.arange(32) + 0.5) / 32)
    assert lit.color[0, 0] > 0.35
    for n in range(2):
        (row,) = np.flatnonzero(np.linalg.norm(back.at(0.2)[0] - lit.position[n], axis=1) < 0.01)
        color = back.color[row] if back.color.ndim == 2 else 0.5 + C0 * back.color[row, 0]
        np.testing.assert_allclose(color, lit.color[n], atol=0.006)
        assert back[[row]].at(0.15)[1] == pytest.approx(back[[row]].at(0.25)[1], abs=1e-3)


def test_a_room_is_lit_by_how_bright_it_is(tmp_path):
    """A tenth of its own light, and the flame is ten times as bright beside it; of a black one nothing is known."""
    gains = []
    for light in (1.0, 0.1):
        grey = to_display(light * to_linear(0.5))
        room(tmp_path / "room.ply", [[0, 0.5, 0]] * 3, [[grey] * 3] * 3)
        lit, _ = put_into_room(flame(), tmp_path / "room.ply").lit([MU])
        gains.append([to_linear(c) - to_linear(grey) for c in lit.color[0]])
    np.testing.assert_allclose(gains[1], gains[0], rtol=0.01)
    room(tmp_path / "room.ply", [[0, 0.5, 0]] * 3, [[0.0] * 3] * 2 + [[0.02] * 3])
    lit, _ = put_into_room(flame(), tmp_path / "room.ply").lit([MU])
    assert np.isfinite(lit.color).all() and np.abs(lit.color[:2]).max() < 1e-6 and 0.02 < lit.color[2, 0] < 0.2


def test_a_flame_without_light_and_a_light_of_0_change_nothing(tmp_path):
    room(tmp_path / "room.ply", [[0, 0.5, 0]], [[0.3] * 3])
    for g, keys in ((flame(color=[[0.0, -0.1, 0.0]]), {}), (flame(), {"light": 0.0})):
        standing = put_into_room(g, place(tmp_path, **keys))
        lit, note = standing.lit([MU])
        np.testing.assert_array_equal(lit.color[0], read_room(tmp_path / "room.ply").color[0, 0] * C0 + 0.5)
        assert "no light" in note and np.isfinite(lit.position).all()
    assert not len(shining_at(flame(), MU + 100).rows), "and long after it has burnt"
    dark, _ = put_into_room(flame(), place(tmp_path)).lit([MU + 100])
    assert dark.color[0, 0] == pytest.approx(0.3, abs=1e-6)


def test_still_gaussians_of_a_result_are_a_room_and_are_left_out_of_a_flame(tmp_path):
    g = random_gaussians(40)
    g.save(tmp_path / "room.ply")
    g.save(tmp_path / "room.npz")
    for name in ("room.ply", "room.npz"):
        standing = put_into_room(g, tmp_path / name)
        np.testing.assert_allclose(standing.room.position, g.position[~g.dynamic], atol=1e-6)
        assert len(standing.flame) == g.dynamic.sum() and "left out" in standing.notes[1]


WRONG = {
    '{"room": "room.ply", "hight": 2}': "place.json: hight is not a field; known: at, light, room, scale",
    '{"room": "room.ply", "scale": 0}': "place.json: scale must be above 0",
    '{"room": "room.ply", "light": -1}': "place.json: light must be 0 or more",
    '{"room": "room.ply", "up": [0, 0, 0]}': "place.json: up must be a direction",
    '{"room": "room.ply", "at": [0, 0]}': "place.json: at must be 3 numbers",
    '{"room": "room.ply", "turn_deg": NaN}': "place.json",
    '{"at": [0, 0, 0]}': "place.json: room is missing",
    '{"room": "other.ply"}': "other.ply: no such file, which .*place.json names",
    '{"room": "place.json"}': "place.json: a room is a .ply",
    "[]": "place.json: not a JSON object",
    "{": "place.json",
}


@pytest.mark.parametrize("text", WRONG)
def test_wrong_placements_name_file_and_key(tmp_path, text):
    room(tmp_path / "room.ply", [[0, 0, 0]], [[0.5] * 3])
    (tmp_path / "place.json").write_text(text)
    with pytest.raises(DataFormatError, match=WRONG[text]):
        put_into_room(flame(), tmp_path / "place.json")


@pytest.mark.parametrize(
    "keys, match",
    [
        ({"scale": 1e80}, "place.json: the flame cannot stand there"),
        ({"scale": 1e-60}, "place.json: the flame cannot stand there"),
        ({"at": [1e6, 0, 0]}, "place.json: the placed flame's world reaches 1e\\+06"),
        ({"start_s": 1.7e9}, "place.json: the placed flame's clock reaches"),
    ],
)
def test_places_that_float32_cannot_hold_are_refused(tmp_path, keys, match):
    room(tmp_path / "room.ply", [[0, 0, 0]], [[0.5] * 3])
    with pytest.raises(GofError, match=match):
        put_into_room(flame(scale=[[0.01] * 3]), place(tmp_path, **keys))


def test_what_is_no_room_is_refused(tmp_path):
    for name, match in (("absent.ply", "no such file"), ("room.obj", "--into takes the PLY of a room")):
        with pytest.raises(DataFormatError, match=match):
            put_into_room(flame(), tmp_path / name)
    flame().save(tmp_path / "flame.ply")
    with pytest.raises(DataFormatError, match="flame.ply: holds no still Gaussian"):
        put_into_room(flame(), tmp_path / "flame.ply")
    room(tmp_path / "room.ply", [[0, 0, np.nan]], [[0.5] * 3])
    with pytest.raises(DataFormatError, match="room.ply: 'position' must be finite"):
        put_into_room(flame(), tmp_path / "room.ply")
    room(tmp_path / "room.ply", [[0, 0, 0]], [[0.5] * 3], filter_3D=np.ones(1))
    with pytest.raises(DataFormatError, match="filter_3D"):
        put_into_room(flame(), tmp_path / "room.ply")
    room(tmp_path / "room.ply", np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(DataFormatError, match="room.ply: holds no splat"):
        put_into_room(flame(), tmp_path / "room.ply")
    room(tmp_path / "room.ply", [[0, 0, 0]], [[0.5] * 3])
    with pytest.raises(DataFormatError, match="no moving Gaussian"):
        put_into_room(replace(flame(), dynamic=np.zeros(1, bool)), tmp_path / "room.ply")


def test_the_command_refuses_what_cannot_be(tmp_path, capsys):
    room(tmp_path / "room.ply", [[0, 0, 0]], [[0.5] * 3])
    Trajectory(np.arange(3) * 0.1, np.zeros((3, 2, 3)), np.ones((3, 2)), np.ones((2, 3)), np.ones((2, 4))).save(
        tmp_path / "t.npz"
    )
    flame().save(tmp_path / "f.npz")
    into = ["--into", str(tmp_path / "room.ply")]
    with pytest.raises(DataFormatError, match="leave out --into"):
        main([str(tmp_path / "t.npz"), str(tmp_path / "u.npz"), *into])
    with pytest.raises(GofError, match="--into are for a file that is written"):
        main([str(tmp_path / "f.npz"), "--time-unit", "1", *into])
    assert gof(["convert", str(tmp_path / "f.npz"), str(tmp_path / "u.npz"), "--into", str(tmp_path / "no.ply")]) == 1
    assert "no.ply: no such file" in capsys.readouterr().err
