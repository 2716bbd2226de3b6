// The plan on the map: its points and the corners of its area, to be dragged.

import {m100} from "./shell.js";

let group = null;
let drawn = null;

const MOST_BYTES = 500000;  // of a file; a plan of 99 points has a tenth of that

const emit = (name, value) => window.emitEvent(name, value);
const isPlanning = () => document.body.dataset.view === "plan";

m100.onMap((map) => {
  group = window.L.layerGroup().addTo(map.leaflet);
  for (const tab of document.querySelectorAll("[data-go]"))
    tab.addEventListener("click", () => setTimeout(redraw));
  redraw();
});

// {points: [[latitude, longitude, is wrong], …], area: [[latitude, longitude], …], chosen: index}
export function draw(wanted) {
  drawn = wanted;
  if (group) redraw();
}

function redraw() {
  group.clearLayers();
  if (!drawn || !isPlanning()) return;
  const L = window.L, {points, area, chosen} = drawn;
  if (area.length) L.polygon(area, {color: "#00838f", weight: 2, interactive: false}).addTo(group);
  if (points.length)
    L.polyline(points.map((one) => one.slice(0, 2)), {color: "#8e24aa", weight: 3, interactive: false}).addTo(group);
  area.forEach((place, i) => mark("corner", i, place, "", "corner"));
  points.forEach(([latitude, longitude, isWrong], i) =>
    mark("point", i, [latitude, longitude], i + 1, `${isWrong ? "wrong" : ""} ${i === chosen ? "chosen" : ""}`));
}

function mark(kind, index, place, text, look) {
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
  const places = [...drawn.points.map((one) => one.slice(0, 2)), ...drawn.area];
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
