// The part of the console that must not wait for the server: steering and instruments.
//
// Steering needs the pad to have the focus and a key, a stick or a gamepad's shoulder button to be
// held. While that is so, a beat goes out at once and then every 50 ms. When it ends, for whatever
// reason, a rest goes out; if even that is lost the station stops 300 ms after the last beat.
"use strict";

const BEAT_MS = 50;
const ALIVE_MS = 500;
const LOST_MS = 1000;

const KEYS = {
  KeyW: ["forward", 1], KeyS: ["forward", -1],
  KeyD: ["right", 1], KeyA: ["right", -1],
  KeyE: ["turn", 1], KeyQ: ["turn", -1],
  KeyZ: ["up", 1], KeyC: ["up", -1],
};

// Full deflection at speed level 1. Angles, turn and climb are those of DJI's page of 2015.
const ANGLE_DEG = 2, SPEED_M_S = 0.5, TURN_DEG_S = 6, CLIMB_M_S = 0.3;

class Steering {
  constructor(pad, socket) {
    this.pad = pad;
    this.socket = socket;
    this.held = new Set();
    this.stick = null;
    this.level = 1;
    this.mode = 1;
    this.wasActive = false;
    pad.addEventListener("keydown", (e) => this.keyDown(e));
    pad.addEventListener("keyup", (e) => this.keyUp(e));
    pad.addEventListener("blur", () => this.rest());
    window.addEventListener("blur", () => this.rest());
    window.addEventListener("pagehide", () => this.rest());
    document.addEventListener("visibilitychange", () => document.hidden && this.rest());
    const knob = pad.querySelector(".stick");
    knob.addEventListener("pointerdown", (e) => this.grab(e, knob));
    knob.addEventListener("pointermove", (e) => this.stick && this.move(e, knob));
    pad.addEventListener("contextmenu", () => this.rest());
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"])
      knob.addEventListener(end, () => this.drop(knob));
    setInterval(() => this.tick(), BEAT_MS);
    this.show();
  }

  get hasFocus() {
    return document.hasFocus() && !document.hidden && this.pad.contains(document.activeElement);
  }

  keyDown(event) {
    // While Cmd is held macOS tells no page that a key came up: whatever is held ends here.
    if (event.ctrlKey || event.altKey || event.metaKey) return this.rest();
    if (KEYS[event.code]) {
      event.preventDefault();
      if (event.repeat || this.held.has(event.code)) return;
      this.held.add(event.code);
      this.tick();
    } else if (/^Digit[1-6]$/.test(event.code)) {
      this.level = Number(event.code[5]);
      this.show();
    } else if (event.code === "Digit8" || event.code === "Digit9") {
      this.mode = event.code === "Digit8" ? 1 : 2;
      this.show();
    } else if (event.code === "Escape") {
      this.pad.blur();
    }
  }

  keyUp(event) {
    if (this.held.delete(event.code)) this.tick();
  }

  grab(event, knob) {
    this.pad.focus();
    event.preventDefault();
    knob.setPointerCapture(event.pointerId);
    this.stick = {right: 0, forward: 0};
    this.move(event, knob);
  }

  move(event, knob) {
    const box = knob.getBoundingClientRect();
    const clip = (value) => Math.max(-1, Math.min(1, value));
    this.stick = {
      right: clip((event.clientX - box.left - box.width / 2) / (box.width / 2)),
      forward: clip(-(event.clientY - box.top - box.height / 2) / (box.height / 2)),
    };
    knob.style.setProperty("--right", this.stick.right);
    knob.style.setProperty("--forward", this.stick.forward);
    this.tick();
  }

  drop(knob) {
    if (!this.stick) return;
    this.stick = null;
    knob.style.setProperty("--right", 0);
    knob.style.setProperty("--forward", 0);
    this.tick();
  }

  gamepad() {
    // A shoulder button is the dead man's handle: a stick that drifts moves nothing by itself.
    for (const pad of navigator.getGamepads ? navigator.getGamepads() : []) {
      if (!pad || !pad.connected || pad.axes.length < 4) continue;
      if (!(pad.buttons[4]?.pressed || pad.buttons[5]?.pressed)) continue;
      const dead = (value) => Math.abs(value) < 0.1 ? 0 : value;
      return {
        turn: dead(pad.axes[0]), up: -dead(pad.axes[1]),
        right: dead(pad.axes[2]), forward: -dead(pad.axes[3]),
      };
    }
    return null;
  }

  demand() {
    if (!this.hasFocus) return null;
    const axes = {forward: 0, right: 0, turn: 0, up: 0};
    for (const code of this.held) {
      const [axis, sign] = KEYS[code];
      axes[axis] += sign;
    }
    const gamepad = this.gamepad();
    for (const source of [this.stick, gamepad])
      for (const axis in source) axes[axis] += source[axis];
    if (!this.held.size && !this.stick && !gamepad) return null;
    for (const axis in axes) axes[axis] = Math.max(-1, Math.min(1, axes[axis]));
    return axes;
  }

  tick() {
    const axes = this.demand();
    this.pad.classList.toggle("steering", axes !== null);
    if (axes === null) {
      if (this.wasActive) this.socket.send({op: "rest"});
      this.wasActive = false;
      if (!this.hasFocus) this.held.clear();
      return;
    }
    this.wasActive = true;
    const forward = axes.forward * this.level, right = axes.right * this.level;
    const [x, y] = this.mode === 1
      ? [-ANGLE_DEG * forward, ANGLE_DEG * right]
      : [SPEED_M_S * right, SPEED_M_S * forward];
    const z = TURN_DEG_S * this.level * axes.turn, w = CLIMB_M_S * axes.up;
    this.socket.send({op: "beat", mode: this.mode, x, y, z, w});
  }

  rest() {
    this.held.clear();
    this.stick = null;
    this.tick();
  }

  show() {
    this.pad.querySelector("[data-level]").textContent = this.level;
    this.pad.querySelector("[data-mode]").textContent =
      this.mode === 1 ? "1 (angles, W forward)" : "2 (velocity, W north)";
  }
}

class Socket {
  constructor(path, onMessage) {
    this.path = path;
    this.onMessage = onMessage;
    this.count = 0;
    this.heardAt = 0;
    this.tripMs = null;
    this.forget();
    this.connect();
    setInterval(() => this.send({op: "alive"}), ALIVE_MS);
    setInterval(() => this.watch(), 100);
  }

  forget() {
    this.told = null;  // the station's time that was heard last, and when
    this.live = null;
    this.best = Infinity;  // of the differences between our clock and the station's, the smallest
  }

  connect() {
    this.forget();
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}${this.path}`);
    this.socket.onmessage = (event) => {
      this.heardAt = performance.now();
      const message = JSON.parse(event.data);
      if (message.op === "echo") {
        this.told = {told: message.told, at: performance.now()};
        this.roundTrip(performance.now() - message.at);
      } else {
        // The clocks may drift by a ten-thousandth.
        this.best = Math.min(this.best + 5e-6, performance.now() / 1000 - message.t);
        this.live = message;
        this.onMessage(message);
      }
    };
    this.socket.onclose = () => setTimeout(() => this.connect(), 1000);
  }

  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    if (this.socket.bufferedAmount > 4096) return;  // old beats are worse than none
    const at = performance.now();
    const heard = this.told ? {told: this.told.told, held: at - this.told.at} : {};
    this.socket.send(JSON.stringify({...message, ...heard, n: ++this.count, at}));
  }

  // Seconds that what is shown is old, by the page's own clock.
  get age() {
    if (!this.live) return Infinity;
    const late = performance.now() / 1000 - this.live.t - this.best;
    return late + (this.tripMs || 0) / 2000;
  }

  roundTrip(ms) {
    this.tripMs = ms;
    const field = document.querySelector('[data-field="browser_ms"]');
    if (field) field.textContent = `${ms.toFixed(0)} ms`;
  }

  watch() {
    const isLost = performance.now() - this.heardAt > LOST_MS || this.age * 1000 > LOST_MS;
    const field = document.querySelector('[data-field="age"]');
    if (field) {
      const age = this.live ? this.live.age : undefined;
      field.textContent = age === undefined ? "–" : `${(age + this.age).toFixed(2)} s ago`;
    }
    document.body.classList.toggle("station-lost", isLost);
  }
}

// -- instruments -------------------------------------------------------------------------------

function fit(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== width * scale || canvas.height !== height * scale) {
    canvas.width = width * scale;
    canvas.height = height * scale;
  }
  const g = canvas.getContext("2d");
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, width, height);
  return [g, width, height];
}

function drawHorizon(canvas, attitude) {
  const [g, width, height] = fit(canvas);
  canvas.dataset.stale = attitude ? "" : "stale";
  const [roll, pitch, yaw] = attitude || [0, 0, 0];
  const perDegree = height / 60;
  g.save();
  g.translate(width / 2, height / 2);
  g.rotate(-roll * Math.PI / 180);
  g.translate(0, pitch * perDegree);
  g.fillStyle = attitude ? "#4a90d9" : "#888";
  g.fillRect(-2 * width, -4 * height, 4 * width, 4 * height);
  g.fillStyle = attitude ? "#8a6d3b" : "#666";
  g.fillRect(-2 * width, 0, 4 * width, 4 * height);
  g.strokeStyle = g.fillStyle = "#fff";
  g.font = "10px sans-serif";
  for (let angle = -30; angle <= 30; angle += 10) {
    const half = angle ? 18 : width;
    g.beginPath();
    g.moveTo(-half, -angle * perDegree);
    g.lineTo(half, -angle * perDegree);
    g.stroke();
    if (angle) g.fillText(`${angle}`, half + 3, -angle * perDegree + 3);
  }
  g.restore();
  g.strokeStyle = "#ffd400";
  g.lineWidth = 3;
  g.beginPath();
  g.moveTo(width / 2 - 40, height / 2); g.lineTo(width / 2 - 12, height / 2);
  g.moveTo(width / 2 + 12, height / 2); g.lineTo(width / 2 + 40, height / 2);
  g.stroke();
  g.fillStyle = "rgba(0,0,0,.55)";
  g.fillRect(width / 2 - 42, 0, 84, 20);
  g.fillStyle = "#fff";
  g.font = "bold 13px sans-serif";
  g.textAlign = "center";
  g.fillText(attitude ? `${((Math.round(yaw) % 360) + 360) % 360}°` : "no attitude", width / 2, 15);
}

class Track {
  constructor(canvas, tiles) {
    this.canvas = canvas;
    this.tiles = tiles;
    this.points = [];
    this.images = new Map();
  }

  add(position) {
    const last = this.points[this.points.length - 1];
    if (last && Math.hypot(...this.metres(position, last)) < 0.2) return;
    this.points.push(position);
    if (this.points.length > 5000) this.points.splice(0, 1000);
  }

  metres(to, from) {
    const radius = 6378137 * Math.PI / 180;
    const north = (to[0] - from[0]) * radius;
    return [(to[1] - from[1]) * radius * Math.cos(from[0] * Math.PI / 180), north];
  }

  draw(position, yaw) {
    const [g, width, height] = fit(this.canvas);
    this.canvas.dataset.stale = position ? "" : "stale";
    if (position) { this.add(position); this.centre = position; }
    if (!this.centre) return;
    const origin = this.points[0];
    const far = Math.max(20, ...this.points.slice(-1500).map(
      (p) => Math.hypot(...this.metres(p, this.centre))));
    const scale = Math.min(width, height) / 2.2 / far;
    const place = (p) => {
      const [east, north] = this.metres(p, this.centre);
      return [width / 2 + east * scale, height / 2 - north * scale];
    };
    if (this.tiles) this.drawTiles(g, width, height, scale, place);
    this.drawGrid(g, width, height, scale, place(origin));
    g.strokeStyle = "#1565c0";
    g.lineWidth = 2;
    g.beginPath();
    this.points.forEach((p, i) => i ? g.lineTo(...place(p)) : g.moveTo(...place(p)));
    g.stroke();
    g.fillStyle = "#2e7d32";
    const [homeX, homeY] = place(origin);
    g.fillRect(homeX - 4, homeY - 4, 8, 8);
    const [x, y] = place(this.centre);
    g.save();
    g.translate(x, y);
    g.rotate((yaw || 0) * Math.PI / 180);
    g.fillStyle = position ? "#c62828" : "#888";
    g.beginPath();
    g.moveTo(0, -11); g.lineTo(7, 8); g.lineTo(0, 4); g.lineTo(-7, 8);
    g.fill();
    g.restore();
  }

  drawGrid(g, width, height, scale, [x0, y0]) {
    const steps = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
    const step = steps.find((s) => s * scale > 40) || 10000;
    g.strokeStyle = "rgba(128,128,128,.35)";
    g.lineWidth = 1;
    g.beginPath();
    const gap = step * scale;
    for (let x = ((x0 % gap) + gap) % gap; x < width; x += gap) { g.moveTo(x, 0); g.lineTo(x, height); }
    for (let y = ((y0 % gap) + gap) % gap; y < height; y += gap) { g.moveTo(0, y); g.lineTo(width, y); }
    g.stroke();
    g.fillStyle = "#888";
    g.font = "11px sans-serif";
    g.fillText(`grid ${step} m, north up`, 6, height - 6);
  }

  drawTiles(g, width, height, scale, place) {
    const [latitude, longitude] = this.centre;
    const metresPerPixel = 156543.034 * Math.cos(latitude * Math.PI / 180);
    const zoom = Math.max(0, Math.min(19, Math.round(Math.log2(metresPerPixel * scale))));
    const n = 2 ** zoom;
    const column = (longitude + 180) / 360 * n;
    const row = (1 - Math.asinh(Math.tan(latitude * Math.PI / 180)) / Math.PI) / 2 * n;
    const size = metresPerPixel / n * 256 * scale;
    const reach = Math.ceil(Math.max(width, height) / size / 2) + 1;
    if (reach > 6) return;
    for (let i = -reach; i <= reach; i++)
      for (let j = -reach; j <= reach; j++) {
        const tx = Math.floor(column) + i, ty = Math.floor(row) + j;
        const image = this.tile(zoom, tx, ty);
        if (image && image.complete && image.naturalWidth)
          g.drawImage(image, width / 2 + (tx - column) * size, height / 2 + (ty - row) * size, size, size);
      }
  }

  tile(zoom, x, y) {
    const path = `/tiles/${zoom}/${x}/${y}.png`;
    if (!this.images.has(path)) {
      if (this.images.size > 400) this.images.clear();
      const image = new Image();
      image.src = path;
      this.images.set(path, image);
    }
    return this.images.get(path);
  }
}

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

// -- held presses ------------------------------------------------------------------------------

function holdToPress(button) {
  const need = 1000;
  let timer = null;
  const begin = (event) => {
    if (timer !== null || button.disabled || (event.button || 0) !== 0) return;
    button.classList.add("holding");
    timer = setTimeout(() => {
      end();
      button.dispatchEvent(new CustomEvent("held", {detail: {}}));
    }, need);
  };
  const end = () => {
    clearTimeout(timer);
    timer = null;
    button.classList.remove("holding");
  };
  button.addEventListener("pointerdown", begin);
  for (const name of ["pointerup", "pointerleave", "pointercancel", "blur"])
    button.addEventListener(name, end);
  button.addEventListener("keydown", (e) => (e.code === "Space" || e.code === "Enter") && !e.repeat && begin(e));
  button.addEventListener("keyup", end);
  window.addEventListener("blur", end);
}

function startConsole(tab, hasTiles) {
  const find = (selector) => document.querySelector(selector);
  if (!find("#pad") || !find("#horizon")) return setTimeout(() => startConsole(tab, hasTiles), 50);
  const track = new Track(find("#track"), hasTiles);
  const plots = [
    new Plot(find("#plot-height"), "height, m", (m) => m.pos && m.pos[2]),
    new Plot(find("#plot-speed"), "ground speed, m/s", (m) => m.vel && m.vel[0]),
    new Plot(find("#plot-yaw"), "turn, °/s", (m) => m.yaw_rate),
    new Plot(find("#plot-link"), "telemetry, packages/s", (m) => m.rate),
  ];
  let last = {};
  let drawnAt = 0;
  const socket = new Socket(`/steer/${tab}`, (message) => {
    last = message;
    if (message.t - drawnAt >= 0.18) { drawnAt = message.t; plots.forEach((p) => p.add(message)); }
  });
  const draw = () => {
    const isLost = document.body.classList.contains("station-lost");
    const now = isLost ? {} : last;
    drawHorizon(find("#horizon"), now.att);
    track.draw(now.pos, now.att && now.att[2]);
    plots.forEach((p) => p.draw());
    ["roll", "pitch", "yaw", "throttle"].forEach((name, i) => {
      const bar = find(`[data-rc="${name}"]`);
      if (!bar) return;
      bar.classList.toggle("stale", !now.rc);
      bar.style.setProperty("--value", now.rc ? now.rc[i] / 10000 : 0);
      bar.title = now.rc ? now.rc[i] : "–";
    });
  };
  setInterval(() => document.hidden || draw(), 60);
  document.querySelectorAll("button.hold").forEach(holdToPress);
  window.m100 = {steering: new Steering(find("#pad"), socket), socket, track};
}
