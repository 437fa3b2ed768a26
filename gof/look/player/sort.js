"use strict";

// Runs in a worker: who can be seen at a time, from the farthest to the nearest. A counting sort of 65536 depths.

const LEVELS = 65536;
const LEAST_ALPHA = 1 / 255;
const NEAR_M = 0.01;
let clouds = [];

onmessage = ({ data }) => {
  if (data.clouds) {
    clouds = data.clouds.map((cloud) => ({ ...cloud, depth: new Float32Array(cloud.t_mu.length) }));
    return;
  }
  const began = performance.now();
  const orders = data.shown.map((number) => order(clouds[number], data.time, data.eye, data.forward));
  const answer = { orders, ms: performance.now() - began };
  postMessage(answer, orders.map((rows) => rows.buffer));
};

function order({ x0, v, t_mu, t_sigma, opacity, depth }, time, eye, forward) {
  const count = t_mu.length;
  const seen = new Uint32Array(count);
  let shown = 0;
  let nearest = Infinity;
  let farthest = -Infinity;
  for (let i = 0; i < count; i++) {
    const late = time - t_mu[i];
    const z = late / t_sigma[i]; // 0 where it is always on
    if (opacity[i] * Math.exp(-0.5 * z * z) < LEAST_ALPHA) continue;
    const k = 3 * i;
    const far =
      (x0[k] + late * v[k] - eye[0]) * forward[0] +
      (x0[k + 1] + late * v[k + 1] - eye[1]) * forward[1] +
      (x0[k + 2] + late * v[k + 2] - eye[2]) * forward[2];
    if (!(far > NEAR_M)) continue;
    depth[shown] = far;
    seen[shown++] = i;
    if (far < nearest) nearest = far;
    if (far > farthest) farthest = far;
  }
  const perMetre = (LEVELS - 1) / Math.max(farthest - nearest, 1e-9);
  const starts = new Uint32Array(LEVELS + 1);
  const level = new Uint16Array(shown);
  for (let i = 0; i < shown; i++) {
    level[i] = (farthest - depth[i]) * perMetre;
    starts[level[i] + 1]++;
  }
  for (let i = 1; i <= LEVELS; i++) starts[i] += starts[i - 1];
  const sorted = new Uint32Array(shown);
  for (let i = 0; i < shown; i++) sorted[starts[level[i]]++] = seen[i];
  return sorted;
}
