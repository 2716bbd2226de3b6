// Which presses are meant: the one gate before everything here that gives an order, installed before
// all that listens. What a page of another site can bring about without a person at this one (a focus
// that a fragment moved, a key that is held since before, an event that a script made) gives none.
//
// STOP passes always.

const QUIET_MS = 1000;  // after a focus that nobody at this page moved
const CAUSED_MS = 500;  // a press moves the focus within that time

const ORDERS = "button:not([data-go]), [role=button], [role=checkbox], [role=switch], #pad";
const STOPS = "[data-act=stop], [data-stop]";

let pressedAt = -Infinity;  // by a pointer, or Tab
let quietUntil = -Infinity;
let accepted = null;  // the key that is down by a press here: {code, target}
let isRefused = false;  // the last press of a key, whose click may still come
let cameByFragment = location.hash !== "";
let onRefused = () => {};

// What says so to the operator.
export function tellRefused(callback) { onRefused = callback; }

// Whether the operator moved the focus to where it is, or had a second to see it.
export const isSettled = () => performance.now() >= quietUntil;

const order = (target) => {
  const found = target?.closest?.(ORDERS);
  return found && !found.closest(STOPS) ? found : null;
};

function refuse(event) {
  event.preventDefault();
  event.stopImmediatePropagation();
}

function settle() {
  pressedAt = performance.now();
  quietUntil = -Infinity;
  isRefused = cameByFragment = false;
}

function quiet() {
  if (performance.now() - pressedAt <= CAUSED_MS) return;
  quietUntil = performance.now() + QUIET_MS;
  accepted = null;
  if (cameByFragment && order(document.activeElement)) document.activeElement.blur();
}

const isPress = (event) => event.code === "Enter" || event.code === "Space";
const isAccepted = (event) => accepted?.code === event.code && accepted.target === event.target;

function keyDown(event) {
  if (event.isTrusted && event.code === "Tab") settle();
  if (!order(event.target)) return;
  if (!event.isTrusted) return refuse(event);
  const moves = event.target.closest("#pad") && event.key.length === 1;
  if (!isPress(event) && !moves) return;
  if (event.repeat) {
    if (!isAccepted(event)) isRefused = true;
    return refuse(event);
  }
  isRefused = !isSettled();
  accepted = isRefused ? null : {code: event.code, target: event.target};
  if (!isRefused) return;
  refuse(event);
  onRefused();
}

// What is pressed by the end of a key alone; anything else may end.
function keyUp(event) {
  if (isPress(event) && order(event.target)?.matches("[role]") && !isAccepted(event)) refuse(event);
}

function click(event) {
  if (!order(event.target)) return;
  const isOfKey = event.detail === 0;
  if (!event.isTrusted || isOfKey && (isRefused || !isSettled())) refuse(event);
}

function pointerDown(event) {
  if (event.isTrusted) settle();
}

// A fragment names a place to look at and moves the focus there, whatever it is that stands there.
function leaveFragment() {
  quiet();
  if (order(document.activeElement)) document.activeElement.blur();
}

const first = {capture: true};
window.addEventListener("keydown", keyDown, first);
window.addEventListener("keyup", keyUp, first);
window.addEventListener("click", click, first);
window.addEventListener("pointerdown", pointerDown, first);
document.addEventListener("focusin", quiet, first);
window.addEventListener("focus", quiet);
window.addEventListener("pageshow", quiet);
document.addEventListener("visibilitychange", () => document.hidden || quiet());
window.addEventListener("hashchange", leaveFragment, first);
leaveFragment();
