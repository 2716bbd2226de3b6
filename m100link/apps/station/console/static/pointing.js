// What was pointed at on the map, and what flies to where somebody pointed.

import {metres, place as placeAt, bearing} from "./map.js";
import {m100} from "./shell.js";

const AHEAD_M = 30;  // of the line that shows a heading

let layers = null;
let drawn = {};
let dragged = null;  // what is under a finger now shows itself
let handleAt = 90;  // where on its circle the handle stands, degrees from north

const emit = (name, value) => window.emitEvent(name, value);

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
// degrees or null}; handles are there for whoever has control.
export function draw(wanted) {
  drawn = wanted;
  if (m100.map) redraw(m100.map);
}

function redraw(map) {
  for (const name of ["pointed", "flown"]) {
    const {mark, circle, line} = layers[name], {place, radius, yaw} = drawn[name] || {};
    if (name === "pointed" && dragged) continue;
    show(map, mark, place && (() => mark.setLatLng(place)));
    show(map, circle, place && radius && (() => circle.setLatLng(place).setRadius(radius)));
    const from = map.position?.slice(0, 2);
    const to = place || (from && yaw !== null && yaw !== undefined && ahead(from, yaw));
    show(map, line, from && to && (() => line.setLatLngs([from, to])));
  }
  if (!dragged) showHandles(map);
}

function showHandles(map) {
  const {place, radius, yaw} = drawn.handles ? drawn.pointed || {} : {};
  const angle = handleAt * Math.PI / 180;
  show(map, layers.radius, place && radius && (() => layers.radius.setLatLng(
    placeAt(place, radius * Math.sin(angle), radius * Math.cos(angle)))));
  const from = map.position?.slice(0, 2), turns = yaw !== null && yaw !== undefined;
  show(map, layers.yaw, from && !place && turns && (() => layers.yaw.setLatLng(ahead(from, yaw))));
}

function ahead([latitude, longitude], yaw) {
  const angle = yaw * Math.PI / 180, metre = 180 / Math.PI / 6378137;
  const north = AHEAD_M * Math.cos(angle), east = AHEAD_M * Math.sin(angle);
  return [latitude + north * metre, longitude + east * metre / Math.cos(latitude * Math.PI / 180)];
}

function show(map, layer, set) {
  if (!set) return layer.remove();
  set();
  if (!map.leaflet.hasLayer(layer)) layer.addTo(map.leaflet);
}
