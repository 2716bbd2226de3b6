// Draws on a canvas that notes what is drawn, and prints it. The first argument is the folder of the
// page's scripts, the second what it is told, several times: units, decimal sign, and a message of
// the socket.

const [folder, told] = process.argv.slice(2);

let notes = [];
let bars = {};
const context = new Proxy({fillStyle: ""}, {
  get: (target, name) => {
    if (typeof name !== "string" || name in target) return target[name];
    return (...values) => { notes.push([name, ...values, target.fillStyle]); };
  },
});
const canvas = {clientWidth: 400, clientHeight: 320, dataset: {}, getContext: () => context};

const bar = (name) => bars[name] ??= {
  classList: {toggle: (look, is) => { bars[name][look] = is; }},
  style: {setProperty: (property, value) => { bars[name][property] = value; }},
};
globalThis.window = {devicePixelRatio: 1};
globalThis.matchMedia = () => ({matches: false});
globalThis.document = {
  documentElement: {},
  querySelector: (selector) => bar(selector.match(/data-rc="(\w+)"/)[1]),
};

const said = await import(`${folder}/said.js`);
const instruments = await import(`${folder}/instruments.js`);
const map = await import(`${folder}/map.js`);

console.log(JSON.stringify(JSON.parse(told).map(({chosen, live, from, to}) => {
  [notes, bars] = [[], {}];
  said.choose(chosen);
  instruments.drawHorizon(canvas, live);
  instruments.drawChannels(live);
  const metres = map.metres(to, from);
  return {
    notes, bars, metres,
    stale: canvas.dataset.stale,
    place: map.place(from, ...metres),
    bearing: map.bearing(to, from),
    length: said.length(12.34, 1),
    speed: said.speed(-3.21),
  };
})));
