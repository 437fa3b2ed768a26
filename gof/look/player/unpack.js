"use strict";

// Quantised Gaussians to float32, the twin of gof/look/player/quantise.py.

function bytes(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

/** Columns by name, each a Float32Array with the parts of one Gaussian side by side; rotation as wxyz. */
function unpack(header, data, firstSecond) {
  const columns = {};
  let start = 0;
  for (const column of header.columns) {
    const numbers = header.count * column.parts;
    const kind = { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[column.bytes];
    const code = new kind(data.slice(start, start + numbers * column.bytes).buffer);
    start += numbers * column.bytes;
    columns[column.name] = column.name === "rotation" ? quaternions(code) : values(column, code, header.count);
  }
  const { t_mu } = columns;
  const zero = header.columns.find((column) => column.name === "t_mu").low[0] - firstSecond;
  for (let i = 0; i < header.count; i++) t_mu[i] += zero; // the clip's start is 0, so that float32 has digits left
  return columns;
}

function values(column, code, count) {
  const out = new Float32Array(code.length);
  for (let part = 0; part < column.parts; part++) {
    const low = column.name === "t_mu" ? 0 : column.low[part];
    const step = (column.high[part] - column.low[part]) / column.steps;
    for (let i = 0; i < count; i++) {
      const number = code[part * count + i];
      const value = low + number * step;
      const known = column.infinite && number > column.steps ? Infinity : column.log ? Math.exp(value) : value;
      out[i * column.parts + part] = known;
    }
  }
  return out;
}

/** The largest part's place in two bits, then the three others in turn, ten bits each. */
function quaternions(words) {
  const out = new Float32Array(4 * words.length);
  words.forEach((word, i) => {
    const largest = word >>> 30;
    let rest = 1;
    for (let k = 1; k < 4; k++) {
      const part = (((word >>> (30 - 10 * k)) & 1023) / 1023 - 0.5) * Math.SQRT2;
      out[4 * i + ((largest + k) % 4)] = part;
      rest -= part * part;
    }
    out[4 * i + largest] = Math.sqrt(Math.max(rest, 0));
  });
  return out;
}

/** Six numbers of every symmetric covariance, m²: xx xy xz yy yz zz. */
function covariances(rotation, scale, count) {
  const out = new Float32Array(6 * count);
  for (let i = 0; i < count; i++) {
    const [w, x, y, z] = rotation.subarray(4 * i, 4 * i + 4);
    const [a, b, c] = scale.subarray(3 * i, 3 * i + 3);
    const rows = [
      [a * (1 - 2 * (y * y + z * z)), b * 2 * (x * y - w * z), c * 2 * (x * z + w * y)],
      [a * 2 * (x * y + w * z), b * (1 - 2 * (x * x + z * z)), c * 2 * (y * z - w * x)],
      [a * 2 * (x * z - w * y), b * 2 * (y * z + w * x), c * (1 - 2 * (x * x + y * y))],
    ];
    let k = 6 * i;
    for (let p = 0; p < 3; p++)
      for (let q = p; q < 3; q++) out[k++] = rows[p][0] * rows[q][0] + rows[p][1] * rows[q][1] + rows[p][2] * rows[q][2];
  }
  return out;
}
