"""Optimising transient flame Gaussians against the training pictures, over the static plates, with Dr.Jit.

Loss (paper): 0.8 L1 + 0.2 (1 - SSIM) + 0.1 mean(A_dyn (1 - M)), one random training picture a step. Every picture is drawn at
its own camera's time, and line by line when that camera has a rolling shutter.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import numpy as np
from drjit.opt import Adam

from gof.cameras import Camera
from gof.errors import NonFiniteError
from gof.gaussians import TransientGaussians
from gof.io.files import atomic_path
from gof.reconstruct.motion import Motion
from gof.reconstruct.seeds import SCALE_MAX, SCALE_MIN
from gof.render import Splats, Target, l1_ssim, render_splats, shutter_delay, transient_state
from gof.render.backend import Array3f, Array4f, Float

SSIM_WEIGHT = 0.2
CHECK_EVERY = 50  # steps between looks at the loss (a synchronisation) and at NaN
CHECKPOINT_EVERY = 500
EVALUATE_AT = (250, 500, 1000, 2000, 4000, 7000, 15_000, 30_000)  # and at the last step; the paper's are 1k, 7k, 30k
OPACITY_EPS = 1e-4  # logits stay finite


@dataclass(frozen=True)
class Schedule:
    """Step counts, learning rates and loss weights.

    Lengths are in voxels and times in frame times, so that neither the scene's size nor its clock matters.
    """

    iterations: int
    velocity: float  # voxels per frame time
    plate: float  # display values; 0 = the plates stay as they are
    position: tuple[float, float] = (0.03, 0.003)  # voxels, first and last step
    t_mu: float = 0.01  # frame times
    log_t_sigma: float = 0.005
    scale: float = 0.02
    rotation: float = 0.005
    opacity: float = 0.03
    color: float = 0.01
    alpha_loss: float = 0.1


def optimize(
    seeds: TransientGaussians,
    voxel_size: float,
    frame_time_s: float,
    motion: Motion,
    times_s: np.ndarray,
    cameras: list[Camera],
    schedule: Schedule,
    seed: int,
    checkpoint: Path,
    progress: Callable[..., None] = lambda done, total, **_: None,
    evaluate: Callable[[int, TransientGaussians, list[np.ndarray]], float | None] = lambda *_: None,
) -> tuple[TransientGaussians, list[np.ndarray]]:
    """Optimise all parameters of `seeds`.

    Args:
        voxel_size: m, bounds the scale (0.1 to 3 voxels).   frame_time_s: s.
        motion: training pictures (those that were delivered are used), masks and plates.   times_s: (C, F) when each camera took each of them (first line).
        seed: of the order of the pictures.
        checkpoint: file to resume from and to write every 500 steps (removed by the caller when done); a disk too full
            for it is reported and does not end the run.
        progress: called with (done, total, note=...).
        evaluate: called with (step, Gaussians, plates) at EVALUATE_AT and the last step; returns what to show as PSNR, or None.
    Returns:
        the optimised Gaussians, same number and order; and the plates, C x (H, W, 3) display values.
    Raises:
        NonFiniteError: the loss or a parameter became NaN or Inf; names the parameter and the step.
    """
    clock = float(times_s.min())
    raw = _to_raw(seeds, voxel_size, clock)
    rates = {
        "x0": schedule.position[0] * voxel_size,
        "velocity": schedule.velocity * voxel_size / frame_time_s,
        "t_mu": schedule.t_mu * frame_time_s,
        "log_t_sigma": schedule.log_t_sigma,
        "scale": schedule.scale,
        "rotation": schedule.rotation,
        "opacity": schedule.opacity,
        "color": schedule.color,
    }
    plates = {f"plate_{c}": _columns(plate.reshape(-1, 3)) for c, plate in enumerate(motion.plate)}
    if schedule.plate > 0:
        raw |= plates
        rates |= dict.fromkeys(plates, schedule.plate)
    # The loss is a mean over pixels, so gradients are tiny: epsilon must not be what sets the step.
    optimizer = Adam(lr=1.0, params=raw, beta_2=0.99, epsilon=1e-15, mask_updates=True)
    optimizer.set_learning_rate(rates)
    start = _load_checkpoint(checkpoint, optimizer)

    def state() -> tuple[TransientGaussians, list[np.ndarray]]:
        shown = [optimizer[name] if schedule.plate > 0 else plates[name] for name in plates]
        images = [_rows(x).reshape(plate.shape) for x, plate in zip(shown, motion.plate, strict=True)]
        return _from_raw(optimizer, voxel_size, clock), images

    targets, outside = {}, {}
    usable = np.argwhere(motion.delivered)
    epoch, order, mean_loss, psnr = -1, usable, None, None
    decay = (schedule.position[1] / schedule.position[0]) ** (1 / max(schedule.iterations, 1))
    for step in range(start, schedule.iterations):
        if step // len(usable) != epoch:  # every picture once, in an order of its own, the same when resumed
            epoch = step // len(usable)
            order = np.random.default_rng((seed, epoch)).permutation(usable)
        f, c = order[step % len(usable)].tolist()
        if (f, c) not in targets:
            targets[f, c] = Target(motion.image[f, c])
            outside[f, c] = Float(np.ascontiguousarray(~motion.mask[f, c].ravel(), np.float32))
        optimizer.set_learning_rate({"x0": rates["x0"] * decay**step})
        splats = activate(optimizer, voxel_size, float(times_s[c, f]) - clock, cameras[c])
        plate = (optimizer if schedule.plate > 0 else plates)[f"plate_{c}"]
        # Nearer than a voxel is no place for a flame Gaussian; the limit follows the unit of length.
        frame = render_splats(splats, cameras[c], background=[plate.x, plate.y, plate.z], near=voxel_size)
        loss = l1_ssim(frame.color, targets[f, c], ssim_weight=SSIM_WEIGHT)
        loss += schedule.alpha_loss * dr.mean(frame.alpha * outside[f, c])
        dr.backward(loss)
        optimizer.step()
        dr.eval(list(optimizer.values()))
        done, last = step + 1, step + 1 == schedule.iterations
        if done in EVALUATE_AT or last:
            _check(float(loss.array[0]), optimizer, step)
            psnr = evaluate(done, *state())
        if done % CHECK_EVERY == 0 or last:
            value = float(loss.array[0])
            _check(value, optimizer, step)
            mean_loss = value if mean_loss is None else 0.8 * mean_loss + 0.2 * value
            quality = "" if psnr is None else f", held-out flame {psnr:.2f} dB"
            progress(done, schedule.iterations, note=f"loss {mean_loss:.4f}{quality}")
        if done % CHECKPOINT_EVERY == 0:
            _save_checkpoint(checkpoint, optimizer, done)
    return state()


def activate(raw, voxel_size: float, time_s: float, camera: Camera) -> Splats:
    """Raw parameters to the splats a camera sees in a frame whose first line it reads at `time_s` (after the clip's start)."""
    t_sigma, opacity, scale, _ = _activations(raw, voxel_size)
    motion = raw["x0"], raw["velocity"], raw["t_mu"], t_sigma, opacity
    position, opacity_t = transient_state(*motion, time_s)
    if camera.row_time_s > 0:
        delay = shutter_delay(position, raw["velocity"], camera, near=voxel_size)
        position, opacity_t = transient_state(*motion, delay + time_s)
    color = raw["color"]
    return Splats(position, raw["rotation"], scale, opacity_t, [color.x, color.y, color.z])


def _activations(raw, voxel_size: float):
    t_sigma = dr.exp(raw["log_t_sigma"])
    opacity = 1 / (1 + dr.exp(-raw["opacity"]))
    # A sigmoid instead of an exponential keeps flame Gaussians small (paper, "Implementation Details").
    scale = voxel_size * (SCALE_MIN + (SCALE_MAX - SCALE_MIN) / (1 + dr.exp(-raw["scale"])))
    return t_sigma, opacity, scale, raw["rotation"]


def _logit(x: np.ndarray) -> np.ndarray:
    x = np.clip(x.astype(np.float64), OPACITY_EPS, 1 - OPACITY_EPS)
    return (np.log(x) - np.log1p(-x)).astype(np.float32)


def _columns(x: np.ndarray) -> Array3f:
    return Array3f(np.ascontiguousarray(x.T, np.float32))


def _rows(x) -> np.ndarray:
    return np.array(dr.detach(x)).T if dr.depth_v(x) > 1 else np.array(dr.detach(x))


def _to_raw(g: TransientGaussians, voxel_size: float, clock: float) -> dict:
    scale = (g.scale / voxel_size - SCALE_MIN) / (SCALE_MAX - SCALE_MIN)
    return {
        "x0": _columns(g.position),
        "velocity": _columns(g.velocity),
        "t_mu": Float(g.t_mu - np.float32(clock)),
        "log_t_sigma": Float(np.log(g.t_sigma)),
        "scale": _columns(_logit(scale)),
        "rotation": Array4f(np.ascontiguousarray(g.rotation.T)),
        "opacity": Float(_logit(g.opacity)),
        "color": _columns(g.color),
    }


def _from_raw(raw, voxel_size: float, clock: float) -> TransientGaussians:
    t_sigma, opacity, scale, rotation = _activations(raw, voxel_size)
    return TransientGaussians(
        position=_rows(raw["x0"]),
        velocity=_rows(raw["velocity"]),
        t_mu=_rows(raw["t_mu"]) + np.float32(clock),
        t_sigma=_rows(t_sigma),
        scale=_rows(scale),
        rotation=_rows(rotation),
        opacity=_rows(opacity),
        color=_rows(raw["color"]),
        dynamic=np.ones(dr.width(raw["t_mu"]), bool),
    )


def _check(loss: float, raw, step: int) -> None:
    bad = [name for name, value in raw.items() if not dr.all(dr.isfinite(dr.detach(value)), axis=None)]
    if bad or not np.isfinite(loss):
        raise NonFiniteError(
            f"step {step}: loss {loss}, NaN or Inf in {bad or 'no parameter'}; lower that parameter's learning rate, "
            "or report this dataset as a bug"
        )


def _save_checkpoint(path: Path, optimizer: Adam, step: int) -> None:
    arrays = {"step": np.array(step)}
    for name in optimizer.keys():
        _, _, _, (t, m, v, _) = optimizer.state[name]
        for label, x in (("value", dr.detach(optimizer[name])), ("m", m), ("v", v)):
            arrays[f"{name}.{label}"] = np.array(x)
        arrays[f"{name}.t"] = np.array(t)
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    try:
        with atomic_path(path) as temporary:
            temporary.write_bytes(packed.getbuffer())
    except OSError as e:
        print(
            f"{path}: no checkpoint at step {step} ({e.strerror or e}); the optimisation goes on, an interruption would "
            "cost what came after the one before",
            file=sys.stderr,
        )


def _load_checkpoint(path: Path, optimizer: Adam) -> int:
    """Put a checkpoint's values and Adam moments into the optimiser; returns the number of steps done (0 = none)."""
    if not path.exists():
        return 0
    with np.load(path, allow_pickle=False) as data:
        for name in list(optimizer.keys()):
            kind = type(dr.detach(optimizer[name]))
            optimizer[name] = kind(data[f"{name}.value"])
            value, promoted, rate, (t, m, v, extra) = optimizer.state[name]
            optimizer.state[name] = (
                value,
                promoted,
                rate,
                (
                    type(t)(data[f"{name}.t"]),
                    type(m)(data[f"{name}.m"]),
                    type(v)(data[f"{name}.v"]),
                    extra,
                ),
            )
        return int(data["step"])
