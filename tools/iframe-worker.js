// Search in pages that were opened from a disk. Browsers start no worker there, so the theme's search worker runs in a
// hidden frame instead: the same script, with the two ends of postMessage tied together by hand. The theme's plugin
// "offline" wants such a script, and would have every page fetch one from a server that is not ours.
"use strict";

if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame); // about:blank, of the page's own origin
      this.inside = frame.contentWindow;
      this.inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.inside.importScripts = (...more) =>
        more.reduce((before, one) => before.then(() => this.load(one)), Promise.resolve());
      this.ready = this.load(address);
    }

    load(address) {
      return new Promise((done, failed) => {
        const script = this.inside.document.createElement("script");
        script.src = new URL(address, location.href).href;
        script.onload = done;
        script.onerror = () => failed(new Error(`${address} cannot be read`));
        this.inside.document.body.append(script);
      });
    }

    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
    }

    set onmessage(heard) {
      this.addEventListener("message", heard);
    }

    terminate() {
      this.inside.frameElement.remove();
    }
  };
}
