// New points for a chart of ECharts: its lines are kept here, so that only what is new has to come.

const charts = new Map();

// Rows are [milliseconds, value, …]; points older than keepMs before the newest go.
export function add(id, rows, keepMs, isWhole) {
  const chart = window.getElement(id)?.chart;
  if (!chart) return isWhole && setTimeout(() => add(id, rows, keepMs, true), 100);
  if (isWhole) charts.set(id, []);
  const kept = charts.get(id) || [];
  kept.push(...rows);
  const newest = kept.length ? kept[kept.length - 1][0] : Date.now();
  const first = kept.findIndex((row) => row[0] >= newest - keepMs);
  kept.splice(0, Math.max(0, first));
  charts.set(id, kept);
  const count = chart.getModel().getSeriesCount();
  const between = {min: newest - keepMs, max: newest};
  chart.setOption({
    xAxis: Array(count).fill(between),
    series: Array.from({length: count}, (_, n) => ({data: kept.map((row) => [row[0], row[n + 1] ?? null])})),
  });
}
