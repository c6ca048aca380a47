"use strict";
// The explorer of presses. DATA (written by reporting/page.py): columns, shared, parts, costs, stages, about.
const NAN = Number.NaN;
const AXES = ["fz", "fx", "fy"];
const AXIS_NAMES = { fz: "normal, z", fx: "short side, x", fy: "long side, y" };
const CHANNELS = { fx: 0, fy: 1, fz: 2 }; // of the maps
const PALETTE = ["#1f6f8b", "#d1603d", "#5b8c3a", "#6a4c93", "#c9a227", "#b3396b", "#3f88c5", "#7a7a7a", "#2e4057", "#8d5524", "#00a896", "#ef767a"];
const el = (id) => document.getElementById(id);
function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on") || key in node) node[key] = value; else node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}
const fixed = (value, digits = 2) => (Number.isFinite(value) ? value.toFixed(digits) : "–");

// ---- the table of presses
const COLUMNS = {};
const COUNT = DATA.columns.id.length;
for (const [name, values] of Object.entries(DATA.columns)) {
  if (name === "id") COLUMNS.id = values;
  else if (Array.isArray(values)) COLUMNS[name] = Float64Array.from(values, (v) => (v === null ? NAN : v));
  else COLUMNS[name] = values.at.map((at) => values.names[at]);
}
const FAILED = COLUMNS.status.map((s) => s !== "OK" && s !== "NO_CONTACT" && s !== "PENDING");
for (const axis of AXES) {
  COLUMNS[`error_${axis}`] = COLUMNS[`network_${axis}`].map((v, i) => Math.abs(v - COLUMNS[`label_${axis}`][i]));
}
COLUMNS.error = COLUMNS.error_fz.map((v, i) => Math.hypot(v, COLUMNS.error_fx[i], COLUMNS.error_fy[i]));
COLUMNS.force = COLUMNS.label_fz.map(Math.abs);
COLUMNS.depth = COLUMNS.dz_mm.map((v) => -v);
const PLACE = new Map(COLUMNS.id.map((id, i) => [id, i]));
const GROUPS = new Map();
COLUMNS.group.forEach((group, i) => {
  if (group === "") return;
  const key = `${group}|${COLUMNS.indenter[i]}`;
  if (!GROUPS.has(key)) GROUPS.set(key, []);
  GROUPS.get(key).push(i);
});

const state = { filter: {}, sort: null, falling: true, order: [], at: -1, axis: "fz", colour: "error", onlyFailed: false };

function keeps(i) {
  for (const name of ["indenter", "sensor", "split", "status"]) {
    if (state.filter[name] && COLUMNS[name][i] !== state.filter[name]) return false;
  }
  for (const name of ["force", "error"]) {
    const low = state.filter[`${name}_low`], high = state.filter[`${name}_high`];
    if (Number.isFinite(low) && !(COLUMNS[name][i] >= low)) return false;
    if (Number.isFinite(high) && !(COLUMNS[name][i] <= high)) return false;
  }
  return !state.onlyFailed || FAILED[i];
}
function arrange() {
  const order = [];
  for (let i = 0; i < COUNT; i++) if (keeps(i)) order.push(i);
  if (state.sort) {
    const values = COLUMNS[state.sort], sign = state.falling ? -1 : 1;
    const absent = (v) => v === "" || Number.isNaN(v);
    order.sort((a, b) => {
      const x = values[a], y = values[b];
      if (absent(x) || absent(y)) return absent(x) - absent(y) || a - b; // what is unknown stands last either way
      return (typeof x === "string" ? sign * x.localeCompare(y) : sign * (x - y)) || a - b;
    });
  }
  state.order = order;
  el("count").textContent = order.length === COUNT ? `${COUNT} presses` : `${order.length} of ${COUNT} presses`;
  el("worst").setAttribute("aria-pressed", state.sort === "error" && state.falling);
  el("failed").setAttribute("aria-pressed", state.onlyFailed);
  drawRows(); drawMap();
}

// ---- filters
function buildFilters() {
  const box = el("filters");
  for (const [name, title] of [["indenter", "indenter"], ["sensor", "sensor"], ["split", "split"], ["status", "state"]]) {
    const names = [...new Set(COLUMNS[name])].filter((v) => v !== "").sort();
    if (!names.length) continue;
    const select = make("select", { id: `by-${name}`, onchange: () => { state.filter[name] = select.value; arrange(); } },
      make("option", { value: "" }, "all"), ...names.map((v) => make("option", { value: v }, v)));
    box.append(make("label", {}, title, select));
  }
  for (const [name, title] of [["force", "normal force, N"], ["error", "error, N"]]) {
    const pair = make("span", { className: "pair" });
    for (const [end, hint] of [["low", "from"], ["high", "to"]]) {
      const input = make("input", { id: `by-${name}-${end}`, type: "number", step: "any", placeholder: hint, "aria-label": `${title} ${hint}` });
      input.oninput = () => { state.filter[`${name}_${end}`] = input.value === "" ? NAN : Number(input.value); arrange(); };
      pair.append(input);
    }
    box.append(make("label", {}, title, pair));
  }
  el("worst").onclick = () => { state.sort = "error"; state.falling = true; state.onlyFailed = false; arrange(); first(); };
  el("failed").onclick = () => { state.onlyFailed = !state.onlyFailed; arrange(); first(); };
  el("reset").onclick = () => {
    state.filter = {}; state.onlyFailed = false; state.sort = null;
    for (const field of box.querySelectorAll("select, input")) field.value = "";
    arrange();
  };
  el("copy").onclick = () => {
    const names = Object.keys(COLUMNS);
    copyText(csvText([names, ...state.order.map((i) => names.map((name) => COLUMNS[name][i]))]), el("copy"));
  };
}
function first() { el("rows").scrollTop = 0; if (state.order.length) choose(state.order[0]); }

// ---- the list: only the rows in sight are in the page
const ROW = 28;
const SHOWN = [["id", "press"], ["error", "error, N"], ["label_fz", "label z, N"], ["error_n", "error of the mesh, N"], ["friction_error_n", "of friction, N"], ["slipping", "slipping"], ["network_fz", "network z, N"], ["indenter", "indenter"], ["sensor", "sensor"], ["split", "split"], ["status", "state"], ["reason", "reason"]];
function drawRows() {
  const box = el("rows");
  if (!box.firstChild) {
    const head = make("tr");
    for (const [name, title] of SHOWN) {
      const cell = make("th", { scope: "col", title: "sort" }, title);
      cell.onclick = () => { state.falling = state.sort === name ? !state.falling : name !== "id"; state.sort = name; arrange(); };
      cell.dataset.name = name; cell.dataset.title = title; head.append(cell);
    }
    box.append(make("table", {}, make("thead", {}, head), make("tbody")));
    box.addEventListener("scroll", () => requestAnimationFrame(drawRows), { passive: true });
  }
  for (const cell of box.querySelectorAll("th")) cell.textContent = cell.dataset.title + (state.sort === cell.dataset.name ? (state.falling ? " ↓" : " ↑") : "");
  const start = Math.max(0, Math.floor(box.scrollTop / ROW) - 5), stop = Math.min(state.order.length, start + Math.ceil(box.clientHeight / ROW) + 10);
  const body = box.querySelector("tbody"), rows = [];
  const gap = (height) => make("tr", {}, make("td", { colSpan: SHOWN.length, style: `height:${height}px;padding:0;border:0` }));
  if (start > 0) rows.push(gap(start * ROW));
  for (let k = start; k < stop; k++) {
    const i = state.order[k];
    const row = make("tr", { onclick: () => choose(i) });
    row.setAttribute("aria-selected", i === state.at);
    if (FAILED[i]) row.className = "failed";
    for (const [name] of SHOWN) {
      const value = COLUMNS[name][i];
      row.append(make("td", { className: name === "reason" ? "why" : "", title: name === "reason" ? value : "" }, typeof value === "string" ? value : fixed(value)));
    }
    rows.push(row);
  }
  if (stop < state.order.length) rows.push(gap((state.order.length - stop) * ROW));
  body.replaceChildren(...rows);
}

// ---- the map of positions
const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const rgb = (c) => `rgb(${c.map(Math.round).join(",")})`;
function quantile(values, fraction) {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b);
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(fraction * sorted.length))] : NAN;
}
function colours() {
  const name = state.colour, legend = el("legend");
  legend.replaceChildren();
  if (typeof COLUMNS[name][0] === "string") {
    const names = [...new Set(COLUMNS[name])].sort(), at = new Map(names.map((v, k) => [v, PALETTE[k % PALETTE.length]]));
    legend.append(...names.filter(Boolean).map((v) => make("span", {}, make("i", { style: `background:${at.get(v)}` }), v)));
    return (i) => at.get(COLUMNS[name][i]);
  }
  const top = quantile([...COLUMNS[name]], 0.98) || 1, units = { depth: "mm" }[name] || "N";
  const stops = VIRIDIS.map(rgb).join(",");
  legend.append(make("span", {}, `0 ${units}`), make("span", { className: "bar", style: `background:linear-gradient(90deg,${stops});flex:1;min-width:80px` }), make("span", {}, `${fixed(top)} ${units} and more`), make("span", {}, make("i", { style: "background:#c3cad1" }), "none"));
  return (i) => (Number.isFinite(COLUMNS[name][i]) ? rgb(ramp(VIRIDIS, COLUMNS[name][i] / top)) : "#c3cad1");
}
let colourOf = null;
const view = { scale: 1, left: 0, top: 0 };
function sharp(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const c = canvas.getContext("2d");
  c.setTransform(ratio, 0, 0, ratio, 0, 0); c.clearRect(0, 0, width, height); c.font = "12px system-ui, sans-serif";
  return [c, width, height];
}
const onMap = (i) => [view.left + view.scale * COLUMNS.y0_mm[i], view.top - view.scale * COLUMNS.x0_mm[i]];
// All points are drawn when their order, colours or the page's width change; a choice only moves the ring over them.
const POINTS = document.createElement("canvas");
function drawMap() {
  drawPoints();
  const map = el("map");
  POINTS.width = map.width; POINTS.height = map.height; POINTS.getContext("2d").drawImage(map, 0, 0);
  drawRing();
}
function drawRing() {
  const map = el("map"), c = map.getContext("2d"), ratio = window.devicePixelRatio || 1;
  c.setTransform(1, 0, 0, 1, 0, 0); c.clearRect(0, 0, map.width, map.height); c.drawImage(POINTS, 0, 0); c.setTransform(ratio, 0, 0, ratio, 0, 0);
  const [x, y] = state.at < 0 ? [NAN, NAN] : onMap(state.at);
  if (Number.isFinite(x + y)) { c.strokeStyle = "#000"; c.lineWidth = 2; c.beginPath(); c.arc(x, y, pointSize() + 4, 0, 7); c.stroke(); }
}
const pointSize = () => (COUNT > 3000 ? 2 : COUNT > 500 ? 3 : 5);
function drawPoints() {
  if (!colourOf) colourOf = colours();
  const [c, width, height] = sharp(el("map")), gel = DATA.shared.gel;
  view.scale = Math.min((width - 20) / gel.length, (height - 40) / gel.width); view.left = width / 2; view.top = (height - 18) / 2;
  const w = gel.length * view.scale, h = gel.width * view.scale;
  c.fillStyle = "#f6f8fa"; c.strokeStyle = "#b9c1ca"; c.beginPath(); c.roundRect(view.left - w / 2, view.top - h / 2, w, h, 1.5 * view.scale); c.fill(); c.stroke();
  c.fillStyle = "#555c66"; c.textAlign = "center"; c.fillText(`where each press first touched; the gel is ${gel.length} mm wide here (y), ${gel.width} mm high (x)`, view.left, height - 6, width - 8);
  const size = pointSize();
  for (let k = state.order.length - 1; k >= 0; k--) {
    const i = state.order[k], [x, y] = onMap(i);
    if (!Number.isFinite(x + y)) continue;
    c.fillStyle = colourOf(i); c.beginPath(); c.arc(x, y, size, 0, 7); c.fill();
  }
}
function pickOnMap(event) {
  const box = el("map").getBoundingClientRect(), px = event.clientX - box.left, py = event.clientY - box.top;
  let best = -1, least = 25;
  for (const i of state.order) {
    const [x, y] = onMap(i), away = Math.hypot(x - px, y - py);
    if (away < least) { least = away; best = i; }
  }
  if (best >= 0) choose(best);
}

// ---- parts: what is drawn of single presses, in the page or in files beside it
const PARTS = new Map(), WAITING = new Map();
window.gelforgePart = (number, presses) => {
  PARTS.set(number, presses);
  if (DATA.parts.beside && PARTS.size > 40) PARTS.delete(PARTS.keys().next().value);
  for (const resume of WAITING.get(number) || []) resume();
  WAITING.delete(number);
};
function part(number) {
  if (PARTS.has(number)) return Promise.resolve(PARTS.get(number));
  return new Promise((resolve, reject) => {
    const resume = () => resolve(PARTS.get(number));
    if (WAITING.has(number)) { WAITING.get(number).push(resume); return; }
    WAITING.set(number, [resume]);
    if (!DATA.parts.beside) return; // it stands further down in this page
    const script = make("script", { src: `${DATA.parts.beside}/${number}.js` });
    script.onload = () => script.remove();
    script.onerror = () => { WAITING.delete(number); script.remove(); reject(new Error(`${DATA.parts.beside}/${number}.js is not beside this page; copy the whole folder`)); };
    document.head.append(script);
  });
}
async function unpack(packed) {
  const bytes = Uint8Array.from(atob(packed.data), (s) => s.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer()), n = planes.length / 2, found = {};
  let at = 0;
  for (const [name, length, unit] of packed.arrays) {
    found[name] = Float32Array.from({ length }, (_, k) => ((planes[at + k] | (planes[n + at + k] << 8)) << 16 >> 16) * unit);
    at += length;
  }
  return found;
}

// ---- one press
async function choose(i) {
  state.at = i;
  const asked = performance.now();
  showRow(i); drawRing(); drawRows();
  try { history.replaceState(null, "", `#press=${encodeURIComponent(COLUMNS.id[i])}`); } catch { /* some browsers keep files from it */ }
  frame(i);
  let press, arrays;
  try {
    const presses = await part(Math.floor(i / DATA.parts.size));
    press = presses[i % DATA.parts.size];
    arrays = await unpack(press);
  } catch (error) {
    if (state.at === i) el("press-note").textContent = error.message;
    return;
  }
  if (state.at !== i) return; // another press was chosen meanwhile
  fill(i, press, arrays);
  document.body.dataset.shown = COLUMNS.id[i];
  document.body.dataset.took = (performance.now() - asked).toFixed(1);
}
function showRow(i) {
  const k = state.order.indexOf(i), box = el("rows");
  if (k < 0) return;
  const y = k * ROW;
  if (y < box.scrollTop || y > box.scrollTop + box.clientHeight - 3 * ROW) box.scrollTop = Math.max(0, y - box.clientHeight / 2);
}
function step(by) {
  if (!state.order.length) return;
  const k = state.order.indexOf(state.at);
  choose(state.order[k < 0 ? 0 : Math.min(Math.max(k + by, 0), state.order.length - 1)]);
}
function frame(i) {
  const box = el("detail");
  if (!box.firstChild) buildDetail(box);
  el("press-id").textContent = COLUMNS.id[i];
  el("press-note").textContent = "";
  const facts = [["indenter", COLUMNS.indenter[i]], ["sensor", COLUMNS.sensor[i]], ["gel", COLUMNS.gel[i] && `${thickness(i)} mm thick`], ["split", COLUMNS.split[i] || "none"], ["state", COLUMNS.status[i]],
    ["depth", `${fixed(COLUMNS.depth[i], 3)} mm`], ["x, y, mm", `${fixed(COLUMNS.x0_mm[i])}, ${fixed(COLUMNS.y0_mm[i])}`],
    ["shear, mm", `${fixed(COLUMNS.dx_mm[i])}, ${fixed(COLUMNS.dy_mm[i])}`], ["turned", `${fixed(COLUMNS.rot_deg[i], 1)}°`]];
  el("facts").replaceChildren(...facts.map(([name, value]) => make("div", {}, make("span", {}, `${name} `), value || "–")));
  el("reason").textContent = FAILED[i] ? `${COLUMNS.status[i]}: ${COLUMNS.reason[i] || "no reason was recorded"}` : "";
  const rows = [["", "fx, N", "fy, N", "fz, N", "mx, N mm", "my, N mm", "mz, N mm"], ...[["label", "label"], ["network", "network"], ["measured", "force sensor"]].map(([kind, title]) =>
    [title, ...["fx", "fy", "fz", "mx", "my", "mz"].map((axis) => fixed(COLUMNS[`${kind}_${axis}`][i]))])];
  el("totals").replaceChildren(...rows.map((row, k) => make("tr", {}, ...row.map((cell) => make(k ? "td" : "th", {}, cell)))));
  drawCurve(i); provenance(i);
}
function buildDetail(box) {
  const axis = make("select", { id: "axis", onchange: () => { state.axis = axis.value; if (shown.arrays) drawMaps(); drawCurve(state.at); } },
    ...AXES.map((name) => make("option", { value: name }, AXIS_NAMES[name])));
  const toggle = (name, title) => {
    const input = make("input", { type: "checkbox", checked: true, id: `show-${name}`, onchange: () => drawGel(state.at) });
    return make("label", {}, input, ` ${title}`);
  };
  box.append(
    make("header", {}, make("h3", { className: "title", id: "press-id" }), make("button", { id: "before", onclick: () => step(-1), title: "previous press" }, "←"), make("button", { id: "next", onclick: () => step(1), title: "next press" }, "→")),
    make("div", { className: "reason", id: "reason" }), make("div", { className: "facts", id: "facts" }), make("p", { className: "note", id: "press-note" }),
    make("div", { className: "row" }, make("label", {}, "Component ", axis), copyButton(mapRows), make("span", { className: "note", id: "cell" })),
    make("div", { className: "maps" }, ...[["picture", "picture"], ["label", "label"], ["network", "network"], ["difference", "network − label"]].map(([name, title]) =>
      make("figure", {}, name === "picture" ? make("img", { id: "map-picture", alt: "picture of the sensor" }) : make("canvas", { id: `map-${name}` }), make("figcaption", { id: `cap-${name}` }, title)))),
    make("div", { className: "bar", id: "map-bar" }), make("div", { className: "ends" }, make("span", { id: "low" }), make("span", {}, "newtons a cell"), make("span", { id: "high" })),
    make("h3", {}, "Gel"), make("div", { id: "gel" }), make("div", { className: "row" }, toggle("indenter", "indenter"), toggle("forces", "forces on the gel"), make("span", { className: "note" }, "drag turns, wheel or two fingers zoom; colour: indentation")),
    make("h3", {}, "Total force, and moment about the gel's apex"), make("div", { className: "scroll" }, make("table", { id: "totals" })), make("canvas", { id: "curve", style: "width:100%;height:200px" }), make("p", { className: "note", id: "curve-note" }),
    make("details", {}, make("summary", {}, "What made this press"), make("div", { className: "scroll" }, make("table", { id: "provenance" })), copyButton(() => provenanceRows(state.at))));
  for (const name of ["label", "network", "difference"]) {
    el(`map-${name}`).onpointermove = (event) => readCell(event, name);
    el(`map-${name}`).onpointerleave = () => { el("cell").textContent = ""; };
  }
}
const shown = { arrays: null, image: null };
function fill(i, press, arrays) {
  Object.assign(shown, { arrays, image: press.image });
  const image = el("map-picture");
  image.style.visibility = press.image ? "visible" : "hidden";
  if (press.image) image.src = `data:image/jpeg;base64,${press.image}`; else image.removeAttribute("src");
  el("cap-picture").textContent = press.image ? "picture" : "no picture in the dataset";
  drawMaps(); drawGel(i);
}
function mapsOf() {
  const [rows, cols] = DATA.about.grid, n = rows * cols, at = CHANNELS[state.axis] * n, found = {};
  for (const name of ["label", "network"]) if (shown.arrays && shown.arrays[name] && shown.arrays[name].length === 3 * n) found[name] = shown.arrays[name].subarray(at, at + n);
  if (found.label && found.network) found.difference = found.network.map((v, k) => v - found.label[k]);
  return found;
}
function drawMaps() {
  const maps = mapsOf(), [rows, cols] = DATA.about.grid;
  let reach = 0;
  for (const map of Object.values(maps)) for (const v of map) reach = Math.max(reach, Math.abs(v));
  reach = reach || 1;
  for (const [name, title] of [["label", "label"], ["network", "network"], ["difference", "network − label"]]) {
    const map = maps[name];
    el(`cap-${name}`).textContent = map ? `${title}: ${fixed(map.reduce((a, b) => a + b, 0))} N` : `${title}: none`;
    paintMap(el(`map-${name}`), map || [], rows, cols, reach);
  }
  el("map-bar").style.background = `linear-gradient(90deg,${DIVERGING.map(rgb).join(",")})`;
  el("low").textContent = fixed(-reach, 4); el("high").textContent = `+${fixed(reach, 4)}`;
}
function mapRows() {
  const maps = mapsOf(), cols = DATA.about.grid[1], rows = [["row", "column", ...Object.keys(maps)]];
  const any = Object.values(maps)[0] || [];
  any.forEach((_, k) => rows.push([Math.floor(k / cols), k % cols, ...Object.values(maps).map((map) => map[k])]));
  return rows;
}
function readCell(event, name) {
  const map = mapsOf()[name], [rows, cols] = DATA.about.grid, box = event.target.getBoundingClientRect();
  const r = Math.min(rows - 1, Math.floor((event.clientY - box.top) / box.height * rows)), k = Math.min(cols - 1, Math.floor((event.clientX - box.left) / box.width * cols));
  el("cell").textContent = map ? `row ${r}, column ${k}: ${fixed(map[r * cols + k], 4)} N` : "";
}

// ---- force over the frames of one press
function drawCurve(i) {
  const frames = (GROUPS.get(`${COLUMNS.group[i]}|${COLUMNS.indenter[i]}`) || [i]).slice().sort((a, b) => COLUMNS.depth[a] - COLUMNS.depth[b]);
  const [c, width, height] = sharp(el("curve")), kinds = [["label", "#1f6f8b"], ["network", "#d1603d"], ["measured", "#5b8c3a"]];
  const sign = state.axis === "fz" ? -1 : 1, values = (kind) => frames.map((k) => sign * COLUMNS[`${kind}_${state.axis}`][k]);
  const all = kinds.flatMap(([kind]) => values(kind)).filter(Number.isFinite);
  el("curve-note").textContent = frames.length === 1 ? "One frame of this press was recorded." : `${frames.length} frames of this press; the chosen one is circled.`;
  if (!all.length) { c.fillStyle = "#555c66"; c.fillText("no force is known of this press", 12, 24); return; }
  const low = Math.min(0, ...all), high = Math.max(0, ...all) * 1.05 + 1e-9, deepest = Math.max(...frames.map((k) => COLUMNS.depth[k])) * 1.1 || 1;
  const X = (v) => 52 + (width - 64) * v / deepest, Y = (v) => height - 34 - (height - 62) * (v - low) / (high - low);
  c.strokeStyle = "#b9c1ca"; c.strokeRect(52, 28, width - 64, height - 62); c.fillStyle = "#555c66";
  c.textAlign = "right"; for (const v of [low, (low + high) / 2, high]) c.fillText(fixed(v), 48, Y(v) + 4);
  c.textAlign = "center"; for (const v of [0, deepest / 2, deepest]) c.fillText(fixed(v), X(v), height - 20);
  c.fillText(`depth, mm; force: ${state.axis === "fz" ? "compression" : AXIS_NAMES[state.axis]}, N`, width / 2, height - 4);
  c.textAlign = "left"; let x = 52;
  for (const [kind, colour] of kinds) {
    const text = { label: "label", network: "network", measured: "force sensor" }[kind];
    c.fillStyle = colour; c.fillText(`● ${text}`, x, 18); x += c.measureText(`● ${text}  `).width + 8;
    const points = values(kind); c.strokeStyle = colour; c.lineWidth = 1.5; c.beginPath();
    points.forEach((v, k) => { if (Number.isFinite(v)) c.lineTo(X(COLUMNS.depth[frames[k]]), Y(v)); }); c.stroke();
    points.forEach((v, k) => {
      if (!Number.isFinite(v)) return;
      c.beginPath(); c.arc(X(COLUMNS.depth[frames[k]]), Y(v), 4, 0, 7); c.fill();
      if (frames[k] === i && frames.length > 1) { c.beginPath(); c.arc(X(COLUMNS.depth[i]), Y(v), 7, 0, 7); c.stroke(); }
    });
  }
}

// ---- the gel in three dimensions
let room = null;
const SHARED = {};
function openRoom() {
  const box = el("gel"), probe = document.createElement("canvas");
  if (!(probe.getContext("webgl2"))) {
    box.replaceChildren(make("p", {}, "This browser shows no WebGL, which the turning gel needs; the maps above say the same in numbers."));
    return { none: true };
  }
  const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true }), scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(35, 2, 0.1, 300);
  camera.up.set(0, 0, 1); camera.position.set(26, -34, 26);
  box.replaceChildren(renderer.domElement);
  const controls = new THREE.OrbitControls(camera, renderer.domElement);
  controls.target.set(0, 0, -3);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 1.6));
  const sun = new THREE.DirectionalLight(0xffffff, 1.6); sun.position.set(-10, -14, 20); scene.add(sun);
  const draw = () => renderer.render(scene, camera);
  const fit = () => { renderer.setPixelRatio(window.devicePixelRatio || 1); renderer.setSize(box.clientWidth, box.clientHeight, false); camera.aspect = box.clientWidth / box.clientHeight; camera.updateProjectionMatrix(); draw(); };
  controls.addEventListener("change", draw); window.addEventListener("resize", fit); controls.update(); fit();
  return { scene, draw, camera, parts: new THREE.Group() };
}
async function sharedArrays(name) {
  if (!SHARED[name]) SHARED[name] = await unpack(name === "gel" ? DATA.shared.gel : DATA.shared.indenters[name]);
  return SHARED[name];
}
// a rejected row names no gel
const thickness = (i) => DATA.shared.heights[COLUMNS.gel[i]] ?? DATA.shared.gel.height;
const DENT = [[226, 232, 238], [250, 214, 137], [224, 104, 62], [110, 22, 66]];
function gelBody(points, moved, height) {
  const { rows, columns } = DATA.shared.gel, n = rows * columns, at = new Float32Array(3 * n), colour = new Float32Array(3 * n), faces = [];
  const tint = new THREE.Color();
  let deepest = 1e-6;
  for (let k = 0; k < n; k++) deepest = Math.max(deepest, moved ? -moved[3 * k + 2] : 0);
  for (let k = 0; k < n; k++) {
    for (let c = 0; c < 3; c++) at[3 * k + c] = points[3 * k + c] + (moved ? moved[3 * k + c] : 0);
    const [red, green, blue] = ramp(DENT, moved ? -moved[3 * k + 2] / deepest : 0);
    colour.set(tint.setRGB(red / 255, green / 255, blue / 255, "srgb").toArray(), 3 * k);
  }
  for (let r = 0; r + 1 < rows; r++) for (let k = 0; k + 1 < columns; k++) {
    const a = r * columns + k; faces.push(a, a + columns, a + 1, a + 1, a + columns, a + columns + 1);
  }
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(at, 3)); shape.setAttribute("color", new THREE.BufferAttribute(colour, 3));
  shape.setIndex(faces); shape.computeVertexNormals();
  const skirt = [], ring = [];
  for (let k = 0; k < columns; k++) ring.push(k);
  for (let r = 1; r < rows; r++) ring.push(r * columns + columns - 1);
  for (let k = columns - 2; k >= 0; k--) ring.push((rows - 1) * columns + k);
  for (let r = rows - 2; r >= 0; r--) ring.push(r * columns);
  for (let k = 0; k + 1 < ring.length; k++) {
    const a = ring[k], b = ring[k + 1], A = [...at.subarray(3 * a, 3 * a + 3)], B = [...at.subarray(3 * b, 3 * b + 3)], C = [B[0], B[1], -height], D = [A[0], A[1], -height];
    skirt.push(...A, ...B, ...C, ...A, ...C, ...D);
  }
  const wall = new THREE.BufferGeometry();
  wall.setAttribute("position", new THREE.BufferAttribute(new Float32Array(skirt), 3)); wall.computeVertexNormals();
  return [new THREE.Mesh(shape, new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide })), new THREE.Mesh(wall, new THREE.MeshLambertMaterial({ color: 0x8d99a6, side: THREE.DoubleSide }))];
}
function forceArrows(points, forces) {
  const n = points.length / 3;
  let largest = 1e-9;
  for (let k = 0; k < n; k++) largest = Math.max(largest, Math.hypot(forces[3 * k], forces[3 * k + 1], forces[3 * k + 2]));
  const stem = new THREE.CylinderGeometry(0.04, 0.04, 1, 5), head = new THREE.ConeGeometry(0.11, 0.3, 6), red = new THREE.MeshLambertMaterial({ color: 0x1f6f8b });
  stem.translate(0, -0.5, 0); head.translate(0, -0.15, 0);
  const stems = new THREE.InstancedMesh(stem, red, n), heads = new THREE.InstancedMesh(head, red, n), turn = new THREE.Quaternion(), up = new THREE.Vector3(0, 1, 0), m = new THREE.Matrix4();
  for (let k = 0; k < n; k++) { // an arrow ends where its force acts: one that starts there is hidden in the gel
    const f = new THREE.Vector3(forces[3 * k], forces[3 * k + 1], forces[3 * k + 2]), long = 4 * f.length() / largest, tip = new THREE.Vector3(points[3 * k], points[3 * k + 1], points[3 * k + 2]);
    turn.setFromUnitVectors(up, f.normalize());
    stems.setMatrixAt(k, m.compose(tip, turn, new THREE.Vector3(1, Math.max(long, 1e-3), 1)));
    heads.setMatrixAt(k, m.compose(tip, turn, new THREE.Vector3(1, Math.min(1, long + 1e-3), 1)));
  }
  return [stems, heads];
}
async function indenterBody(i) {
  const name = COLUMNS.indenter[i];
  if (!DATA.shared.indenters[name] || !Number.isFinite(COLUMNS.dz_mm[i])) return [];
  const { points, faces } = await sharedArrays(name), shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(points, 3)); shape.setIndex([...faces]);
  const flat = shape.toNonIndexed(); flat.computeVertexNormals();
  const body = new THREE.Mesh(flat, new THREE.MeshLambertMaterial({ color: 0xaab4c0, transparent: true, opacity: 0.28, side: THREE.DoubleSide, depthWrite: false }));
  const radians = (name) => (COLUMNS[name][i] || 0) * Math.PI / 180;
  body.rotation.set(radians("tilt_x_deg"), radians("tilt_y_deg"), radians("rot_deg"), "YXZ");
  body.position.set(COLUMNS.x0_mm[i] + COLUMNS.dx_mm[i], COLUMNS.y0_mm[i] + COLUMNS.dy_mm[i], COLUMNS.z0_mm[i] + COLUMNS.dz_mm[i]);
  return [body];
}
async function drawGel(i) {
  if (!room) { room = openRoom(); if (!room.none) room.scene.add(room.parts); }
  if (room.none) return;
  const { points } = await sharedArrays("gel"), things = gelBody(points, shown.arrays.gel, thickness(i));
  if (el("show-forces").checked && shown.arrays.points && shown.arrays.points.length) things.push(...forceArrows(shown.arrays.points, shown.arrays.forces));
  if (el("show-indenter").checked) things.push(...await indenterBody(i));
  if (state.at !== i) return;
  room.parts.traverse((thing) => { if (thing.geometry) { thing.geometry.dispose(); thing.material.dispose(); } });
  room.parts.clear(); room.parts.add(...things); room.draw();
}

// ---- what made a press
function provenanceRows(i) {
  const shard = COLUMNS.shard[i], { dataset, resolution, model } = DATA.about, d = `results/${dataset}`;
  const rows = [["step", "file", "parameters", "seconds", "processor seconds", "memory, MiB", "of"]];
  const line = (step, file, params, target, of) => {
    const cost = DATA.costs[target];
    rows.push([step, file, params, ...(cost ? cost.map((v) => fixed(v, 1)) : ["–", "–", "–"]), cost ? of : ""]);
  };
  rows.push(["log", `data/${dataset}/log.csv`, "", "", "", "", ""]);
  line("pose", `${d}/10_poses/${shard}.csv`, "poses.json", `10_poses/${shard}`, "its shard");
  if (COLUMNS.status[i] === "REJECTED") return rows;
  const mesh = COLUMNS.mesh[i];
  if (mesh) rows.push(["mesh", mesh.length > 90 ? `${mesh.slice(0, 90)}…` : mesh, "", "", "", "", ""]);
  rows.push([`solve (${COLUMNS.method[i] || "none"})`, "results/solves/, by the key in the table of its shard", "fea.json", fixed(COLUMNS.seconds[i], 1), "", fixed(COLUMNS.peak_mib[i], 0), "this press"]);
  line("solves", `${d}/30_fea/${shard}.csv`, "fea.json", `30_fea/${shard}`, "its shard");
  line("forces", `${d}/40_forces/${shard}.npz`, "forces.json", `40_forces/${shard}`, "its shard");
  line("label", `${d}/50_labels/${resolution}/${shard}.npz`, "labels.json", `50_labels/${resolution}/${shard}`, "its shard");
  if (COLUMNS.split[i]) {
    line("dataset", `${d}/60_dataset/${resolution}/`, "dataset.json", `60_dataset/${resolution}/dataset`, "all presses");
    if (DATA.about.learnt_here) line("network", `${d}/70_train/${resolution}/${model}.onnx`, "train.json", `70_train/${resolution}/${model}`, "all presses");
    else rows.push(["network", "src/gelforge/reading/weights/default.onnx", "", "", "", "", ""]);
    line("evaluation", `${d}/80_evaluate/${resolution}/${model}.json`, "evaluate.json", `80_evaluate/${resolution}/${model}`, "all presses");
  }
  return rows;
}
function provenance(i) {
  el("provenance").replaceChildren(...provenanceRows(i).map((row, k) => make("tr", {}, ...row.map((cell) => make(k ? "td" : "th", { style: "text-align:left" }, cell)))));
}

// ---- start
buildFilters();
for (const [name, title] of [["error", "error of the network"], ["force", "normal force"], ["depth", "depth"], ["indenter", "indenter"], ["sensor", "sensor"], ["split", "split"], ["status", "state"]]) el("colour").append(make("option", { value: name }, title));
if (!COLUMNS.error.some(Number.isFinite)) state.colour = "force";
el("colour").value = state.colour;
el("colour").onchange = () => { state.colour = el("colour").value; colourOf = null; drawMap(); };
el("map").onclick = pickOnMap;
document.addEventListener("keydown", (event) => {
  if (event.altKey || event.ctrlKey || event.metaKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
  const by = { ArrowDown: 1, ArrowRight: 1, ArrowUp: -1, ArrowLeft: -1 }[event.key];
  const near = event.target.closest && event.target.closest("#explorer");
  if (by && near) { event.preventDefault(); step(by); }
});
window.addEventListener("resize", () => { drawMap(); drawRows(); if (state.at >= 0) drawCurve(state.at); });
arrange();
const linked = PLACE.get(decodeURIComponent(location.hash.replace(/^#press=/, "")));
if (COUNT) choose(linked ?? state.order.find((i) => !FAILED[i] && Number.isFinite(COLUMNS.error[i])) ?? 0);
document.body.dataset.opened = performance.now().toFixed(0);
