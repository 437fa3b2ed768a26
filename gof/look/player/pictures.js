"use strict";

// The cameras' plates and recorded pictures: decoded when they are shown, and the last ones kept.

const KEPT = 48;

class Pictures {
  constructor(cameras) {
    this.cameras = cameras;
    this.decoded = new Map(); // name -> promise of a bitmap; the oldest first
  }

  plate(camera) {
    return this.bitmap(`plate ${camera}`, this.cameras[camera].plate);
  }

  frame(camera, frame) {
    return this.bitmap(`${camera} ${frame}`, this.cameras[camera].frames?.[frame]);
  }

  async bitmap(name, base64) {
    if (!base64) return null;
    if (!this.decoded.has(name)) {
      const blob = new Blob([bytes(base64)], { type: "image/webp" });
      this.decoded.set(name, createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" }));
      // Forgotten, not closed: it may still be on its way to the screen.
      if (this.decoded.size > KEPT) this.decoded.delete(this.decoded.keys().next().value);
    }
    return this.decoded.get(name);
  }
}
