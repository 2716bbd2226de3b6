// Orders on their way. The station answers each as soon as it has it, whatever becomes of it. Where
// that stays out the page says so by itself: a connection that is lost takes the order with it, or
// the answer. What is not answered is remembered past a reload, and told until somebody has seen it.

import {onChoose, words} from "./said.js";

const ANSWER_MS = 3000;  // an order that is 2 s on its way is refused; a busy computer may be so late
const SAID_MS = 3000;
const KEPT = "m100link.orders";

const find = (selector) => document.querySelector(selector);

let count = 0;
const sent = new Map();  // number of the press: what stands on its button
const unanswered = new Map();  // those of them that are told
let silence = 0;

function keep() {
  try {
    sessionStorage.setItem(KEPT, JSON.stringify([...sent.values()]));
  } catch { /* where nothing may be stored, a reload forgets them */ }
}

function tell() {
  const names = [...new Set(unanswered.values())].join(", ");
  find("#unanswered").hidden = !names;
  find("#unanswered-said").textContent = names && words("unanswered", {orders: names});
}

function telling(press) {
  if (!sent.has(press)) return;
  unanswered.set(press, sent.get(press));
  tell();
}

// Notes that what stands on a button is ordered; returns the number of the press.
export function order(button, isUnheard) {
  const press = ++count;
  sent.set(press, button.getAttribute("aria-label") || button.textContent.trim());
  keep();
  setTimeout(() => telling(press), isUnheard ? 0 : ANSWER_MS);
  return press;
}

// The station has it.
export function answered(press) {
  sent.delete(press);
  keep();
  if (unanswered.delete(press)) tell();
}

function seen() {
  for (const press of unanswered.keys()) sent.delete(press);
  unanswered.clear();
  keep();
  tell();
}

// What needs no station to be said, for a moment.
export function say(text) {
  const place = find("#page-said");
  place.textContent = text;
  clearTimeout(silence);
  silence = setTimeout(() => { place.textContent = ""; }, SAID_MS);
}

export function start() {
  find("#unanswered-seen").addEventListener("click", seen);
  onChoose(tell);
  let before = [];
  try {
    before = JSON.parse(sessionStorage.getItem(KEPT) || "[]");
  } catch { /* as above */ }
  for (const name of before) {
    sent.set(++count, String(name));
    telling(count);
  }
}
