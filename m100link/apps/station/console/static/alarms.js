// Sound and speech of alarms, and how long ago something was heard.
//
// What is to be heard stands in attributes of #alarm-sound, written by the station. One alarm the
// station cannot give: that it is not heard itself. That one is made here.
import {m100} from "./shell.js";

// For each level: tones as [hertz, begin, seconds], and after how many seconds they come again.
const SOUNDS = {
  danger: [[[880, 0, .16], [660, .2, .16], [880, .4, .16], [660, .6, .16]], 1.5],
  warning: [[[587, 0, .18], [784, .22, .22]], 4],
};
const LOST_AFTER_MS = 1000;
const TEXTS_LOST_MS = 5000;  // they come four times a second

// What tests and the page read: what sounds, what was spoken, and whether the browser lets it.
export const heard = {level: "", beeps: 0, spoken: [], isBlocked: false};

let context = null;
let beepAt = 0;
let lost = {since: null, isSeen: false};
let spokenAt = -1;

const find = (selector) => document.querySelector(selector);

function allow() {
  try {
    context = context || new AudioContext();
    context.resume();
  } catch { context = null; }  // a browser without sound: words and colours remain
}

function beep(level) {
  if (!context || context.state !== "running") return false;
  const [tones, again] = SOUNDS[level];
  for (const [hertz, begin, seconds] of tones) {
    const from = context.currentTime + begin;
    const tone = new OscillatorNode(context, {type: "square", frequency: hertz});
    const volume = new GainNode(context, {gain: 0});
    volume.gain.setTargetAtTime(.25, from, .01);
    volume.gain.setTargetAtTime(0, from + seconds, .02);
    tone.connect(volume).connect(context.destination);
    tone.start(from);
    tone.stop(from + seconds + .2);
  }
  beepAt = performance.now() + 1000 * again;
  heard.beeps += 1;
  return true;
}

function speak(text, language) {
  heard.spoken.push(text);
  if (!("speechSynthesis" in window)) return;
  const words = new SpeechSynthesisUtterance(text);
  words.lang = language;
  words.rate = 1.1;
  speechSynthesis.speak(words);
}

// The button in the settings: it is a click, so the browser lets it sound.
export function attempt({text, language, sound, speech}) {
  allow();
  if (sound) context?.resume().then(() => beep("warning"));
  if (speech) speak(text, language);
}

function look() {
  const told = find("#alarm-sound");
  if (!told) return;
  const isLost = lookAtStation();
  const wanted = isLost && !lost.isSeen && !isReplay() ? "danger" : isLost ? "" : told.dataset.level;
  if (wanted !== heard.level) beepAt = 0;
  heard.level = wanted;
  if (wanted && performance.now() >= beepAt) beep(wanted);
  if (!wanted && !isLost && told.dataset.level === "") window.speechSynthesis?.cancel();
  heard.isBlocked = Boolean(wanted) && context?.state !== "running";
  find("#sound-blocked").hidden = !heard.isBlocked;
  const say = JSON.parse(told.dataset.say || "{}");
  if (say.at > spokenAt) {
    spokenAt = say.at;
    for (const text of say.texts) speak(text, say.language);
  }
  count();
}

// Nothing flies: a station that is late is shown, and warns nobody.
const isReplay = () => document.body.dataset.replay === "yes";

// Whether this page hears the station; its own alarm, in the words that the station gave it before.
function lookAtStation() {
  const socket = m100.socket;
  if (!socket || !socket.heardAt) return false;
  const silentMs = Math.max(performance.now() - socket.heardAt, socket.textsAgeMs);
  // Texts that are a moment late are shown as old, and are no alarm: a busy computer is late at times.
  const isLost = socket.isUnheard || socket.textsAgeMs > TEXTS_LOST_MS;
  const page = find("#page-lost");
  if (isLost && lost.since === null) {
    lost = {since: performance.now() - silentMs, isSeen: false};
    if (!isReplay()) speak(page.dataset.text, document.documentElement.lang);
  } else if (!isLost) lost = {since: null, isSeen: false};
  document.body.classList.toggle("unheard", isLost);
  if (isLost) fill(find("#page-lost-since"), performance.now() - lost.since - LOST_AFTER_MS / 2);
  find("#page-lost-seen").hidden = lost.isSeen;
  return isLost;
}

// Silences are counted here: the station may not be there to count them.
function count() {
  for (const place of document.querySelectorAll("[data-since]")) {
    const since = Number(place.dataset.since);
    if (place.dataset.since) fill(place, 1000 * (m100.socket.stationNow - since));
    else place.textContent = "";
  }
}

function fill(place, ms) {
  const text = Number.isFinite(ms) ? `${Math.max(0, ms / 1000).toFixed(0)} s` : "";
  if (place.textContent !== text) place.textContent = text;
}

for (const touch of ["pointerdown", "keydown"])
  document.addEventListener(touch, () => context?.state !== "running" && allow(), {capture: true});
if (navigator.userActivation?.hasBeenActive) allow();  // a touch that came before this was loaded
find("#page-lost-seen").addEventListener("click", () => { lost.isSeen = true; });
m100.heard = heard;
setInterval(look, 200);
