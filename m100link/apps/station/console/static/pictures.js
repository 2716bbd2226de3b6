// Pictures: tiles below the map, and a live video that changes places with it by one tap.

import {number, onChoose, words} from "./said.js";
import {m100} from "./shell.js";

const find = (selector) => document.querySelector(selector);

// -- tiles -----------------------------------------------------------------------------------------

let layer = null;
let source = () => "";  // what the map says of its tiles
const tell = () => { find("#map-source").textContent = source(); };
onChoose(tell);

// What the station found in its file: {zooms: [least, greatest] or null, licence, version, fault or null}
export function showTiles({zooms, licence, version, fault}) {
  m100.onMap(({leaflet}) => {
    layer?.remove();
    layer = null;
    source = () => words(`tiles_${fault}`);
    if (zooms) {
      const options = {minZoom: zooms[0], maxNativeZoom: zooms[1], maxZoom: 22, zIndex: 1};
      let seen = 0;
      source = () => licence;
      layer = window.L.tileLayer(`/tiles/{z}/{x}/{y}?v=${version}`, options);
      layer.on("loading", () => { seen = 0; });
      layer.on("tileload", () => { seen++; });
      layer.on("load", () => {
        source = () => seen ? licence : `${words("tiles_elsewhere")} ${licence}`;
        tell();
      });
      layer.addTo(leaflet);
    }
    tell();
  });
}

// -- video -----------------------------------------------------------------------------------------
// It comes from where the user said, and never through the station. Its age is that of the newest
// picture here; how long it was on its way nobody can tell.

const LIVE_MS = 1500;       // younger than this a picture needs no age
const GIVEN_UP_MS = 10000;  // without a picture: the stream is asked for anew
const AGAIN_MS = 3000;
const TELL_MS = 2000;       // between two words to the log
const GATHER_MS = 1000;
const MOST_BYTES = 8e6;     // of a picture
const WINDOW = 4096;        // bytes in one search; no head of a part has more

const sleep = (time) => new Promise((done) => setTimeout(done, time));
const ended = (signal) => new Promise((done) => signal.addEventListener("abort", done, {once: true}));
const asking = {mode: "cors", credentials: "omit", cache: "no-store", referrerPolicy: "no-referrer"};

// {kind: "mjpeg" or "whep", url}
export function showVideo({kind, url}) {
  const host = find("#picture"), frame = find("#video");
  if (!host || !frame) return;
  const text = Object.assign(document.createElement("span"), {className: "state"});
  const shown = {at: null, isUndated: false, fate: "", stop: null, begunAt: 0};
  const seen = () => { shown.at = performance.now(); shown.fate = ""; };
  const put = (one) => { host.replaceChildren(one, text); return one; };
  const isWanted = () => !document.hidden && frame.checkVisibility();
  let told = "", toldAt = -Infinity;

  const look = () => {
    const now = performance.now(), age = shown.at === null ? Infinity : now - shown.at;
    const isLive = age < LIVE_MS;
    if (shown.stop && (!isWanted() || (!shown.isUndated && now - Math.max(shown.begunAt, shown.at ?? 0) > GIVEN_UP_MS)))
      shown.stop.abort();
    const old = shown.at === null ? "" : words("video_old", {age: number(age / 1000, 1)});
    const fate = shown.fate || (shown.at === null ? words("video_begins") : "");
    text.textContent = isLive ? "" : shown.isUndated ? words("video_undated") : `${fate} ${old}`.trim();
    const state = isLive ? "live" : shown.isUndated ? "undated" : fate && !shown.fate ? "new" : "old";
    host.dataset.state = state;
    if (state === told || state === "new" || now - toldAt < TELL_MS || !isWanted()) return;
    [told, toldAt] = [state, now];
    window.emitEvent("video_told", state);
  };

  const play = async () => {
    const stop = shown.stop = new AbortController();
    shown.begunAt = performance.now();
    shown.isUndated = false;
    try {
      if (kind === "whep") await whep(url, put, seen, stop.signal);
      else await mjpeg(url, put, seen, shown, stop.signal);
      shown.fate = words("video_ended");
    } catch (error) {
      if (!stop.signal.aborted) shown.fate = words("video_refused", {why: error.message});
    }
    stop.abort();
    shown.stop = null;
    shown.isUndated = false;
  };

  (async () => {
    for (;;) {
      if (isWanted()) await play();
      await sleep(isWanted() ? AGAIN_MS : 250);
    }
  })();
  setInterval(look, 250);
  frame.addEventListener("click", () => frame.setAttribute("aria-pressed", document.body.classList.toggle("video-first")));
  stayInFrame(host.parentElement, frame);
}

// Where the frame is, whichever of the two stands in it.
function stayInFrame(view, frame) {
  const place = frame.closest(".place");
  const fit = () => {
    const outer = view.getBoundingClientRect(), box = frame.getBoundingClientRect(), edge = place.getBoundingClientRect();
    const all = {left: box.left - outer.left, top: box.top - outer.top, width: box.width, height: box.height,
      over: Math.max(0, edge.top - box.top), under: Math.max(0, box.bottom - edge.bottom)};
    for (const [name, value] of Object.entries(all)) view.style.setProperty(`--small-${name}`, `${value}px`);
  };
  const changes = new ResizeObserver(fit);
  for (const one of [view, frame, place, ...place.children]) changes.observe(one);
  place.addEventListener("scroll", fit);
}

async function whep(url, put, seen, signal) {
  const peer = new RTCPeerConnection(), video = put(document.createElement("video"));
  let session = null;
  Object.assign(video, {muted: true, autoplay: true, playsInline: true});
  const count = () => {
    seen();
    video.requestVideoFrameCallback(count);
  };
  if (video.requestVideoFrameCallback) video.requestVideoFrameCallback(count);
  else video.addEventListener("timeupdate", seen);
  try {
    peer.addTransceiver("video", {direction: "recvonly"});
    peer.addEventListener("track", ({track}) => { video.srcObject = new MediaStream([track]); });
    const failed = new Promise((done) => peer.addEventListener("connectionstatechange",
      () => ["failed", "closed"].includes(peer.connectionState) && done()));
    await peer.setLocalDescription();
    const gathered = new Promise((done) => peer.addEventListener("icecandidate", ({candidate}) => candidate || done()));
    await Promise.race([gathered, sleep(GATHER_MS)]);
    const headers = {"content-type": "application/sdp"};
    const answer = await fetch(url, {...asking, signal, method: "POST", headers, body: peer.localDescription.sdp});
    if (!answer.ok) throw new Error(`${answer.status} ${answer.statusText}`);
    session = answer.headers.get("location");
    await peer.setRemoteDescription({type: "answer", sdp: await answer.text()});
    await Promise.race([failed, ended(signal)]);
  } finally {
    peer.close();
    if (session) fetch(new URL(session, url), {...asking, method: "DELETE"}).catch(() => { /* it ends by itself */ });
  }
}

async function mjpeg(url, put, seen, shown, signal) {
  let answer;
  try {
    answer = await fetch(url, {...asking, signal});
  } catch (error) {
    if (signal.aborted) throw error;
    return undated(url, put, shown, signal);  // it may be there, and let no page read it
  }
  if (!answer.ok) throw new Error(`${answer.status} ${answer.statusText}`);
  const type = answer.headers.get("content-type") || "";
  if (!type.startsWith("multipart/x-mixed-replace")) throw new Error(`"${type.slice(0, 40)}"`);
  const canvas = document.createElement("canvas"), drawing = canvas.getContext("bitmaprenderer");
  const reader = answer.body.getReader(), parts = new Parts();
  for (;;) {
    const {done, value} = await reader.read();
    if (done) return;
    const picture = parts.add(value);
    if (!picture) continue;
    // Decoded beside the page; what comes meanwhile waits, and only the newest is drawn.
    const bitmap = await createImageBitmap(new Blob([picture]));
    [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
    drawing.transferFromImageBitmap(bitmap);
    if (!canvas.isConnected) put(canvas);
    seen();
  }
}

// A multipart stream, of which only the newest whole picture counts. A stranger sends it to a page that
// flies: each byte is copied and looked at once, by the browser's own search.
export class Parts {
  #bytes = new Uint8Array(1 << 16);
  #size = 0;
  #sought = 0;     // where the search goes on
  #begin = null;   // of the picture; null in front of it
  #end = null;     // of it, where its head tells that

  // The newest picture that these bytes made whole, or null. Throws Error: it or its head is too large.
  add(value) {
    if (this.#size + value.length > this.#bytes.length) {
      const larger = new Uint8Array(2 * (this.#size + value.length));
      larger.set(this.#bytes.subarray(0, this.#size));
      this.#bytes = larger;
    }
    this.#bytes.set(value, this.#size);
    this.#size += value.length;
    let picture = null, done = 0;
    for (; this.#isBegun(done); this.#begin = this.#end = null) {
      const end = this.#end ?? this.#find("\r\n--");
      if (Math.max(end, this.#size) - this.#begin > MOST_BYTES) throw new Error(`> ${MOST_BYTES / 1e6} MB`);
      if (end < 0 || end > this.#size) break;
      picture = [this.#begin, end];
      done = this.#sought = end;
    }
    picture = picture && this.#bytes.slice(...picture);
    if (done) {
      this.#bytes.copyWithin(0, done, this.#size);
      this.#size -= done;
      this.#sought -= done;
      if (this.#begin !== null) this.#begin -= done;
      if (this.#end !== null) this.#end -= done;
    }
    return picture;
  }

  // Whether the head of the part that begins there is whole.
  #isBegun(at) {
    if (this.#begin !== null) return true;
    const end = this.#find("\r\n\r\n");
    if (Math.max(end, this.#sought) - at > WINDOW) throw new Error(`> ${WINDOW} B`);
    if (end < 0) return false;
    const said = /content-length:\s*(\d+)/i.exec(latin1.decode(this.#bytes.subarray(at, end)));
    this.#begin = this.#sought = end + 4;
    this.#end = said && this.#begin + Number(said[1]);
    return true;
  }

  #find(text) {
    for (let from = this.#sought; ; from = this.#sought) {
      const end = Math.min(this.#size, from + WINDOW), at = latin1.decode(this.#bytes.subarray(from, end)).indexOf(text);
      if (at >= 0) return from + at;
      this.#sought = Math.max(from, end - text.length + 1);
      if (end === this.#size) return -1;
    }
  }
}

const latin1 = new TextDecoder("latin1");  // a character for each byte

// As an image of the browser, which needs no permission and tells nothing.
async function undated(url, put, shown, signal) {
  const image = new Image();
  try {
    await new Promise((done, failed) => {
      image.onload = done;
      image.onerror = () => failed(new Error(new URL(url).host));
      signal.addEventListener("abort", done);
      image.src = url;
    });
    put(image);
    shown.isUndated = true;
    await ended(signal);
  } finally {
    image.src = "";
  }
}
