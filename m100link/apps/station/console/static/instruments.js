// The flight instruments, drawn from the messages of the socket: a value that is not in them is old.

import {number, units, words} from "./said.js";

export function fit(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const g = canvas.getContext("2d");
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, width, height);
  return [g, width, height];
}

const TAPE = 46, RATE = 16, TOP = 20, UNIT = 16;
const STEPS = {"m": 2, "ft": 5, "m/s": 1, "km/h": 5, "kn": 2};  // of a tape's numbers

export function drawHorizon(canvas, live) {
  const [g, width, height] = fit(canvas);
  if (!width) return;
  canvas.dataset.stale = live.att ? "" : "stale";
  const middle = [TAPE, TOP, width - 2 * TAPE - RATE, height - TOP];
  drawAttitude(g, middle, live.att);
  drawHeading(g, width, live.att);
  drawTape(g, [0, TOP, TAPE, height - TOP], live.vel && live.vel[0], units.speed);
  drawTape(g, [width - TAPE - RATE, TOP, TAPE, height - TOP], live.pos && live.pos[2], units.length);
  drawRate(g, [width - RATE, TOP, RATE, height - TOP], live.vel && live.vel[1]);
}

function within(g, [x, y, width, height], draw) {
  g.save();
  g.beginPath();
  g.rect(x, y, width, height);
  g.clip();
  g.translate(x, y);
  draw(width, height);
  g.restore();
}

function drawAttitude(g, box, attitude) {
  within(g, box, (width, height) => {
    const [roll, pitch] = attitude || [0, 0];
    const perDegree = height / 60;
    g.save();
    g.translate(width / 2, height / 2);
    g.rotate(-roll * Math.PI / 180);
    g.translate(0, pitch * perDegree);
    g.fillStyle = attitude ? "#3b7dc4" : "#777";
    g.fillRect(-2 * width, -4 * height, 4 * width, 4 * height);
    g.fillStyle = attitude ? "#7a5f30" : "#555";
    g.fillRect(-2 * width, 0, 4 * width, 4 * height);
    g.strokeStyle = g.fillStyle = "#fff";
    g.font = "10px sans-serif";
    g.textAlign = "left";
    for (let angle = -30; angle <= 30; angle += 10) {
      const half = angle ? 18 : width;
      g.beginPath();
      g.moveTo(-half, -angle * perDegree);
      g.lineTo(half, -angle * perDegree);
      g.stroke();
      if (angle) g.fillText(`${angle}`, half + 3, -angle * perDegree + 3);
    }
    g.restore();
    g.strokeStyle = "#ffd400";
    g.lineWidth = 3;
    g.beginPath();
    g.moveTo(width / 2 - 36, height / 2); g.lineTo(width / 2 - 12, height / 2);
    g.moveTo(width / 2 + 12, height / 2); g.lineTo(width / 2 + 36, height / 2);
    g.stroke();
    if (!attitude) label(g, words("no_attitude"), width / 2, height / 2 - 14, 90);
  });
}

function label(g, text, x, y, width) {
  g.fillStyle = "#000";
  g.fillRect(x - width / 2, y - 10, width, 20);
  g.fillStyle = "#fff";
  g.font = "bold 13px sans-serif";
  g.textAlign = "center";
  g.fillText(text, x, y + 5);
}

function drawHeading(g, width, attitude) {
  within(g, [0, 0, width, TOP], () => {
    g.fillStyle = "#111";
    g.fillRect(0, 0, width, TOP);
    if (!attitude) return;
    const yaw = attitude[2], perDegree = 3;
    g.fillStyle = "#ddd";
    g.font = "11px sans-serif";
    g.textAlign = "center";
    const reach = width / 2 / perDegree;
    for (let at = Math.ceil((yaw - reach) / 15) * 15; at <= yaw + reach; at += 15) {
      const name = {0: "N", 90: words("compass_east"), 180: "S", 270: "W"}[turned(at)];
      const x = width / 2 + (at - yaw) * perDegree;
      g.fillText(name || (at % 30 ? "·" : turned(at)), x, 15);
    }
    label(g, `${turned(Math.round(yaw))}°`, width / 2, 10, 42);
  });
}

const turned = (degrees) => ((degrees % 360) + 360) % 360;

// A tape moves behind a window in which the value stands; crossed out when it is not known.
function drawTape(g, box, metric, [factor, unit]) {
  const value = metric === undefined ? undefined : factor * metric, step = STEPS[unit];
  within(g, box, (width, height) => {
    g.fillStyle = "rgba(0, 0, 0, .72)";
    g.fillRect(0, 0, width, height);
    g.font = "11px sans-serif";
    g.textAlign = "center";
    g.fillStyle = "#bbb";
    if (value !== undefined) {
      const perUnit = 24 / step, reach = height / 2 / perUnit;
      for (let at = Math.ceil((value - reach) / step) * step; at <= value + reach; at += step) {
        const y = height / 2 - (at - value) * perUnit + 4;
        if (y < height - UNIT) g.fillText(at, width / 2, y);
      }
    } else {
      g.strokeStyle = "#ff6b5e";
      g.lineWidth = 2;
      g.beginPath();
      g.moveTo(4, 24); g.lineTo(width - 4, height - 24);
      g.moveTo(width - 4, 24); g.lineTo(4, height - 24);
      g.stroke();
    }
    label(g, value === undefined ? words("old") : number(value, 1), width / 2, height / 2, width);
    g.fillStyle = "#bbb";
    g.font = "10px sans-serif";
    g.fillText(unit, width / 2, height - 5);
  });
}

function drawRate(g, box, up) {
  within(g, box, (width, height) => {
    g.fillStyle = "#111";
    g.fillRect(0, 0, width, height);
    g.fillStyle = "#bbb";
    g.fillRect(0, height / 2 - 0.5, width, 1);
    if (up === undefined) return;
    const most = 4;  // m/s at either end
    const size = Math.max(-1, Math.min(1, up / most)) * (height / 2);
    g.fillStyle = up < 0 ? "#ffb74d" : "#81c784";
    g.fillRect(3, height / 2 - Math.max(0, size), width - 6, Math.abs(size));
  });
}

export function drawChannels(live) {
  ["roll", "pitch", "yaw", "throttle"].forEach((name, i) => {
    const bar = document.querySelector(`[data-rc="${name}"]`);
    if (!bar) return;
    bar.classList.toggle("stale", !live.rc);
    bar.style.setProperty("--value", live.rc ? live.rc[i] / 10000 : 0);
    bar.title = live.rc ? live.rc[i] : "–";
  });
}

// -- charts -------------------------------------------------------------------------------------
// New points for a chart of ECharts: its lines are kept here, so that only what is new has to come.

const charts = new Map();

// Rows are [milliseconds, value, …]; points older than keepMs before the newest go. With each version
// the lines begin anew. A row that came before, as messages may after a lost connection, is passed over.
export function addRows(id, version, rows, keepMs) {
  const chart = window.getElement(id)?.chart;
  if (!chart) return setTimeout(() => addRows(id, version, rows, keepMs), 100);
  let kept = charts.get(id);
  if (kept && kept.version > version) return;
  if (!kept || kept.version < version) charts.set(id, kept = {version, rows: []});
  const last = kept.rows.length ? kept.rows[kept.rows.length - 1][0] : -Infinity;
  kept.rows.push(...rows.filter((row) => row[0] > last));
  if (!kept.rows.length) return;
  point(id, chart);
  const newest = kept.rows[kept.rows.length - 1][0];
  kept.rows.splice(0, kept.rows.findIndex((row) => row[0] >= newest - keepMs));
  const count = chart.getModel().getSeriesCount(), axes = chart.getOption().xAxis.length;
  const between = {min: newest - keepMs, max: newest};
  chart.setOption({
    xAxis: Array(axes).fill(between),
    series: Array.from({length: count}, (_, n) => ({data: kept.rows.map((row) => [row[0], row[n + 1] ?? null])})),
  });
}

// Of a recorded flight: a line in each stripe where the replay is.
export function setCursor(id, stripes, at) {
  const chart = window.getElement(id)?.chart;
  if (!chart || !charts.has(id)) return;
  const markLine = {symbol: "none", silent: true, animation: false, label: {show: false},
    lineStyle: {color: "#7b1fa2", width: 2, type: "solid"}, data: [{xAxis: at}]};
  chart.setOption({series: Array(stripes).fill({markLine})});
  chart.getDom().dataset.cursor = at;
}

// A press on a chart tells which time it is of.
const pointed = new Set();

function point(id, chart) {
  if (pointed.has(id)) return;
  pointed.add(id);
  chart.getZr().on("click", ({offsetX, offsetY}) => {
    const stripe = chart.getOption().grid.findIndex((_, n) => chart.containPixel({gridIndex: n}, [offsetX, offsetY]));
    if (stripe < 0) return;
    const [at] = chart.convertFromPixel({gridIndex: stripe}, [offsetX, offsetY]);
    window.emitEvent("plot_pointed", at);
  });
}
