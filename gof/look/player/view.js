"use strict";

// Where one looks from. A view has an eye (m), three axes in the world (right, down, forward: OpenCV's), a pivot that it
// turns about (m), and the lens of one of the page's cameras.

const add = (a, b, times = 1) => a.map((value, i) => value + times * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((value) => value / Math.hypot(...a));
const STEEPEST = (85 * Math.PI) / 180;

function cameraView(camera, pivot) {
  const p = camera.pose; // rows of world to camera
  const axes = [p.slice(0, 3), p.slice(4, 7), p.slice(8, 11)];
  let eye = [0, 0, 0];
  axes.forEach((axis, i) => (eye = add(eye, axis, -p[4 * i + 3])));
  return { eye, axes, pivot: [...pivot], camera };
}

/** Rodrigues' formula: v turned about a unit axis. */
function turned(v, axis, angle) {
  const out = v.map((value) => value * Math.cos(angle));
  return add(add(out, cross(axis, v), Math.sin(angle)), axis, dot(axis, v) * (1 - Math.cos(angle)));
}

/** Around the pivot: yaw about the world's vertical, then up or down, not over the poles. Angles in radians. */
function orbited(view, yaw, pitch) {
  const steep = Math.asin(Math.max(-1, Math.min(1, view.axes[2][2])));
  const up = Math.max(-STEEPEST, Math.min(STEEPEST, steep + pitch)) - steep;
  const both = (v) => turned(turned(v, view.axes[0], up), [0, 0, 1], yaw);
  return { ...view, axes: view.axes.map(both), eye: add(view.pivot, both(add(view.eye, view.pivot, -1))) };
}

/** Sideways by shares of the distance between eye and pivot. */
function panned(view, right, down) {
  const move = add(view.axes[0].map((v) => v * right * reach(view)), view.axes[1], down * reach(view));
  return { ...view, eye: add(view.eye, move), pivot: add(view.pivot, move) };
}

/** Nearer to the pivot (factor below 1) or farther. */
function dollied(view, factor, home) {
  const now = reach(view);
  const then = Math.max(0.05 * home, Math.min(20 * home, now * factor));
  return { ...view, eye: add(view.pivot, add(view.eye, view.pivot, -1), then / now) };
}

function reach(view) {
  return Math.max(Math.hypot(...add(view.eye, view.pivot, -1)), 1e-6);
}

/**
 * How the view's lens draws into a pane of width x height pixels: its picture whole, in the middle. enlarged: pixels of the
 * pane, at most, to a pixel of the recorded pictures.
 */
function lensIn(camera, width, height, enlarged = Infinity) {
  const most = enlarged * ((camera.picture_width ?? camera.width) / camera.width);
  const scale = Math.min(width / camera.width, height / camera.height, most);
  const [fx, skew, cx, fy, cy] = camera.K.map((value) => value * scale);
  const left = (width - scale * camera.width) / 2;
  const top = (height - scale * camera.height) / 2;
  const picture = [left, top, scale * camera.width, scale * camera.height];
  return { focal: [fx, fy], centre: [cx + left, cy + top], skew, picture };
}

function viewToText(view) {
  return [...view.eye, ...view.axes[0], ...view.axes[2], ...view.pivot].map((v) => +v.toFixed(4)).join("_");
}

/** Null where the text is no view. */
function viewFromText(text, camera) {
  const n = text.split("_").map(Number);
  if (n.length !== 12 || !n.every(Number.isFinite)) return null;
  const forward = unit(n.slice(6, 9));
  const down = unit(cross(forward, n.slice(3, 6)));
  const axes = [cross(down, forward), down, forward];
  if (!axes.flat().every(Number.isFinite)) return null;
  return { eye: n.slice(0, 3), axes, pivot: n.slice(9, 12), camera };
}
