// What is laid over the map: where somebody pointed, the plan that is drawn, and the other aircraft.

import {metres, towards, bearing} from "./map.js";
import {m100} from "./shell.js";

const emit = (name, value) => window.emitEvent(name, value);

// -- what was pointed at, and what flies to where somebody pointed ------------------------------

const AHEAD_M = 30;  // of the line that shows a heading
const LIVES = {sent: "#757575", accepted: "#9e9d24", old: "#757575", refused: "#c62828", ended: "#757575"};
const ahead = (from, yaw) => towards(from, yaw, AHEAD_M);

let layers = null;
let drawn = {};
let dragged = null;  // what is under a finger now shows itself
let handleAt = 90;  // where on its circle the handle stands, degrees from north

m100.onMap((map) => {
  const L = window.L;
  const line = (colour) => L.polyline([], {color: colour, weight: 3, dashArray: "4 6", interactive: false});
  const circle = (colour) => L.circle([0, 0], {radius: 1, color: colour, fill: false, weight: 3, interactive: false});
  const mark = (name, isDraggable) => {
    const icon = L.divIcon({className: `point ${name}`, html: "", iconSize: [44, 44]});
    return L.marker([0, 0], {icon, draggable: isDraggable, keyboard: false, zIndexOffset: 900});
  };
  layers = {
    pointed: {mark: mark("pointed", true), circle: circle("#1565c0"), line: line("#1565c0")},
    flown: {mark: mark("flown", false), circle: circle("#2e7d32"), line: line("#2e7d32")},
    radius: mark("handle radius", true),
    yaw: mark("handle yaw", true),
  };
  follow(layers.radius, "radius", (at) => {
    const centre = drawn.pointed.place;
    if (!centre) return null;  // something else was chosen meanwhile
    const radius = Math.hypot(...metres(at, centre));
    handleAt = bearing(at, centre);
    layers.pointed.circle.setRadius(radius);
    return radius;
  });
  follow(layers.yaw, "yaw_deg", (at) => {
    const from = map.position.slice(0, 2), yaw = bearing(at, from);
    layers.pointed.line.setLatLngs([from, ahead(from, yaw)]);
    return yaw;
  });
  // While it zooms, what is seen is not yet where it will be.
  map.leaflet.on("click", ({latlng}) => map.leaflet._animatingZoom || point(latlng));
  watchDrag(layers.pointed.mark);
  layers.pointed.mark.on("dragend", () => point(layers.pointed.mark.getLatLng()));
  m100.onLive(() => redraw(map));
  redraw(map);
});

function point({lat, lng}) {
  emit("map_pointed", {view: document.body.dataset.view, place: [lat, lng]});
}

function watchDrag(mark) {
  mark.on("dragstart", () => { dragged = mark; });
  mark.on("dragend", () => { dragged = null; });
}

// A handle shows at once what it is dragged to, and says it when it is let go.
function follow(handle, name, read) {
  const at = () => [handle.getLatLng().lat, handle.getLatLng().lng];
  watchDrag(handle);
  handle.on("drag", () => read(at()));
  handle.on("dragend", () => emit("map_dragged", {name, value: read(at())}));
}

// {pointed, flown, handles}: the first two each {place: [latitude, longitude] or null, radius, yaw:
// degrees or null}; handles are there for the operator in control.
export function drawPointed(wanted) {
  drawn = wanted;
  if (m100.map) redraw(m100.map);
}

function redraw(map) {
  map.aimed = drawn.pointed?.place ?? null;
  for (const name of ["pointed", "flown"]) {
    const {mark, circle, line} = layers[name], {place, radius, yaw} = drawn[name] || {};
    if (name === "pointed" && dragged) continue;
    show(map, mark, place && (() => mark.setLatLng(place)));
    show(map, circle, place && radius && (() => circle.setLatLng(place).setRadius(radius)));
    const from = map.position?.slice(0, 2);
    const to = place || (from && yaw !== null && yaw !== undefined && ahead(from, yaw));
    show(map, line, from && to && (() => line.setLatLngs([from, to])));
    if (name === "flown") showLife(layers.flown, drawn.flown?.life);
  }
  if (!dragged) showHandles(map);
}

// How far the order of this page has come, or that of another one, which flies.
function showLife({mark, circle, line}, life) {
  for (const one of [circle, line]) one.setStyle({color: LIVES[life] ?? "#2e7d32"});
  const image = mark.getElement();
  if (image) image.dataset.life = life;
}

function showHandles(map) {
  const {place, radius, yaw} = drawn.handles ? drawn.pointed || {} : {};
  show(map, layers.radius, place && radius && (() => layers.radius.setLatLng(towards(place, handleAt, radius))));
  const from = map.position?.slice(0, 2), turns = yaw !== null && yaw !== undefined;
  show(map, layers.yaw, from && !place && turns && (() => layers.yaw.setLatLng(ahead(from, yaw))));
}

function show(map, layer, set) {
  if (!set) return layer.remove();
  set();
  if (!map.leaflet.hasLayer(layer)) layer.addTo(map.leaflet);
}

// -- the plan: its points and the corners of its area, to be dragged ----------------------------

let group = null;
let plan = null;

const MOST_BYTES = 500000;  // of a file; a plan of 99 points has a tenth of that

const isPlanning = () => document.body.dataset.view === "plan";

m100.onMap((map) => {
  group = window.L.layerGroup().addTo(map.leaflet);
  for (const tab of document.querySelectorAll("[data-go]"))
    tab.addEventListener("click", () => setTimeout(redrawPlan));
  redrawPlan();
});

// {points: [[latitude, longitude, is wrong], …], area: [[latitude, longitude], …], outline: its corners, chosen: index}
export function drawPlan(wanted) {
  plan = wanted;
  if (group) redrawPlan();
}

function redrawPlan() {
  group.clearLayers();
  if (!plan || !isPlanning()) return;
  const L = window.L, {points, area, outline, chosen} = plan;
  if (area.length) L.polygon(outline, {color: "#00838f", weight: 2, interactive: false}).addTo(group);
  if (points.length)
    L.polyline(points.map((one) => one.slice(0, 2)), {color: "#8e24aa", weight: 3, interactive: false}).addTo(group);
  area.forEach((place, i) => planMark("corner", i, place, "", "corner"));
  points.forEach(([latitude, longitude, isWrong], i) =>
    planMark("point", i, [latitude, longitude], i + 1, `${isWrong ? "wrong" : ""} ${i === chosen ? "chosen" : ""}`));
}

function planMark(kind, index, place, text, look) {
  const icon = window.L.divIcon({className: `waypoint ${look}`, html: `<span>${text}</span>`, iconSize: [44, 44]});
  const marker = window.L.marker(place, {icon, draggable: true, keyboard: false, zIndexOffset: 950});
  marker.on("dragend", () => {
    const {lat, lng} = marker.getLatLng();
    emit("plan_moved", {kind, index, place: [lat, lng]});
  });
  marker.on("click", () => kind === "point" && emit("plan_chosen", {index}));
  marker.addTo(group);
}

// Show all of it.
export function fit() {
  const places = [...plan.points.map((one) => one.slice(0, 2)), ...plan.area];
  if (!places.length || !m100.map) return;
  m100.map.setFollow(false);
  m100.map.leaflet.fitBounds(places, {padding: [60, 60], maxZoom: 19, animate: false});
}

// Read the file that was chosen in an input.
export async function open(input) {
  const [file] = input.files;
  if (!file) return;
  const text = file.size > MOST_BYTES ? null : await file.text();
  input.value = "";  // the same file once more is news, too
  emit("plan_opened", {text});
}

// -- the other aircraft, from the same messages as the one that is shown ------------------------

const marks = new Map();

m100.onMap((map) => m100.onLive((live) => {
  for (const other of live.others || []) showAircraft(map, other);
  if (!live.t) for (const mark of marks.values()) mark.getElement()?.classList.add("stale");
}));

function showAircraft(map, other) {
  let mark = marks.get(other.name);
  if (!mark) {
    if (!other.pos) return;
    const svg = '<svg viewBox="-12 -12 24 24"><path d="M0-11 8 9 0 4-8 9Z"/></svg>';
    const icon = window.L.divIcon({className: "aircraft other", html: svg, iconSize: [28, 28]});
    mark = window.L.marker(other.pos.slice(0, 2), {icon, interactive: false, keyboard: false});
    mark.bindTooltip(other.name, {permanent: true, direction: "right", offset: [12, 0]}).addTo(map.leaflet);
    marks.set(other.name, mark);
  }
  mark.getElement().classList.toggle("stale", !other.pos);
  if (other.pos) mark.setLatLng(other.pos.slice(0, 2));
  if (other.yaw !== undefined) mark.getElement().firstChild.style.transform = `rotate(${other.yaw}deg)`;
}
