// Steering. It needs the pad to have the focus and a key, a stick or the handle of a gamepad to be
// held. While that is so, a beat goes out at once and then every 50 ms. When it ends, for whatever
// reason, a rest goes out; if even that is lost the station stops 300 ms after the last beat.
//
// Whatever ends it also asks for a new press: nothing that is still held flies on by itself.

import {gamepads} from "./gamepad.js";
import {isSettled} from "./press.js";
import {number, onChoose, speed, words} from "./said.js";

const BEAT_MS = 50;
const LOOK_MS = 200;  // between two turns of the gimbal; one lasts half a second
const STOOD_STILL_MS = 1000;  // a page that slept so long does not know what is held

const KEYS = {
  KeyW: ["forward", 1], KeyS: ["forward", -1],
  KeyD: ["right", 1], KeyA: ["right", -1],
  KeyE: ["turn", 1], KeyQ: ["turn", -1],
  KeyZ: ["up", 1], KeyC: ["up", -1],
};

// Full deflection at speed level 1. Angles, turn and climb are those of DJI's page of 2015.
const ANGLE_DEG = 2, SPEED_M_S = 0.5, TURN_DEG_S = 6, CLIMB_M_S = 0.3;
const LEVELS = 6;

const clip = (value) => Math.max(-1, Math.min(1, value));

// A stick for a finger. It is deflected from where the finger came down: to touch it moves nothing.
class Stick {
  constructor(element, changed, spoilt) {
    this.element = element;
    this.names = element.dataset.axes.split(",");  // to the right, and up
    this.changed = changed;
    this.axes = null;
    element.addEventListener("pointerdown", (e) => this.grab(e, spoilt));
    element.addEventListener("pointermove", (e) => this.move(e));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"])
      element.addEventListener(end, (e) => e.pointerId === this.pointer && this.drop());
  }

  grab(event, spoilt) {
    event.preventDefault();
    if (event.button > 0) return;
    // A second finger on one stick: whose release would be the end of it?
    if (this.axes) return spoilt();
    this.pointer = event.pointerId;
    this.from = [event.clientX, event.clientY];
    this.element.setPointerCapture(event.pointerId);
    this.axes = {};
    this.show(0, 0);
  }

  move(event) {
    if (!this.axes || event.pointerId !== this.pointer) return;
    if (event.buttons === 0) return this.drop();  // its release was told to nobody
    const reach = this.element.clientWidth / 2;
    let across = (event.clientX - this.from[0]) / reach, up = (this.from[1] - event.clientY) / reach;
    const far = Math.hypot(across, up);
    if (far > 1) [across, up] = [across / far, up / far];
    this.show(across, up);
  }

  show(across, up) {
    const dead = (value) => Math.abs(value) < 0.08 ? 0 : clip(value);
    this.axes = {[this.names[0]]: dead(across), [this.names[1]]: dead(up)};
    this.element.style.setProperty("--across", across);
    this.element.style.setProperty("--up", up);
    this.changed();
  }

  drop() {
    if (!this.axes) return;
    this.axes = null;
    this.element.style.setProperty("--across", 0);
    this.element.style.setProperty("--up", 0);
    this.changed();
  }
}

// The place to drag for looking around: it turns the gimbal for half a second, again and again.
export function startLook(element) {
  const tell = (axes) => window.emitEvent("looked", axes);
  const stick = new Stick(element, () => stick.axes || tell({yaw: 0, pitch: 0}), () => stick.drop());
  setInterval(() => stick.axes && tell(stick.axes), LOOK_MS);
}

export class Steering {
  constructor(pad, socket) {
    this.pad = pad;
    this.socket = socket;
    this.held = new Set();
    this.level = 1;
    this.mode = 1;
    this.wasActive = false;
    gamepads.onAction = (action) => this.act(action);
    this.tickedAt = performance.now();
    this.said = "";
    this.sticks = [...pad.querySelectorAll(".stick")].map((element) => {
      const stick = new Stick(element, () => this.tick(), () => this.rest());
      element.addEventListener("pointerdown", () => pad.focus(), {capture: true});
      return stick;
    });
    pad.addEventListener("keydown", (e) => this.keyDown(e));
    pad.addEventListener("keyup", (e) => this.keyUp(e));
    pad.addEventListener("focusout", (e) => pad.contains(e.relatedTarget) || this.rest());
    pad.addEventListener("click", (e) => this.choose(e.target.closest("[data-steer]")));
    pad.addEventListener("contextmenu", (e) => {
      e.preventDefault();  // a finger that rests on a stick asks for it, too
      if (e.pointerType !== "touch") this.rest();
    });
    for (const end of ["blur", "pagehide"]) window.addEventListener(end, () => this.rest());
    document.addEventListener("freeze", () => this.rest());
    document.addEventListener("visibilitychange", () => document.hidden && this.rest());
    setInterval(() => this.tick(), BEAT_MS);
    onChoose(() => this.show());
    this.show();
  }

  get hasFocus() {
    return isSettled() && document.hasFocus() && !document.hidden
      && this.pad.contains(document.activeElement);
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
      this.setLevel(Number(event.code[5]));
    } else if (event.code === "Digit8" || event.code === "Digit9") {
      this.setMode(event.code === "Digit8" ? 1 : 2);
    } else if (event.code === "Escape") {
      document.activeElement.blur();
    }
  }

  keyUp(event) {
    if (this.held.delete(event.code)) this.tick();
  }

  choose(button) {
    if (!button) return;
    const {steer} = button.dataset;
    if (steer === "mode") this.setMode(3 - this.mode);
    else if (steer === "faster" || steer === "slower") this.setLevel(this.level + (steer === "faster" ? 1 : -1));
  }

  setLevel(level) {
    this.level = Math.max(1, Math.min(LEVELS, level));
    this.show();
    this.say(words("level", {level: this.level, levels: LEVELS}));
  }

  setMode(mode) {
    this.mode = mode;
    this.show();
    this.say(words(mode === 1 ? "angles" : "velocity"));
  }

  gamepad() {
    // A dead man's handle: a stick that drifts moves nothing by itself. In another view, such as the
    // one that maps it, nothing is held.
    const axes = gamepads.look(), isShown = document.body.dataset.view === "fly";
    if (!isShown) gamepads.spend();
    return isShown ? axes : null;
  }

  // A button of a gamepad was pressed.
  act(action) {
    if (action === "stop")  // in every view, as its button on the page
      return document.querySelector("[data-act=stop]").dispatchEvent(new PointerEvent("pointerdown"));
    if (!this.hasFocus || document.body.dataset.view !== "fly") return;
    if (action === "photo") window.emitEvent("photo_pressed");
    else this.choose({dataset: {steer: action}});
  }

  demand() {
    const gamepad = this.gamepad();
    if (!this.hasFocus) {
      gamepads.spend();
      return null;
    }
    const sources = [...this.sticks.map((stick) => stick.axes), gamepad].filter(Boolean);
    if (!this.held.size && !sources.length) return null;
    const axes = {forward: 0, right: 0, turn: 0, up: 0};
    for (const code of this.held) axes[KEYS[code][0]] += KEYS[code][1];
    for (const source of sources) for (const axis in source) axes[axis] += source[axis];
    for (const axis in axes) axes[axis] = clip(axes[axis]);
    return axes;
  }

  tick() {
    const now = performance.now(), gap = now - this.tickedAt;
    this.tickedAt = now;
    if (gap > STOOD_STILL_MS) this.letGo();
    const axes = this.demand();
    if (axes !== null && !this.wasActive) this.beganAt = now;
    if (axes === null) {
      if (this.wasActive) { this.socket.send({op: "rest"}); this.say(words("let_go")); }
      this.wasActive = false;
      const isSpent = gamepads.isSpent && this.hasFocus;
      this.pad.dataset.fate = isSpent ? "let_go_first" : "";
      if (isSpent) this.say(words("fate_let_go_first", {what: words("pad_at_rest")}));
      if (!this.hasFocus) this.letGo();
      return;
    }
    this.wasActive = true;
    const forward = axes.forward * this.level, right = axes.right * this.level;
    const [x, y] = this.mode === 1
      ? [-ANGLE_DEG * forward, ANGLE_DEG * right]
      : [SPEED_M_S * right, SPEED_M_S * forward];
    const z = TURN_DEG_S * this.level * axes.turn, w = CLIMB_M_S * axes.up;
    this.socket.send({op: "beat", mode: this.mode, x, y, z, w});
    this.tell(axes, z, w);
  }

  letGo() {
    this.held.clear();
    for (const stick of this.sticks) stick.axes && stick.drop();
    gamepads.spend();
  }

  rest() {
    this.letGo();
    this.tick();
  }

  // -- the legend ------------------------------------------------------------------------------

  tell(axes, turn, climb) {
    const parts = [];
    const go = (value, plus, minus) => value && parts.push(words(value > 0 ? plus : minus));
    const north = this.mode === 2;
    go(axes.forward, north ? "north" : "forward", north ? "south" : "back");
    go(axes.right, north ? "east" : "right", north ? "west" : "left");
    const size = Math.min(1, Math.hypot(axes.forward, axes.right)) * this.level;
    if (parts.length) parts.push(north ? speed(SPEED_M_S * size) : words("tilt", {angle: number(ANGLE_DEG * size, 0)}));
    if (turn) parts.push(words(turn > 0 ? "turn_right" : "turn_left", {rate: number(Math.abs(turn), 0)}));
    if (climb) parts.push(words(climb > 0 ? "climb" : "sink", {speed: speed(Math.abs(climb))}));
    const keys = [...this.held].map((code) => code.slice(3)).join(" ");
    const what = `${keys ? `${keys}: ` : ""}${parts.join(" ") || words("at_rest")}`;
    const fate = this.pad.dataset.fate = this.socket.fateSince(this.beganAt);
    this.say(words(`fate_${fate}`, {what}));
  }

  say(text) {
    if (text === this.said) return;
    this.said = text;
    this.pad.querySelector("#did").textContent = text;
  }

  show() {
    this.pad.querySelector("[data-level]").textContent = this.level;
    this.pad.querySelector("[data-mode]").textContent = words("mode", {mode: this.mode});
    this.pad.querySelector("[data-hint]").textContent = ` · ${words(this.mode === 1 ? "angles_hint" : "velocity_hint")}`;
  }
}
