// A page without a screen: its own socket, steering and orders, on the time that it is told. The
// first argument is the folder of the page's scripts, the second what this tab kept. Each line of
// the input has the time, ms, what the page hears, and what its operator does; the answer has what
// the page sends, and what it shows.

import readline from "node:readline";

const [folder, kept] = process.argv.slice(2);

let now = 0, timers = [], sent = [], count = 0;
const later = (work, ms, every = 0) => { timers.push({at: now + ms, work, every, id: ++count}); return count; };
globalThis.setTimeout = later;
globalThis.setInterval = (work, ms) => later(work, ms, ms);
globalThis.clearTimeout = (id) => { timers = timers.filter((one) => one.id !== id); };
Object.defineProperty(globalThis, "performance", {value: {now: () => now}});
Object.defineProperty(globalThis, "navigator", {value: {getGamepads: () => []}});

class Element {
  dataset = {};
  textContent = "";
  hidden = true;
  listeners = {};
  style = {setProperty() {}};
  classList = {toggle() {}};
  addEventListener(name, work) { this.listeners[name] = work; }
  contains() { return true; }
  getAttribute() { return null; }
  querySelectorAll() { return []; }
  querySelector(selector) { return find(selector); }
}
const elements = {};
const find = (selector) => elements[selector] ??= new Element();

const stored = {"m100link.orders": kept};
globalThis.sessionStorage = {getItem: (key) => stored[key] ?? null, setItem: (key, text) => { stored[key] = text; }};
globalThis.localStorage = {getItem: () => null, setItem() {}};
globalThis.location = {hash: "", protocol: "http:", host: ""};
globalThis.window = {addEventListener() {}, emitEvent() {}};
globalThis.document = Object.assign(new Element(), {
  hasFocus: () => true, hidden: false, activeElement: null, documentElement: {}, body: find("body"),
  querySelector: find, getElementById: () => null,
});

globalThis.WebSocket = class {
  static OPEN = 1;
  readyState = 1;
  bufferedAmount = 0;
  send(text) { sent.push(text); }
};

const orders = await import(`${folder}/orders.js`);
const said = await import(`${folder}/said.js`);
const {Socket} = await import(`${folder}/socket.js`);
const {Steering} = await import(`${folder}/steer.js`);
const pad = find("#pad");
let socket, steering;

function start() {
  said.choose({words: {unanswered: "{orders}"}});
  socket = new Socket("", () => {});
  steering = new Steering(pad, socket);
  steering.setMode(2);
  orders.start();
}

function run(until) {
  for (;;) {
    const due = timers.reduce((first, one) => (one.at <= until && !(one.at >= first?.at) ? one : first), null);
    if (!due) break;
    now = Math.max(now, due.at);
    if (due.every) due.at += due.every;
    else timers = timers.filter((one) => one !== due);
    due.work();
  }
  now = until;
}

const key = (code) => ({code, repeat: false, preventDefault() {}});
const does = {
  down: (code) => steering.keyDown(key(code)),
  up: (code) => steering.keyUp(key(code)),
  // A button, or STOP as in shell.js: the number of the press.
  press(name) {
    const press = orders.order({getAttribute: () => name}, socket.isUnheard);
    if (name.startsWith("stop")) {
      steering.rest();
      socket.send({op: "stop", press});
    }
    return press;
  },
  answered: orders.answered,
  seen: () => find("#unanswered-seen").listeners.click(),
  cut() {
    socket.socket.readyState = 3;
    socket.socket.onclose();
  },
};

for await (const line of readline.createInterface({input: process.stdin})) {
  const {at, heard, done} = JSON.parse(line);
  if (!socket) {
    now = at;
    start();
  }
  run(at);
  for (const message of heard) socket.socket.onmessage?.({data: JSON.stringify(message)});
  const results = done.map(([what, value]) => does[what](value));
  console.log(JSON.stringify({
    sent, results, kept: stored["m100link.orders"], age: socket.age, isLost: socket.isLost,
    pad: pad.dataset.fate, did: find("#did").textContent,
    unanswered: find("#unanswered").hidden ? "" : find("#unanswered-said").textContent,
  }));
  sent = [];
}
