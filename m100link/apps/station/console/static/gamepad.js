// Gamepads: what their axes and buttons mean, kept by this browser, and the card to choose it.
//
// Nothing here sends anything: steer.js asks what is held, and gives the orders.

import {onChoose, words} from "./said.js";

const KEPT = "m100link.gamepad";
const MOST = 32;  // axes or buttons of one gamepad
const MOST_DEAD = 0.5;

// Mode 2 on the standard mapping, on which a stick that is pushed away is negative: of each
// direction its axis, and how that counts.
const USUAL = {turn: [0, 1], up: [1, -1], right: [2, 1], forward: [3, -1]};
const USUAL_DEAD = 0.1;
const USUAL_BUTTONS = {1: "stop", 4: "fly", 5: "fly"};
const STOP = 1;  // the button that has STOP when no other has
const ACTIONS = ["none", "stop", "fly", "photo", "slower", "faster", "mode"];

const isCount = (value) => Number.isInteger(value) && value >= 0 && value < MOST;

// A mapping that can be used, of whatever was kept: {axes: {turn: {axis, sign, dead}, …}, buttons:
// action by number}. Some button has STOP always.
export function mapping(found) {
  const axes = {}, buttons = {}, told = found?.buttons ?? USUAL_BUTTONS;
  for (const [name, [axis, sign]] of Object.entries(USUAL)) {
    const kept = found?.axes?.[name] ?? {};
    axes[name] = {
      axis: isCount(kept.axis) ? kept.axis : axis,
      sign: Math.abs(kept.sign) === 1 ? kept.sign : sign,
      dead: typeof kept.dead === "number" && kept.dead >= 0 && kept.dead <= MOST_DEAD ? kept.dead : USUAL_DEAD,
    };
  }
  for (let i = 0; i < MOST; i++)
    if (ACTIONS.indexOf(told[i]) > 0) buttons[i] = told[i];
  if (!Object.values(buttons).includes("stop")) buttons[STOP] = "stop";
  return {axes, buttons};
}

// What a gamepad says: each direction from -1 to 1, and the actions whose buttons are down. One that
// has no button with STOP, by a mapping for another gamepad, has it where it usually is.
export function read(pad, {axes, buttons}) {
  const found = {}, pressed = new Set();
  for (const [name, {axis, sign, dead}] of Object.entries(axes)) {
    const value = sign * (pad.axes[axis] ?? 0), size = (Math.min(1, Math.abs(value)) - dead) / (1 - dead);
    found[name] = size > 0 ? Math.sign(value) * size : 0;  // and of what is no number, nothing
  }
  const does = pad.buttons.some((_, i) => buttons[i] === "stop") ? buttons : {...buttons, [STOP]: "stop"};
  pad.buttons.forEach((button, i) => button.pressed && does[i] && pressed.add(does[i]));
  return {axes: found, pressed};
}

export class Gamepads {
  constructor() {
    let kept = null;
    try {
      kept = JSON.parse(localStorage.getItem(KEPT));
    } catch { /* nothing was kept, or it cannot be read */ }
    this.map = mapping(kept);
    this.down = new Map();  // actions that were down before, by gamepad
    this.ready = new Set();  // gamepads whose handle was seen up, and sticks at rest, since they came
    this.isSpent = false;  // whether the one that is held is none of them
    this.onAction = () => {};
    this.onLook = () => {};
  }

  choose(changed) {
    this.map = mapping(changed);
    try {
      localStorage.setItem(KEPT, JSON.stringify(this.map));
    } catch { /* where nothing may be stored, each page begins anew */ }
  }

  // Nothing that is held flies on: each gamepad has to be seen at rest first. So does an axis that
  // does not rest at 0, such as a trigger or a hat, of which nobody knows how far it is pushed.
  spend() { this.ready.clear(); }

  // The axes of the gamepad whose dead man's handle is held, or null. Each press of another button is
  // told once, to onAction.
  look() {
    const pads = (navigator.getGamepads ? [...navigator.getGamepads()] : []).filter((one) => one?.connected);
    const said = pads.map((pad) => [pad, read(pad, this.map)]);
    const before = this.down;
    this.down = new Map(said.map(([pad, {pressed}]) => [pad.index, pressed]));  // first: a STOP looks again
    for (const [pad, {pressed}] of said) {
      // A browser shows a gamepad when one of its buttons is pressed: of these only STOP is meant.
      const was = before.get(pad.index) ?? new Set(ACTIONS.filter((one) => one !== "stop"));
      for (const action of pressed) if (!was.has(action)) this.onAction(action);
    }
    this.onLook(said);
    const name = ([pad]) => `${pad.index} ${pad.id}`;
    const isAtRest = ([, {axes, pressed}]) => !pressed.has("fly") && !Object.values(axes).some(Boolean);
    this.ready = new Set(said.filter((one) => this.ready.has(name(one)) || isAtRest(one)).map(name));
    const held = said.find(([, {pressed}]) => pressed.has("fly")), flies = held && this.ready.has(name(held));
    this.isSpent = Boolean(held) && !flies;
    return flies ? held[1].axes : null;
  }
}

export const gamepads = new Gamepads();

// -- the card in Settings, whose sticks move with those of the gamepad ---------------------------

const make = (tag, values = {}, ...inside) => {
  const made = Object.assign(document.createElement(tag), values);
  made.append(...inside);
  return made;
};

const labelled = (label, field) => make("label", {}, `${label} `, field);

const chosen = (options, value, change) => {
  const made = options.map(([one, text]) => make("option", {value: one, textContent: text, selected: one === value}));
  return make("select", {onchange: (event) => change(event.target.value)}, ...made);
};

export function build(place) {
  let shape = "";  // of the gamepad that is shown: other fields for another one
  const showFields = (pad) => {
    const {map} = gamepads, {axes, buttons} = map;
    const directions = {turn: words("pad_turn"), up: words("pad_up"), right: words("pad_right"), forward: words("pad_forward")};
    const actions = {
      none: words("pad_none"), stop: words("pad_stop"), fly: words("pad_fly"), photo: words("pad_photo"),
      slower: words("pad_slower"), faster: words("pad_faster"), mode: words("pad_mode"),
    };
    const set = (changed) => { gamepads.choose({axes, buttons, ...changed}); shape = ""; };
    const axisField = (name) => {
      const {axis, sign, dead} = axes[name], usual = USUAL[name][1];
      const setAxis = (changed) => set({axes: {...axes, [name]: {axis, sign, dead, ...changed}}});
      const count = Math.max(pad.axes.length, axis + 1);
      const numbers = Array.from({length: count}, (_, i) => [i, words("pad_axis", {number: i})]);
      const inverted = make("input", {
        type: "checkbox", checked: sign !== usual, onchange: (event) => setAxis({sign: event.target.checked ? -usual : usual}),
      });
      const zone = make("input", {
        type: "number", min: 0, max: 100 * MOST_DEAD, step: 5, value: Math.round(100 * dead),
        onchange: (event) => setAxis({dead: event.target.value / 100}),
      });
      return make("div", {className: "row"}, labelled(directions[name], chosen(numbers, axis, (value) => setAxis({axis: Number(value)}))),
        labelled(words("pad_inverted"), inverted), labelled(words("pad_dead"), zone));
    };
    const buttonField = (_, i) => {
      const field = chosen(Object.entries(actions), buttons[i] ?? "none", (action) => set({buttons: {...buttons, [i]: action}}));
      return make("div", {className: "row"}, labelled(words("pad_button", {number: i}), field));
    };
    const usual = make("button", {type: "button", className: "act plain", textContent: words("pad_usual"), onclick: () => set(mapping(null))});
    const all = () => [...place.querySelectorAll("select, input, button")], at = all().indexOf(document.activeElement);
    place.querySelector(".fields").replaceChildren(...Object.keys(USUAL).map(axisField), ...[...pad.buttons].map(buttonField), usual);
    all()[at]?.focus();
  };
  const show = (said) => {
    if (document.body.dataset.view !== "settings") return;
    const [pad, {axes}] = said.find(([, {pressed}]) => pressed.size) ?? said[0] ?? [null, {axes: {}}];
    const seen = pad ? `${pad.id}/${pad.axes.length}/${pad.buttons.length}` : "none";
    if (seen !== shape) {
      shape = seen;
      place.querySelector(".which").textContent = pad ? pad.id : words("pad_missing");
      pad ? showFields(pad) : place.querySelector(".fields").replaceChildren();
    }
    for (const stick of place.querySelectorAll(".stick")) {
      const [across, up] = stick.dataset.axes.split(",");
      stick.style.setProperty("--across", axes[across] ?? 0);
      stick.style.setProperty("--up", axes[up] ?? 0);
    }
    [...(pad?.buttons ?? [])].forEach((button, i) =>
      place.querySelectorAll(".fields > .row")[Object.keys(USUAL).length + i]?.classList.toggle("down", button.pressed));
  };
  gamepads.onLook = show;
  onChoose(() => { shape = ""; });
}
