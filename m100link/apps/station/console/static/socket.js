// The socket of the page: beats out, instruments in, and the times that tell how old either is.

import {answered} from "./orders.js";
import {number, words} from "./said.js";

const ALIVE_MS = 500;
const LOST_MS = 1000;
const VIEW_MS = 2000;  // the texts of the page come four times a second
const TOLD_MS = 300;  // what the station said of a press counts for so long after it came
const OLDEST_MS = 700;  // and for so long after the beat that it is about: nobody steers by a slower way

export class Socket {
  constructor(path, onMessage) {
    this.path = path;
    this.onMessage = onMessage;
    this.count = 0;
    this.heardAt = 0;
    this.tripMs = null;
    this.forget();
    this.connect();
    setInterval(() => this.send({op: "alive"}), ALIVE_MS);
    setInterval(() => this.watch(), 100);
  }

  forget() {
    this.told = null;  // the station's time that was heard last, and when
    this.live = null;
    this.fate = null;  // what became of what is held: of the beat of when, and when that was heard
    this.best = Infinity;  // of the differences between our clock and the station's, the smallest
  }

  connect() {
    this.forget();
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}${this.path}`);
    this.socket.onmessage = (event) => {
      this.heardAt = performance.now();
      const message = JSON.parse(event.data);
      if (message.op === "echo") {
        this.hear(message.told);
        this.roundTrip(performance.now() - message.at);
        if (message.press !== undefined) answered(message.press);
        if (message.fate !== undefined) this.fate = {fate: message.fate, of: message.at, at: this.heardAt};
      } else if (message.op === "live") {  // of the others only the arrival counts
        // The clocks may drift by a ten-thousandth.
        this.best = Math.min(this.best + 5e-6, performance.now() / 1000 - message.t);
        this.live = message;
        this.hear(message.t);
        this.onMessage(message);
      }
    };
    this.socket.onclose = () => setTimeout(() => this.connect(), 1000);
  }

  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    // Old beats are worse than none.
    if (this.socket.bufferedAmount > 4096 && message.op !== "stop") return;
    const at = performance.now();
    const heard = this.told ? {told: this.told.told, held: at - this.told.at} : {};
    this.socket.send(JSON.stringify({...message, ...heard, n: ++this.count, at}));
  }

  // The station learns by what it is told again how long buttons are on their way: at once.
  hear(told) {
    const isFirst = !this.told;
    this.told = {told, at: this.heardAt};
    if (isFirst) this.send({op: "alive"});
  }

  // Seconds that what is shown is old, by the page's own clock.
  get age() {
    if (!this.live) return Infinity;
    const late = performance.now() / 1000 - this.live.t - this.best;
    return late + (this.tripMs || 0) / 2000;
  }

  // What the station says of the press that began then. Until it does it was only sent; where it
  // does no more, nobody knows.
  fateSince(beganAt) {
    const told = this.fate, now = performance.now();
    if (!told || told.of < beganAt) return now - beganAt > OLDEST_MS ? "old" : "sent";
    return now - told.at > TOLD_MS || now - told.of > OLDEST_MS ? "old" : told.fate;
  }

  // The station's clock, by this page's: what was told fastest stands for no delay.
  get stationNow() {
    return performance.now() / 1000 - this.best;
  }

  // Nothing of the station arrives.
  get isUnheard() {
    return performance.now() - this.heardAt > LOST_MS;
  }

  // How old the texts of the page are; they come by another way than the instruments.
  get textsAgeMs() {
    const beat = document.getElementById("view-beat")?.dataset.at;
    return beat === undefined ? 0 : 1000 * (this.stationNow - Number(beat));
  }

  // What is shown is old: nothing arrives, it was long on its way, or the page itself hangs back.
  get isLost() {
    return this.isUnheard || this.age * 1000 > LOST_MS || this.textsAgeMs > VIEW_MS;
  }

  roundTrip(ms) {
    this.tripMs = ms;
    fill("browser_ms", `${ms.toFixed(0)} ms`);
  }

  watch() {
    const age = this.live ? this.live.age : undefined;
    fill("age", age === undefined ? "–" : words("age", {seconds: number(age + this.age, 1)}));
    document.body.classList.toggle("station-lost", this.isLost);
  }
}

function fill(name, text) {
  for (const field of document.querySelectorAll(`[data-field="${name}"]`))
    if (field.textContent !== text) field.textContent = text;
}
