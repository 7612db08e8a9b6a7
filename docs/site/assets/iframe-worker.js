"use strict";
// A page that is opened from a file may not start a Web Worker, and the search runs in one. There
// the search's script runs in a hidden frame instead. The site builder's offline plugin looks for a
// file of this name; without it every page would load another one from the network.

if (location.protocol == "file:") {
  /** A Worker whose script runs in a hidden frame of the page. */
  window.Worker = class extends EventTarget {
    /** @param {string} url of the script */
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = "<!DOCTYPE html>";
      this.running = new Promise((resolve, reject) => {
        frame.onload = () => {
          const inside = frame.contentWindow, script = inside.document.createElement("script");
          inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", {data}));
          script.onload = () => resolve(inside);
          script.onerror = reject;
          script.src = url;
          inside.document.head.append(script);
        };
      });
      document.body.append(frame);
    }

    /** Sends the script a message, at the earliest when it has been loaded. */
    postMessage(data) {
      this.running.then(inside => inside.dispatchEvent(new MessageEvent("message", {data})));
    }
  };
}
