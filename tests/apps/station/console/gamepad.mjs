// Runs the page's steering without a page, and prints what it did. The first argument is the folder
// of the page's scripts, the second the mapping that this browser kept, the third the steps: each
// has what changes before the next look.

const [folder, kept, steps] = process.argv.slice(2);

const notes = [];
const element = {dataset: {}, textContent: "", addEventListener() {}, contains: () => true, querySelectorAll: () => [], querySelector: () => element};
const stop = {dispatchEvent: () => { notes.push("stop"); steering.rest(); }};  // as shell.js
let now = 10000, pads = [];
Object.defineProperty(globalThis, "navigator", {value: {getGamepads: () => pads}});
Object.defineProperty(globalThis, "performance", {value: {now: () => now}});
globalThis.PointerEvent = class {};
globalThis.localStorage = {getItem: () => kept, setItem: (_, text) => notes.push(["kept", JSON.parse(text)])};
globalThis.location = {hash: ""};
globalThis.setInterval = () => {};
globalThis.window = {addEventListener() {}, emitEvent: (name) => notes.push(name)};
globalThis.document = {
  addEventListener() {}, hasFocus: () => true, hidden: false, activeElement: null, documentElement: {},
  body: {dataset: {view: "fly"}}, querySelector: () => stop,
};

const {gamepads, mapping, read} = await import(`${folder}/gamepad.js`);
const {Steering} = await import(`${folder}/steer.js`);
now += 2000;  // the page has been looked at
const steering = new Steering(element, {send: (message) => notes.push(message), fateSince: () => "sent"});

const pressed = (numbers, length = 17) => Array.from({length}, (_, i) => ({pressed: numbers.includes(i)}));
const result = JSON.parse(steps).map(({view, axes, buttons, is_there = true, map, mode, focus = true, pads: more}) => {
  notes.length = 0;
  now += 50;
  if (map !== undefined) gamepads.choose(map);
  if (mode) steering.mode = mode;
  if (view) document.body.dataset.view = view;
  element.contains = () => focus;
  pads = more ? more.map((one) => one && {connected: true, ...one, buttons: pressed(one.buttons, one.count)}) : is_there ? [null, {connected: true, index: 1, id: "pad", axes, buttons: pressed(buttons)}] : [null, null];
  steering.tick();
  return {notes: [...notes], level: steering.level, mode: steering.mode, fate: element.dataset.fate};
});
console.log(JSON.stringify({result, usual: mapping(null), kept: mapping(JSON.parse(kept)), read: read({axes: [NaN, 5], buttons: []}, mapping(null)).axes}));
