"use strict";

// All of WebGL: Gaussians blended from the back to the front into a float picture, and that over what lies behind.

const TEXELS = 7; // of a Gaussian, four numbers each; splat.glsl says which
const BELOW_LINES = 0.5; // shine of Gaussians in false colours, so that lines of the same colours are seen
const ORDER_WIDTH = 1024; // of the texture that says in which order Gaussians are drawn

/** What the shaders read of every Gaussian. */
function texels(columns, count, perLine) {
  const cov = covariances(columns.rotation, columns.scale, count);
  const out = new Float32Array(4 * TEXELS * perLine * Math.max(Math.ceil(count / perLine), 1));
  for (let i = 0; i < count; i++) {
    const o = 4 * TEXELS * i;
    out.set(columns.x0.subarray(3 * i, 3 * i + 3), o);
    out[o + 3] = columns.t_mu[i];
    out.set(columns.v.subarray(3 * i, 3 * i + 3), o + 4);
    out[o + 7] = 1 / columns.t_sigma[i]; // 0: always on
    out.set(cov.subarray(6 * i, 6 * i + 6), o + 8);
    out[o + 14] = columns.opacity[i];
    out[o + 15] = Number.isFinite(columns.v_sd[i]) ? columns.v_sd[i] : -1;
    out.set(columns.rgb.subarray(3 * i, 3 * i + 3), o + 16);
    out.set((columns.v_gas ?? columns.v).subarray(3 * i, 3 * i + 3), o + 20);
    if (columns.v_true) out.set(columns.v_true.subarray(3 * i, 3 * i + 3), o + 24);
  }
  return out;
}

class Drawer {
  /**
   * clouds: columns with their count.   shaders: texts by file name.   scheme: colours 0..255, three a step.
   * Throws an Error that says what this browser lacks.
   */
  constructor(canvas, shaders, clouds, scheme) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    const missing = ["createImageBitmap", "ResizeObserver"].find((name) => !(name in window));
    if (!gl || missing) {
      throw new Error(`This page needs ${missing ?? "WebGL 2"}, which this browser does not offer.`);
    }
    this.gl = gl;
    this.canvas = canvas;
    this.exact = !!(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"));
    const program = (name) => this.program(...shaders[`${name}.glsl`]);
    [this.splat, this.line, this.pane] = ["splat", "line", "pane"].map(program);
    this.perLine = Math.floor(Math.min(gl.getParameter(gl.MAX_TEXTURE_SIZE), 4096) / TEXELS);
    [this.clouds, this.most] = [[], 0];
    this.replace(clouds);
    this.scheme = this.texture(gl.LINEAR);
    const rgba = new Uint8Array(4 * (scheme.length / 3)).map((_, i) => (i % 4 === 3 ? 255 : scheme[3 * (i >> 2) + (i % 4)]));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, rgba.length / 4, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
    this.black = this.texture(gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    this.pictures = new Map(); // pane number -> { bitmap, texture }
    this.blended = this.texture(gl.NEAREST);
    this.frame = gl.createFramebuffer();
    this.none = gl.createVertexArray();
    this.size = [0, 0];
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(`This browser cannot compile the page's shaders: ${gl.getProgramInfoLog(program)}`);
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  texture(filter) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, filter],
      [gl.TEXTURE_MAG_FILTER, filter],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ])
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    return texture;
  }

  cloud(data, count) {
    const { gl, perLine } = this;
    const texture = this.texture(gl.NEAREST);
    const lines = data.length / (4 * TEXELS * perLine);
    if (lines > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error(`This device cannot hold ${count} Gaussians.`);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, TEXELS * perLine, lines, 0, gl.RGBA, gl.FLOAT, data);
    return { texture, order: this.texture(gl.NEAREST), shown: 0 };
  }

  /** Other clouds in the place of those that were drawn. */
  replace(clouds) {
    for (const { texture, order } of this.clouds) for (const old of [texture, order]) this.gl.deleteTexture(old);
    this.clouds = clouds.map(({ columns, count }) => this.cloud(texels(columns, count, this.perLine), count));
    const most = Math.max(...clouds.map(({ count }) => count));
    if (most > this.most || !this.corners) this.corners = this.quads((this.most = most));
  }

  /**
   * Corners of so many quads, two triangles each. One call draws them all: instances of four vertices are slow, above all
   * where a CPU does the work of a GPU.
   */
  quads(count) {
    const { gl } = this;
    const index = new Uint32Array(6 * count);
    for (let i = 0; i < count; i++) index.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 2, 4 * i + 1, 4 * i + 3], 6 * i);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
    return array;
  }

  /** Rows of a cloud that can be seen, farthest first. */
  order(number, rows) {
    const { gl } = this;
    const cloud = this.clouds[number];
    const lines = Math.max(1, Math.ceil(rows.length / ORDER_WIDTH));
    const padded = new Uint32Array(lines * ORDER_WIDTH);
    padded.set(rows);
    gl.bindTexture(gl.TEXTURE_2D, cloud.order);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32UI, ORDER_WIDTH, lines, 0, gl.RED_INTEGER, gl.UNSIGNED_INT, padded);
    cloud.shown = rows.length;
  }

  resize(width, height) {
    const { gl, canvas } = this;
    if (this.size[0] === width && this.size[1] === height) return;
    [canvas.width, canvas.height] = this.size = [width, height];
    gl.bindTexture(gl.TEXTURE_2D, this.blended);
    const [kind, numbers] = this.exact ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    gl.texImage2D(gl.TEXTURE_2D, 0, kind, width, height, 0, gl.RGBA, numbers, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.blended, 0);
  }

  /**
   * shot: view, time (s), grow (factor of sizes), largest and fastest (m/s of the last colour: of Gaussians, of lines), span
   * (s) and thick (px) of lines, enlarged (see lensIn).   panes: rectangle (left, top, width, height, px), part of it that is
   * drawn, cloud (number), splats (whether it is drawn), emissive, colouring, lines ("own", "true" or null), share (of Gaussians with a line), behind (bitmap
   * or null) as the camera `filmed` took it, strength.
   */
  draw(shot, panes) {
    const { gl } = this;
    const height = this.size[1];
    const place = ([x, y, w, h]) => [x, height - y - h, w, h];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.SCISSOR_TEST);
    for (const pane of panes) {
      gl.viewport(...place(pane.rectangle));
      gl.scissor(...place(pane.part));
      if (pane.splats) this.gaussians(this.splat, shot, pane);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    panes.forEach((pane, number) => {
      gl.viewport(...place(pane.rectangle));
      gl.scissor(...place(pane.part));
      gl.disable(gl.BLEND);
      this.composite(pane, number, place(pane.rectangle), shot);
      gl.enable(gl.BLEND);
      if (pane.lines) this.gaussians(this.line, shot, pane);
    });
  }

  gaussians({ program, uniforms }, shot, pane) {
    const { gl } = this;
    const cloud = this.clouds[pane.cloud];
    const [, , width, height] = pane.rectangle;
    const lens = lensIn(shot.view.camera, width, height, shot.enlarged);
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, cloud.texture);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.scheme);
    gl.uniform1i(uniforms.cloud, 0);
    gl.uniform1i(uniforms.scheme, 1);
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, cloud.order);
    gl.uniform1i(uniforms.order, 2);
    gl.uniform1i(uniforms.perLine, this.perLine);
    gl.uniform1f(uniforms.time, shot.time);
    gl.uniform3fv(uniforms.eye, shot.view.eye);
    gl.uniformMatrix3fv(uniforms.axes, false, shot.view.axes.flat());
    gl.uniform2fv(uniforms.focal, lens.focal);
    gl.uniform2fv(uniforms.centre, lens.centre);
    gl.uniform1f(uniforms.skew, lens.skew);
    gl.uniform2f(uniforms.size, width, height);
    if (program === this.splat.program) {
      gl.uniform1f(uniforms.grow, shot.grow);
      gl.uniform1i(uniforms.colouring, pane.colouring);
      gl.uniform1f(uniforms.largest, shot.largest);
    } else {
      gl.uniform1f(uniforms.largest, shot.fastest);
      gl.uniform1f(uniforms.span, shot.span);
      gl.uniform1f(uniforms.share, pane.share);
      gl.uniform1i(uniforms.truth, pane.lines === "true" ? 1 : 0);
      gl.uniform1f(uniforms.thick, shot.thick);
    }
    gl.bindVertexArray(this.corners);
    gl.drawElements(gl.TRIANGLES, 6 * cloud.shown, gl.UNSIGNED_INT, 0);
  }

  composite(pane, number, [left, bottom, width, height], shot) {
    const { gl } = this;
    const { program, uniforms } = this.pane;
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.blended);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, pane.behind ? this.picture(number, pane.behind) : this.black);
    gl.uniform1i(uniforms.blended, 0);
    gl.uniform1i(uniforms.behind, 1);
    gl.uniform1f(uniforms.strength, pane.behind ? pane.strength : 0);
    gl.uniform1i(uniforms.emissive, pane.emissive ? 1 : 0);
    gl.uniform1f(uniforms.shine, pane.lines && pane.colouring ? BELOW_LINES : 1);
    gl.uniform4fv(uniforms.picture, lensIn(pane.filmed, width, height, shot.enlarged).picture);
    gl.uniform2f(uniforms.origin, left, bottom);
    gl.uniform2f(uniforms.size, width, height);
    gl.bindVertexArray(this.none);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** The texture of a pane, filled anew when its picture is another one. */
  picture(number, bitmap) {
    const { gl } = this;
    let known = this.pictures.get(number);
    if (!known) this.pictures.set(number, (known = { texture: this.texture(gl.LINEAR), bitmap: null }));
    gl.bindTexture(gl.TEXTURE_2D, known.texture);
    if (known.bitmap !== bitmap) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
      known.bitmap = bitmap;
    }
    return known.texture;
  }

  /** Wait until the device has drawn everything: reading a pixel cannot be answered before. */
  finish() {
    this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
}
