// The shell of the page: the socket, the views, presses that are held, and STOP.

import {tellRefused} from "./press.js";  // first of all: what it refuses reaches nothing else
import {answered, order, say, start as startOrders} from "./orders.js";
import {words} from "./said.js";
import {Socket} from "./socket.js";
import {startLook, Steering} from "./steer.js";
import {drawHorizon, drawChannels} from "./instruments.js";
import {FlightMap} from "./map.js";

const HOLD_MS = 1000;
const SHIFTED_MS = 400;  // so long after the page shifted, a finger is where another button was
const STOOD_STILL_MS = 500;  // later than this, nobody knows whether the button was held

const FOLDS = "m100link.folds";  // which panels this browser shows

const listeners = [];
const waiting = [];  // for the map

// What modules and tests reach.
export const m100 = {
  socket: null,
  steering: null,
  map: null,
  // Each message of the instruments, at most once for a frame; {} when everything is old.
  onLive(callback) { listeners.push(callback); },
  onMap(callback) { this.map ? callback(this.map) : waiting.push(callback); },
  // What is told with a press: when it was by the page's clock, its number, and what stood on the button as it began.
  order(event) {
    const press = order(event.currentTarget, this.socket.isUnheard);
    return {at: performance.now(), press, shown: event.detail?.shown};
  },
  answered,
};

export function start(key) {
  const find = (selector) => document.querySelector(selector);
  if (!find("#pad") || !find("#horizon")) return setTimeout(() => start(key), 30);
  m100.socket = new Socket(`/steer/${key}`, () => draw());
  m100.steering = new Steering(find("#pad"), m100.socket);
  window.m100 = m100;
  m100.onLive((live) => drawHorizon(find("#horizon"), live));
  m100.onLive(drawChannels);
  setInterval(() => m100.socket.isLost && draw(), 250);  // what is not told any more grows old
  startOrders();
  startLook(find(".look"));
  tellRefused(() => say(words("too_soon")));
  stopAtOnce(find("[data-act=stop]"));
  holdToPress();
  for (const tab of document.querySelectorAll("[data-go]"))
    tab.addEventListener("click", () => {
      show(tab.dataset.go);
      history.replaceState(null, "", `#${tab.dataset.go}`);  // where a reload goes on
    });
  const named = () => find(`[data-go="${CSS.escape(location.hash.slice(1))}"]`);
  show(named()?.dataset.go || "fly");  // the station learns of it by kept()
  const comeBack = () => history.replaceState(null, "", `#${document.body.dataset.view}`);
  window.addEventListener("hashchange", () => (named() ? named().click() : comeBack()));
  if (location.hash && !named()) comeBack();
  keepAboveKeyboard();
  keepBelowHeader(find("#header"));
  noteShifts();
  foldPanels();
  FlightMap.find(find("#map"), (map) => {
    m100.map = map;
    m100.onLive((live) => map.draw(live));
    waiting.splice(0).forEach((callback) => callback(map));
  });
}

const shiftedAt = new Map();  // by what moves as one
let isDrawing = false;

function draw() {
  if (isDrawing || document.hidden) return;
  isDrawing = true;
  requestAnimationFrame(() => {
    isDrawing = false;
    const live = m100.socket.isLost || !m100.socket.live ? {} : m100.socket.live;
    for (const listener of listeners) listener(live);
  });
}

function show(name) {
  document.body.dataset.view = name;
  for (const tab of document.querySelectorAll("[data-go]"))
    tab.setAttribute("aria-current", tab.dataset.go === name ? "page" : "false");
  m100.steering.rest();
}

// -- presses -----------------------------------------------------------------------------------

// At the press and not at its end: while one finger is on a stick, the tap of another makes no click.
function stopAtOnce(button) {
  let pressedAt = -Infinity;
  const stop = () => {
    m100.steering.rest();
    const press = order(button, m100.socket.isUnheard);
    m100.socket.send({op: "stop", press});  // by both ways that there are
    button.dispatchEvent(new CustomEvent("stopped", {detail: press}));
  };
  button.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    pressedAt = event.timeStamp;
    stop();
  });
  // By keyboard, or by a program that reads the page to somebody.
  button.addEventListener("click", (event) => event.timeStamp - pressedAt > 1000 && stop());
}

// Buttons of class "hold" say "held" after a second, or why not; they may come and go. What is told
// with it stood on the button when the press began: whatever came since was not what was confirmed.
function holdToPress() {
  let held = null;
  const begin = (event, button) => {
    if (held || button.disabled || event.button > 0) return;
    // By when the finger came down: on a page that was busy, the shift may be the later of the two.
    if (event.pointerId !== undefined && event.timeStamp - (shiftedAt.get(ground(button)) ?? -Infinity) < SHIFTED_MS)
      return void button.dispatchEvent(new CustomEvent("shifted", {detail: {}}));
    button.classList.add("holding");
    const timer = setTimeout(() => {
      const isLate = performance.now() - held.at > HOLD_MS + STOOD_STILL_MS;
      end();
      const name = button.disabled ? "withdrawn" : isLate ? "unsure" : "held";
      button.dispatchEvent(new CustomEvent(name, {detail: {shown}}));
    }, HOLD_MS);
    const shown = button.dataset.shown;
    held = {button, timer, at: performance.now(), down: event.timeStamp, pointer: event.pointerId};
  };
  const end = () => {
    if (!held) return;
    clearTimeout(held.timer);
    held.button.classList.remove("holding");
    held = null;
  };
  const target = (event) => event.target.closest?.("button.hold");
  document.addEventListener("pointerdown", (event) => {
    const button = target(event);
    if (held) end();  // a second finger anywhere: not what was meant
    else if (button) begin(event, button);
  });
  for (const name of ["pointerup", "pointercancel"])
    document.addEventListener(name, (event) => {
      if (!held || event.pointerId !== held.pointer) return;
      // Both stood in the queue of a page that was busy: the finger was there long enough.
      const {button, down} = held, wasHeld = event.timeStamp - down > HOLD_MS;
      end();
      if (name !== "pointerup") return;
      if (wasHeld) button.dispatchEvent(new CustomEvent("unsure", {detail: {}}));
      else say(words("hold"));
    });
  document.addEventListener("pointermove", (event) => {
    if (!held || event.pointerId !== held.pointer) return;
    const box = held.button.getBoundingClientRect();
    if (event.clientX < box.left || event.clientX > box.right
      || event.clientY < box.top || event.clientY > box.bottom) end();
  });
  document.addEventListener("contextmenu", (event) => {
    if (target(event)) event.preventDefault();  // a long press asks for it on a phone
  });
  document.addEventListener("keydown", (event) => {
    const isPress = event.code === "Space" || event.code === "Enter";
    if (target(event) && isPress && !event.repeat) begin(event, target(event));
  });
  document.addEventListener("keyup", () => {
    if (held) say(words("hold"));
    end();
  });
  document.addEventListener("focusout", (event) => event.target === held?.button && end());
  document.addEventListener("visibilitychange", end);
  window.addEventListener("blur", end);
}

// What holds a button, or stands below one, came, went or changed its height.
function noteShifts() {
  const heights = new Map();
  const shifts = new ResizeObserver((entries) => {
    for (const {target} of entries) {
      if (heights.get(target) === target.offsetHeight) continue;
      heights.set(target, target.offsetHeight);
      shiftedAt.set(ground(target), performance.now());
    }
  });
  for (const one of document.querySelectorAll("#dock, .place.prepared > .card, .place.steering")) shifts.observe(one);
}

// What moves as one: the bar at the bottom, and all that stands above it.
const ground = (one) => one.closest("#dock") ? "dock" : "above";

// Panels over the map that are there when they are wanted; on a desk from the beginning.
function foldPanels() {
  const isWide = matchMedia("(min-width: 1000px)").matches, pad = document.querySelector("#pad");
  let kept = {};
  try {
    kept = JSON.parse(localStorage.getItem(FOLDS) || "{}");
  } catch { /* where nothing may be stored, each page begins anew */ }
  for (const button of document.querySelectorAll("[data-fold]")) {
    const name = button.dataset.fold;
    const show = (isShown) => {
      document.body.classList.toggle(`with-${name}`, isShown);
      button.setAttribute("aria-pressed", isShown);
    };
    show(kept[name] ?? isWide);
    button.addEventListener("click", () => {
      m100.steering.rest();
      kept[name] = !document.body.classList.contains(`with-${name}`);
      show(kept[name]);
      if (name === "sticks" && kept[name]) pad.focus();
      try {
        localStorage.setItem(FOLDS, JSON.stringify(kept));
      } catch { /* as above */ }
    });
  }
}

// The header grows with what it has to say; nothing lies under it.
function keepBelowHeader(header) {
  let height = 0;
  const fit = () => {
    if (header.offsetHeight === height) return;
    height = header.offsetHeight;
    document.documentElement.style.setProperty("--top", `${height}px`);
  };
  new ResizeObserver(fit).observe(header, {box: "border-box"});
}

// Where a keyboard on the screen covers the page instead of making it smaller.
function keepAboveKeyboard() {
  const seen = window.visualViewport;
  if (!seen) return;
  const fit = () => {
    const hidden = Math.max(0, window.innerHeight - seen.height - seen.offsetTop);
    document.documentElement.style.setProperty("--keyboard", `${seen.scale > 1.05 ? 0 : hidden}px`);
  };
  seen.addEventListener("resize", fit);
  seen.addEventListener("scroll", fit);
}
