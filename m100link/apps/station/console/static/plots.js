// New points for a chart of ECharts: its lines are kept here, so that only what is new has to come.

const charts = new Map();

// Rows are [milliseconds, value, …]; points older than keepMs before the newest go. With each version
// the lines begin anew. A row that came before, as messages may after a lost connection, is passed over.
export function add(id, version, rows, keepMs) {
  const chart = window.getElement(id)?.chart;
  if (!chart) return setTimeout(() => add(id, version, rows, keepMs), 100);
  let kept = charts.get(id);
  if (kept && kept.version > version) return;
  if (!kept || kept.version < version) charts.set(id, kept = {version, rows: []});
  const last = kept.rows.length ? kept.rows[kept.rows.length - 1][0] : -Infinity;
  kept.rows.push(...rows.filter((row) => row[0] > last));
  if (!kept.rows.length) return;
  const newest = kept.rows[kept.rows.length - 1][0];
  kept.rows.splice(0, kept.rows.findIndex((row) => row[0] >= newest - keepMs));
  const count = chart.getModel().getSeriesCount();
  const between = {min: newest - keepMs, max: newest};
  chart.setOption({
    xAxis: Array(count).fill(between),
    series: Array.from({length: count}, (_, n) => ({data: kept.rows.map((row) => [row[0], row[n + 1] ?? null])})),
  });
}
