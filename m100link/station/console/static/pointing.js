// What was pointed at on the map, and what flies to where somebody pointed.

import {m100} from "./shell.js";

const AHEAD_M = 30;  // of the line that shows a heading

let layers = null;
let drawn = {};

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
  };
  map.leaflet.on("click", ({latlng}) => point(latlng));
  layers.pointed.mark.on("dragend", () => point(layers.pointed.mark.getLatLng()));
  m100.onLive(() => redraw(map));
  redraw(map);
});

function point({lat, lng}) {
  emit("map_pointed", {view: document.body.dataset.view, place: [lat, lng]});
}

// {pointed, flown}: each {place: [latitude, longitude] or null, radius, yaw: degrees or null}.
export function draw(wanted) {
  drawn = wanted;
  if (m100.map) redraw(m100.map);
}

function redraw(map) {
  for (const name of ["pointed", "flown"]) {
    const {mark, circle, line} = layers[name], {place, radius, yaw} = drawn[name] || {};
    show(map, mark, place && (() => mark.dragging?.moving?.() || mark.setLatLng(place)));
    show(map, circle, place && radius && (() => circle.setLatLng(place).setRadius(radius)));
    const from = map.position?.slice(0, 2);
    const to = place || (from && yaw !== null && yaw !== undefined && ahead(from, yaw));
    show(map, line, from && to && (() => line.setLatLngs([from, to])));
  }
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
