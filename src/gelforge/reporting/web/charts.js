"use strict";
// Charts of errors, each a point with its interval, and the picture of the flow.
const SVG = "http://www.w3.org/2000/svg";
function draw(tag, attributes, text) {
  const node = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
}
// Two-sided 95 % points of Student's t; beyond the table the normal one.
const STUDENT = [NAN, NAN, 12.71, 4.3, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.2, 2.18, 2.16, 2.14, 2.13, 2.12, 2.11, 2.1, 2.09];
function summary(indices, axis) {
  const groups = new Map(); // frames of one press err alike: they count as one
  for (const i of indices) {
    const key = COLUMNS.group[i] || `row ${i}`, held = groups.get(key) || [0, 0];
    groups.set(key, [held[0] + COLUMNS[`error_${axis}`][i], held[1] + 1]);
  }
  const means = [...groups.values()].map(([sum, n]) => sum / n), n = means.length, mean = means.reduce((a, b) => a + b, 0) / n;
  const spread = Math.sqrt(means.reduce((a, v) => a + (v - mean) ** 2, 0) / (n - 1)) * (STUDENT[n] || 1.96) / Math.sqrt(n);
  return { n, mean, low: n > 1 ? Math.max(0, mean - spread) : NAN, high: n > 1 ? mean + spread : NAN };
}
function dotChart(rows, lines) {
  const height = 24 * rows.length + 56, left = 190, right = 560, svg = draw("svg", { viewBox: `0 0 620 ${height}`, width: "100%", role: "img" });
  const most = Math.max(...rows.map((r) => Math.max(r.mean, Number.isFinite(r.high) ? Math.min(r.high, 4 * r.mean) : 0)), ...lines.filter((l) => l.value < 6 * Math.max(...rows.map((r) => r.mean))).map((l) => l.value)) * 1.08 || 1;
  const X = (v) => left + (right - left) * Math.min(v / most, 1);
  for (const v of ticks(0, most, 4)) {
    svg.append(draw("line", { x1: X(v), x2: X(v), y1: 10, y2: height - 40, stroke: "#e3e7ec" }), draw("text", { x: X(v), y: height - 24, "text-anchor": "middle", class: "soft" }, String(v)));
  }
  for (const [k, line] of lines.entries()) {
    if (line.value > most) continue;
    svg.append(draw("line", { x1: X(line.value), x2: X(line.value), y1: 6, y2: height - 40, stroke: PALETTE[k + 1], "stroke-dasharray": "5 4", "stroke-width": 1.5 }));
  }
  rows.forEach((row, k) => {
    const y = 24 * k + 22, name = row.name.length > 24 ? `${row.name.slice(0, 23)}…` : row.name;
    const label = draw("text", { x: left - 10, y: y + 4, "text-anchor": "end" }, name); label.append(draw("title", {}, row.name)); svg.append(label);
    if (Number.isFinite(row.high)) svg.append(draw("line", { x1: X(row.low), x2: X(row.high), y1: y, y2: y, stroke: PALETTE[0], "stroke-width": 2 }));
    const point = draw("circle", { cx: X(row.mean), cy: y, r: 5, fill: PALETTE[0] });
    point.append(draw("title", {}, `${row.name}: ${fixed(row.mean, 3)} N (${fixed(row.low, 3)} to ${fixed(row.high, 3)}), ${row.n} presses`));
    svg.append(point, draw("text", { x: right + 10, y: y + 4, class: "soft" }, `n ${row.n}`));
  });
  svg.append(draw("text", { x: (left + right) / 2, y: height - 6, "text-anchor": "middle", class: "soft" }, "mean absolute error, N"));
  return svg;
}
function bins(i) {
  const edges = DATA.about.force_edges, force = COLUMNS.force[i], k = edges.findIndex((edge) => force < edge);
  return k < 0 ? `above ${edges.at(-1)} N` : `${k ? edges[k - 1] : 0} to ${edges[k]} N`;
}
const BY = [["by split", (i) => COLUMNS.split[i]], ["by indenter", (i) => COLUMNS.indenter[i]], ["by normal force", bins], ["by sensor", (i) => COLUMNS.sensor[i]]];
function drawCharts() {
  const box = el("charts"), usable = [...COLUMNS.error.keys()].filter((i) => Number.isFinite(COLUMNS.error[i]));
  if (!usable.length) { box.append(make("p", { className: "absent" }, "No network was evaluated on this dataset: make evaluate.")); return; }
  const splits = [...new Set(usable.map((i) => COLUMNS.split[i]))].sort();
  const split = make("select", { id: "chart-split" }, make("option", { value: "" }, DATA.about.learnt_here ? "all it did not learn from" : "all"), ...splits.map((v) => make("option", { value: v }, v)));
  const axis = make("select", { id: "chart-axis" }, ...AXES.map((v) => make("option", { value: v }, AXIS_NAMES[v])));
  const legend = make("div", { className: "legend" }), area = make("div", { className: "charts" });
  let table = [];
  const update = () => {
    const chosen = usable.filter((i) => (split.value ? COLUMNS.split[i] === split.value : !DATA.about.learnt_here || COLUMNS.split[i] !== "train"));
    const lines = controlLines(split.value ? [split.value] : splits.filter((v) => !DATA.about.learnt_here || v !== "train"), axis.value);
    table = [["group", "value", "presses", "mean absolute error N", "low", "high"]];
    legend.replaceChildren(make("span", {}, make("i", { style: `background:${PALETTE[0]}` }), `${DATA.about.model}: mean and 95 % interval over presses`),
      ...lines.map((line, k) => make("span", {}, make("i", { style: `background:${PALETTE[k + 1]}` }), `${line.name}: ${fixed(line.value)} N`)));
    area.replaceChildren(...BY.map(([title, of]) => {
      const groups = new Map();
      for (const i of chosen) { const key = of(i); if (!groups.has(key)) groups.set(key, []); groups.get(key).push(i); }
      const rows = [...groups].map(([name, indices]) => ({ name, ...summary(indices, axis.value) })).sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
      rows.forEach((row) => table.push([title, row.name, row.n, row.mean, row.low, row.high]));
      return make("div", { className: "chart" }, make("h3", {}, `Error ${title}`), rows.length ? dotChart(rows, lines) : make("p", { className: "note" }, "No press of this split was read."));
    }));
  };
  split.onchange = axis.onchange = update;
  box.append(make("div", { className: "row" }, make("label", {}, "Presses ", split), make("label", {}, "Component ", axis), copyButton(() => table)), legend, area);
  update();
}
function controlLines(splits, axis) {
  const names = { constant_guess: "always the same guess", linear_on_image_means: "a line on the picture's mean colour", shuffled_images: "shown another press's picture" };
  const found = splits.map((v) => DATA.about.controls[v]).filter(Boolean), n = found.reduce((a, v) => a + v.n, 0);
  if (!n) return [];
  return Object.keys(names).map((name) => {
    const having = found.filter((v) => v.controls[name]), weight = having.reduce((a, v) => a + v.n, 0);
    return { name: names[name], value: having.reduce((a, v) => a + v.n * v.controls[name][axis], 0) / weight };
  }).filter((line) => Number.isFinite(line.value));
}
const time = (s) => (s < 90 ? `${fixed(s, s < 10 ? 1 : 0)} s` : s < 5400 ? `${fixed(s / 60, 1)} min` : `${fixed(s / 3600, 1)} h`);
function drawFlow() {
  const stages = DATA.stages, depth = {}, box = el("flow-graph");
  if (!stages.length) { box.append(make("p", { className: "absent" }, "No stage has left its record.")); return; }
  const known = Object.fromEntries(stages.map((s) => [s.name, s]));
  const level = (name, seen = []) => depth[name] ?? (depth[name] = seen.includes(name) ? 0 : Math.max(-1, ...known[name].reads.filter((r) => known[r]).map((r) => level(r, [...seen, name]))) + 1);
  stages.forEach((s) => level(s.name));
  const levels = Math.max(...Object.values(depth)) + 1, lanes = Array.from({ length: levels }, () => []);
  stages.forEach((s) => lanes[depth[s.name]].push(s.name));
  // Levels go to the right, on a narrow page downwards.
  const most = Math.max(...lanes.map((l) => l.length)), total = stages.reduce((a, s) => a + s.cpu_seconds, 0) || 1, down = box.clientWidth < 700;
  const [wide, high] = down ? [140, 84] : [142, 74], columns = down ? most : levels, rows = down ? levels : most, at = {};
  const svg = draw("svg", { viewBox: `0 0 ${columns * wide} ${rows * high + 10}`, width: columns * wide, style: "max-width:100%;min-width:0", role: "img" });
  lanes.forEach((lane, x) => lane.forEach((name, y) => { const beside = y + (most - lane.length) / 2; at[name] = down ? [beside * wide + 8, x * high + 8] : [x * wide + 8, beside * high + 8]; }));
  for (const stage of stages) for (const from of stage.reads.filter((r) => at[r])) {
    const [x1, y1] = at[from], [x2, y2] = at[stage.name];
    const d = down ? `M${x1 + 62},${y1 + 54} C${x1 + 62},${y1 + 74} ${x2 + 62},${y2 - 20} ${x2 + 62},${y2}` : `M${x1 + 124},${y1 + 27} C${x1 + 144},${y1 + 27} ${x2 - 24},${y2 + 27} ${x2},${y2 + 27}`;
    svg.append(draw("path", { d, fill: "none", stroke: "#9aa5b1", "stroke-width": 1.5 }));
  }
  for (const stage of stages) {
    const [x, y] = at[stage.name], fraction = stage.cpu_seconds / total;
    const title = draw("title", {}, `${stage.name}: ${stage.targets} targets, ${time(stage.cpu_seconds)} of processor time, ${fixed(100 * fraction, 1)} % of all`);
    const card = draw("rect", { x, y, width: 124, height: 54, rx: 6, fill: rgb(ramp([[246, 248, 250], [247, 201, 157]], Math.sqrt(fraction))), stroke: "#9aa5b1" });
    card.append(title);
    svg.append(card, draw("text", { x: x + 10, y: y + 20 }, stage.name), draw("text", { x: x + 10, y: y + 36, class: "soft" }, `${time(stage.cpu_seconds)}, ${fixed(stage.peak_mib, 0)} MiB`), draw("text", { x: x + 10, y: y + 49, class: "soft" }, `${stage.targets} target${stage.targets === 1 ? "" : "s"}`));
  }
  box.append(svg, copyButton(() => [["stage", "targets", "seconds", "processor seconds", "largest MiB", "reads"], ...stages.map((s) => [s.name, s.targets, s.seconds, s.cpu_seconds, s.peak_mib, s.reads.join(" ")])]));
}
drawCharts(); drawFlow();
