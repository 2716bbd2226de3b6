// The last minute of four values.

import {m100} from "./shell.js";
import {fit} from "./instruments.js";

class Plot {
  constructor(canvas, label, pick) {
    this.canvas = canvas;
    this.label = label;
    this.pick = pick;
    this.samples = [];
  }

  add(message) {
    const value = this.pick(message);
    this.samples.push([message.t, value === undefined ? null : value]);
    while (this.samples.length && this.samples[0][0] < message.t - 60) this.samples.shift();
  }

  draw() {
    const [g, width, height] = fit(this.canvas);
    const known = this.samples.filter((s) => s[1] !== null);
    const values = known.map((s) => s[1]);
    let low = Math.min(0, ...values), high = Math.max(1, ...values);
    const end = this.samples.length ? this.samples[this.samples.length - 1][0] : 0;
    const x = (t) => width - (end - t) / 60 * width;
    const y = (v) => height - 4 - (v - low) / (high - low) * (height - 20);
    g.strokeStyle = "rgba(128,128,128,.4)";
    g.beginPath(); g.moveTo(0, y(0)); g.lineTo(width, y(0)); g.stroke();
    g.strokeStyle = "#1565c0";
    g.lineWidth = 1.5;
    g.beginPath();
    let isDown = false;
    for (const [t, v] of this.samples) {
      if (v === null) { isDown = false; continue; }
      if (isDown) g.lineTo(x(t), y(v)); else g.moveTo(x(t), y(v));
      isDown = true;
    }
    g.stroke();
    g.fillStyle = "#888";
    g.font = "11px sans-serif";
    const last = this.samples.length ? this.samples[this.samples.length - 1][1] : null;
    g.fillText(`${this.label}: ${last === null ? "–" : last}   (${low.toFixed(1)} … ${high.toFixed(1)})`, 4, 11);
  }
}

const find = (selector) => document.querySelector(selector);
const plots = [
  new Plot(find("#plot-height"), "height, m", (m) => m.pos && m.pos[2]),
  new Plot(find("#plot-speed"), "ground speed, m/s", (m) => m.vel && m.vel[0]),
  new Plot(find("#plot-yaw"), "turn, °/s", (m) => m.yaw_rate),
  new Plot(find("#plot-link"), "telemetry, packages/s", (m) => m.rate),
];
let addedAt = 0;
m100.onLive((live) => {
  if (live.t - addedAt < 0.18) return;
  if (live.t) { addedAt = live.t; plots.forEach((plot) => plot.add(live)); }
  if (document.body.dataset.view === "data") plots.forEach((plot) => plot.draw());
});
