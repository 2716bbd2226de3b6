// Tiles below the map.

import {onChoose, words} from "./said.js";
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
