// The other aircraft of the station on the map, from the same messages as the one that is shown.

import {m100} from "./shell.js";

const marks = new Map();

m100.onMap((map) => m100.onLive((live) => {
  for (const other of live.others || []) show(map, other);
  if (!live.t) for (const mark of marks.values()) mark.getElement()?.classList.add("stale");
}));

function show(map, other) {
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
