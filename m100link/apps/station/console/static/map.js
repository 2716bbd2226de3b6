// What is drawn on the map, and how it follows; Leaflet itself comes with the page.

import {length, onChoose, units, words} from "./said.js";

const RADIUS_M = 6378137;
const isStill = matchMedia("(prefers-reduced-motion: reduce)");
const radians = (degrees) => degrees * Math.PI / 180;
const GRID_STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const DRAW_S = 0.1;
const AHEAD_S = 5;        // of the speed vector
const EDGE = 30;          // pixels of what is in sight around what is shown
const HEIGHT_STEP_M = 5;  // of the track's colours

// East and north of a place, m.
export function metres(to, from) {
  const north = radians(to[0] - from[0]) * RADIUS_M;
  return [radians(to[1] - from[1]) * RADIUS_M * Math.cos(radians(from[0])), north];
}

export function place(from, east, north) {
  const latitude = from[0] + north / RADIUS_M * 180 / Math.PI;
  return [latitude, from[1] + east / (RADIUS_M * Math.cos(radians(from[0]))) * 180 / Math.PI];
}

// The place so many metres away in a direction, degrees from north.
export function towards(from, yaw, far) {
  return place(from, far * Math.sin(radians(yaw)), far * Math.cos(radians(yaw)));
}

export function bearing(to, from) {
  const [east, north] = metres(to, from);
  return (Math.atan2(east, north) * 180 / Math.PI + 360) % 360;
}

const colour = (height) => `hsl(${200 - Math.max(0, Math.min(10, height / HEIGHT_STEP_M)) * 20} 85% 45%)`;

export class FlightMap {
  // Call back once the map is there: its code is loaded beside the page.
  static find(element, callback) {
    const leaflet = window.L && window.getElement?.(Number(element.dataset.vue))?.map;
    if (leaflet) callback(new FlightMap(leaflet, element));
    else setTimeout(() => FlightMap.find(element, callback), 50);
  }

  constructor(leaflet, element) {
    const L = window.L;
    this.leaflet = leaflet;
    this.element = element;
    this.follows = true;
    this.isHeadingUp = false;
    this.aimed = null;  // the place that somebody points at
    this.isPressed = false;  // what somebody aims at does not move away under the finger
    this.turned = 0;  // degrees, as drawn
    this.track = [];      // of the station: [time, latitude, longitude, height, is joined]
    this.version = null;  // of the track: with another one it begins anew
    this.flown = 0;       // points of the track that are drawn as flown
    this.runs = [];       // of these, one for each stretch of a colour
    this.home = null;
    this.drawnAt = 0;
    this.canvas = L.canvas({padding: 0.3});
    onChoose(() => this.showScale());
    this.showScale();
    this.grid = grid(L, () => this.home || this.track[0]?.slice(1, 3) || this.position);
    this.grid.addTo(leaflet);
    // Of a replay: what will be flown, and another flight to compare with.
    this.ahead = L.polyline([], {color: "#888", weight: 2, renderer: this.canvas, interactive: false}).addTo(leaflet);
    this.other = L.polyline([], {color: "#00897b", weight: 3, dashArray: "3 6", renderer: this.canvas, interactive: false}).addTo(leaflet);
    this.route = L.polyline([], {color: "#ab47bc", weight: 3, renderer: this.canvas}).addTo(leaflet);
    this.vector = L.polyline([], {color: "#ffb300", weight: 3}).addTo(leaflet);
    this.nose = L.polyline([], {color: "#e53935", weight: 2, dashArray: "6 6"}).addTo(leaflet);
    this.fence = L.circle([0, 0], {radius: 1, color: "#ef6c00", fill: false, interactive: false, dashArray: "8 6"});
    this.aircraft = null;
    leaflet.on("dragstart", () => this.setFollow(false));
    document.addEventListener("click", (event) => this.choose(event.target.closest("[data-map]")));
    turnGestures(this);
    this.keepStillWhilePressed();
    new ResizeObserver(() => leaflet.invalidateSize({pan: false})).observe(element);
  }

  showScale() {
    this.scale?.remove();
    const isImperial = units.length[1] === "ft";
    this.scale = window.L.control.scale({maxWidth: 80, imperial: isImperial, metric: !isImperial}).addTo(this.leaflet);
  }

  choose(button) {
    if (!button) return;
    const what = button.dataset.map;
    if (what === "in" || what === "out") this.leaflet.setZoom(this.leaflet.getZoom() + (what === "in" ? 1 : -1));
    else if (what === "follow") this.setFollow(!this.follows);
    else if (what === "turn") this.setHeadingUp(!this.isHeadingUp);
  }

  setFollow(follows) {
    this.follows = follows;
    document.querySelector("[data-map=follow]").setAttribute("aria-pressed", follows);
    if (follows) this.keepInSight();
  }

  setHeadingUp(isHeadingUp) {
    this.isHeadingUp = isHeadingUp;
    document.querySelector("[data-map=turn]").setAttribute("aria-pressed", isHeadingUp);
    this.element.parentElement.classList.toggle("turned", isHeadingUp);
    this.turn();
    this.leaflet.invalidateSize({pan: false});
    this.keepInSight();
  }

  keepStillWhilePressed() {
    this.element.addEventListener("pointerdown", () => { this.isPressed = true; }, {capture: true});
    for (const end of ["pointerup", "pointercancel", "blur"])
      window.addEventListener(end, () => { this.isPressed = false; });
  }

  turn() {
    if (!this.isHeadingUp) this.turned = 0;
    else if (this.attitude) this.turned = -this.attitude[2];
    this.element.parentElement.style.setProperty("--turned", `${this.turned}deg`);
  }

  // The route of a plan, [[latitude, longitude], …], and [centre, radius] beyond which the guards
  // let nobody fly, or null.
  setChart(route, fence) {
    this.route.setLatLngs(route);
    if (fence) this.fence.setLatLng(fence[0]).setRadius(fence[1]).addTo(this.leaflet);
    else this.fence.remove();
  }

  // The track and home, which the station keeps: points from a number on, and the time up to which
  // it was flown; null for all of it. Nothing else is drawn as flown.
  setTrack({version, from, points, home, until, other}) {
    if (version !== this.version) {
      this.version = version;
      this.track = [];
      this.undraw();
    }
    this.track.splice(from, Infinity, ...points);
    if (home) this.setHome(home);
    const end = until === null ? this.track.length : this.track.findLastIndex((point) => point[0] <= until) + 1;
    if (end < this.flown) this.undraw();
    for (; this.flown < end; this.flown++) this.extend(this.flown);
    if (points.length && until !== null) this.ahead.setLatLngs(joined(this.track));
    if (other !== undefined) this.other.setLatLngs(joined(other));
    if (points.length && !this.position) this.show(points[0].slice(1, 3));
  }

  undraw() {
    this.flown = 0;
    this.runs.splice(0).forEach((run) => run.remove());
  }

  setHome(home) {
    if (this.home?.join() === home.join()) return;
    this.home = home;
    const icon = window.L.divIcon({className: "home", html: "H", iconSize: [24, 24]});
    this.homeMark ??= window.L.marker(home, {icon, interactive: false, keyboard: false}).addTo(this.leaflet);
    this.homeMark.setLatLng(home);
    this.grid.redraw();
  }

  draw(live) {
    if (live.t && live.t - this.drawnAt < DRAW_S) return;
    this.drawnAt = live.t || 0;
    this.element.dataset.stale = live.pos ? "" : "stale";
    this.attitude = live.att;
    if (live.pos) {
      if (!this.position) this.show(live.pos);
      this.position = live.pos;
    }
    if (live.att && !this.isPressed) this.turn();
    if (!this.position) return;
    this.drawAircraft(live);
    this.drawHome(live);
    if (live.pos && this.follows) this.keepInSight();
  }

  show(position) {
    this.leaflet.setView(position.slice(0, 2), 19, {animate: false});
    this.keepInSight();
    this.grid.redraw();
  }

  extend(number) {
    const [, latitude, longitude, height, isJoined] = this.track[number];
    const tint = colour(Math.floor(height / HEIGHT_STEP_M) * HEIGHT_STEP_M);
    const run = this.runs[this.runs.length - 1];
    if (isJoined && run && run.options.color === tint) return run.addLatLng([latitude, longitude]);
    const points = this.track.slice(isJoined ? number - 1 : number, number + 1).map((point) => point.slice(1, 3));
    const line = window.L.polyline(points, {color: tint, weight: 4, renderer: this.canvas, interactive: false});
    this.runs.push(line.addTo(this.leaflet));
  }

  drawAircraft(live) {
    const at = this.position.slice(0, 2);
    if (!this.aircraft) {
      const svg = '<svg viewBox="-12 -12 24 24"><path d="M0-11 8 9 0 4-8 9Z"/></svg>';
      const icon = window.L.divIcon({className: "aircraft", html: svg, iconSize: [36, 36]});
      this.aircraft = window.L.marker(at, {icon, interactive: false, keyboard: false, zIndexOffset: 1000});
      this.aircraft.addTo(this.leaflet);
    }
    this.aircraft.setLatLng(at);
    const image = this.aircraft.getElement();
    image.classList.toggle("stale", !live.pos);
    if (live.att) image.firstChild.style.transform = `rotate(${live.att[2]}deg)`;
    const [, , north, east] = live.vel || [];
    this.vector.setLatLngs(live.pos && Math.hypot(north, east) > 0.2
      ? [at, place(at, east * AHEAD_S, north * AHEAD_S)] : []);
    this.nose.setLatLngs(live.pos && live.att ? [at, towards(at, live.att[2], 0.12 * this.span())] : []);
  }

  // Metres across what is seen.
  span() {
    const bounds = this.leaflet.getBounds();
    return metres([bounds.getNorth(), 0], [bounds.getSouth(), 0])[1];
  }

  drawHome(live) {
    const text = document.querySelector("#map-home");
    if (!text) return;
    if (!this.home) return void (text.textContent = words("home_unseen"));
    const far = Math.hypot(...metres(this.home, this.position));
    const way = {far: length(far), bearing: Math.round(bearing(this.home, this.position)) % 360};
    const shown = live.pos ? words(far < 1 ? "home" : "home_way", way) : words("home_old");
    if (text.textContent !== shown) text.textContent = shown;
  }

  // Moved only when it has to be: a map that stands still costs nothing.
  keepInSight() {
    if (!this.position || this.isPressed) return;
    const view = this.element.closest("#map-view").getBoundingClientRect(), free = freeOf(view);
    const x = (free.left + free.right) / 2 - view.left, y = (free.top + free.bottom) / 2 - view.top;
    const frame = this.element.parentElement.style;
    frame.setProperty("--x", `${x}px`);
    frame.setProperty("--y", `${y}px`);
    const size = this.leaflet.getSize(), at = this.leaflet.latLngToContainerPoint(this.position);
    const [wide, high] = [free.right - free.left, free.bottom - free.top];
    // With a point that somebody aims at, the middle between the two.
    const between = this.aimed ? this.leaflet.latLngToContainerPoint(this.aimed).subtract(at).divideBy(2) : {x: 0, y: 0};
    const within = (value, room) => Math.max(-room, Math.min(room, value));
    const isCentred = this.isHeadingUp || size.x < view.width / 2;  // small, beside a video
    const target = isCentred ? size.divideBy(2)
      : window.L.point(x - within(between.x, wide / 2 - EDGE), y - within(between.y, high / 2 - EDGE));
    const off = at.subtract(target), part = this.aimed ? 8 : 4;
    const slack = isCentred ? [2, 2] : [wide / part, high / part];
    if (Math.abs(off.x) > slack[0] || Math.abs(off.y) > slack[1])
      this.leaflet.panBy(off, {animate: !isStill.matches && !this.isHeadingUp && off.distanceTo([0, 0]) < size.y / 2, duration: 0.4});
  }
}

// The lines of a track, each as far as it is joined.
function joined(track) {
  const lines = [];
  for (const [, latitude, longitude, , isJoined] of track) {
    if (!isJoined || !lines.length) lines.push([]);
    lines[lines.length - 1].push([latitude, longitude]);
  }
  return lines;
}

const OVER_MAP = ".place.steering, .place.hud > *, .place.prepared > *, section[data-view=plan] > *";
let free = {key: "", box: null};

// The most room that nothing covers: as wide and high as can be, and looked for only when something
// has come, gone or moved.
function freeOf(view) {
  const boxes = [...document.querySelectorAll(OVER_MAP)].map((one) => one.getBoundingClientRect());
  const over = [view, ...boxes.filter((box) => box.width && box.height)];
  const key = over.map((box) => [box.left, box.top, box.right, box.bottom].map(Math.round)).join();
  if (key !== free.key) free = {key, box: widest(view, over.slice(1))};
  return free.box;
}

function widest(view, boxes) {
  const edges = (low, high) => [...new Set([view[low], view[high], ...boxes.flatMap((box) => [box[low], box[high]])])]
    .filter((at) => at >= view[low] && at <= view[high]).sort((one, two) => one - two);
  const across = edges("left", "right"), down = edges("top", "bottom");
  let best = view, most = [0, 0];
  for (const left of across) for (const right of across) for (const top of down) for (const bottom of down) {
    const wide = right - left, high = bottom - top, least = Math.min(wide, high);
    if (least < most[0] || (least === most[0] && wide * high <= most[1]) || least <= 0) continue;
    const isCovered = (box) => box.left < right && box.right > left && box.top < bottom && box.bottom > top;
    if (!boxes.some(isCovered)) [best, most] = [{left, top, right, bottom}, [least, wide * high]];
  }
  return best;
}

// A grid in metres, for where there are no tiles: its lines go through home.
function grid(L, origin) {
  const Grid = L.GridLayer.extend({
    createTile(coordinates) {
      const tile = document.createElement("canvas"), size = this.getTileSize();
      tile.width = size.x; tile.height = size.y;
      const from = origin();
      if (!from) return tile;
      const corner = (x, y) => {
        const at = this._map.unproject(coordinates.scaleBy(size).add([x, y]), coordinates.z);
        return metres([at.lat, at.lng], from);
      };
      const [west, north] = corner(0, 0), [east, south] = corner(size.x, size.y);
      const step = GRID_STEPS.find((one) => one * size.x / (east - west) > 40);
      if (!step) return tile;
      const g = tile.getContext("2d");
      for (let x = Math.ceil(west / step); x * step < east; x++)
        line(g, x, [(x * step - west) / (east - west) * size.x, 0, 0, size.y]);
      for (let y = Math.ceil(south / step); y * step < north; y++)
        line(g, y, [0, (north - y * step) / (north - south) * size.y, size.x, 0]);
      return tile;
    },
  });
  return new Grid({maxZoom: 22, pane: "tilePane", zIndex: 5});
}

function line(g, number, [x, y, across, down]) {
  g.strokeStyle = number % 5 ? "rgba(128, 128, 128, .35)" : "rgba(128, 128, 128, .8)";
  g.beginPath();
  g.moveTo(x, y);
  g.lineTo(x + across, y + down);
  g.stroke();
}

// While the map is turned, Leaflet's places of the pointer have to be turned back.
function turnGestures(map) {
  const leaflet = map.leaflet;
  const back = (x, y) => {
    const angle = -radians(map.turned);
    return [x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle)];
  };
  const plain = leaflet.mouseEventToContainerPoint.bind(leaflet);
  leaflet.mouseEventToContainerPoint = (event) => {
    if (!map.turned) return plain(event);
    const box = map.element.getBoundingClientRect(), size = leaflet.getSize();
    const [x, y] = back(event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2);
    return window.L.point(size.x / 2 + x, size.y / 2 + y);
  };
  leaflet.dragging._draggable?.on("predrag", function () {
    if (!map.turned) return;
    const moved = this._newPos.subtract(this._startPos);
    this._newPos = this._startPos.add(back(moved.x, moved.y));
  });
}
