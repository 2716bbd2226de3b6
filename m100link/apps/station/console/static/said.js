// What the page says by itself, in the language and the units that were chosen.

const told = {language: "en", words: {}, length: [1, "m"], speed: [1, "m/s"], point: "."};
const listeners = [];

// {language: its tag, words: text by key, length: [factor, sign], speed: [factor, sign], point: "." or ","}
export function choose(chosen) {
  Object.assign(told, chosen);
  document.documentElement.lang = told.language;
  sayQuasars();
  for (const listener of listeners) listener();
}

// What Quasar says by itself, to screen readers only.
function sayQuasars() {
  const props = window.Quasar?.lang?.props;
  if (props) props.label = {...props.label, clear: words("clear"), remove: words("remove")};
}

// What was drawn or written once is drawn again when something else is chosen.
export function onChoose(callback) { listeners.push(callback); }

export const words = (key, values = {}) =>
  (told.words[key] ?? key).replace(/\{(\w+)\}/g, (_, name) => values[name]);

export const number = (value, digits) => value.toFixed(digits).replace(".", told.point);

// A number of metres, or of metres per second, as it is shown.
export const length = (metres, digits = 0) => `${number(metres * told.length[0], digits)} ${told.length[1]}`;
export const speed = (value, digits = 1) => `${number(value * told.speed[0], digits)} ${told.speed[1]}`;

// [factor, sign] of lengths and of speeds.
export const units = told;
