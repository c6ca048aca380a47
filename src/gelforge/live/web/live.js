"use strict";
const el = (id) => document.getElementById(id);
const fixed = (v, digits = 2) => (Number.isFinite(v) ? (+v.toFixed(digits) + 0).toFixed(digits) : "–");  // + 0: no "-0.00"
const MAPS = [["short", 0, "x, along the short side"], ["long", 1, "y, along the long side"], ["normal", 2, "z, normal"]];
const TOTALS = [["fz_n", 2, "#1f6f8b"], ["fx_n", 0, "#d1603d"], ["fy_n", 1, "#5b8c3a"]], FLAGGED = "#dde1e6";
const LEFT = 50, RIGHT = 10;  // margins of the curve, px
let history = [], drawing = false, latest = null;
let held = null, replaying = false;  // the earlier event that is shown in place of the latest one
async function unpack(packed) {
  const bytes = Uint8Array.from(atob(packed.data), (s) => s.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer()), n = planes.length / 2, unit = packed.arrays[0][2];
  return Float32Array.from({ length: n }, (_, k) => ((planes[k] | (planes[n + k] << 8)) << 16 >> 16) * unit);
}
function drawMap(name, map, rows, cols, title, least) {
  const reach = Math.max(least, ...map.map(Math.abs));
  paintMap(el(name), map, rows, cols, reach);
  el(`cap-${name}`).textContent = `${title}, ± ${fixed(reach, 3)} N a cell`;
}
function drawCurve() {
  const canvas = el("curve"), ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight, c = canvas.getContext("2d");
  canvas.width = width * ratio; canvas.height = height * ratio; c.setTransform(ratio, 0, 0, ratio, 0, 0); c.font = "12px system-ui, sans-serif";
  if (history.length < 2) return;
  const value = (e, [name]) => e[name], half = (e, [, channel]) => (e.half_width ? e.half_width[channel] : 0);
  const all = history.flatMap((e) => TOTALS.flatMap((t) => [value(e, t) - half(e, t), value(e, t) + half(e, t)]));
  const low = Math.min(-1, ...all), high = Math.max(0, ...all), first = history[0].time_s, span = Math.max(history.at(-1).time_s - first, 1e-3);
  const X = (t) => LEFT + (width - LEFT - RIGHT) * (t - first) / span, Y = (v) => height - 24 - (height - 34) * (v - low) / (high - low);
  c.fillStyle = FLAGGED;
  history.forEach((e, k) => {  // shade half way to the neighbouring frames
    const edge = (at) => X((e.time_s + (history[at] || e).time_s) / 2);
    if (e.flag) c.fillRect(Math.floor(edge(k - 1)), Y(high), Math.ceil(edge(k + 1)) - Math.floor(edge(k - 1)), Y(low) - Y(high));
  });
  c.strokeStyle = "#d9dee4"; c.fillStyle = "#555c66"; c.textAlign = "right";
  for (const v of ticks(low, high, 3)) { c.beginPath(); c.moveTo(LEFT, Y(v)); c.lineTo(width - RIGHT, Y(v)); c.stroke(); c.fillText(`${v} N`, LEFT - 4, Y(v) + 4); }
  c.textAlign = "center";
  for (const t of ticks(first, first + span, 6)) c.fillText(`${t} s`, Math.min(X(t), width - c.measureText(`${t} s`).width / 2), height - 6);
  for (const total of TOTALS) {
    c.fillStyle = `${total[2]}33`; c.beginPath();
    history.forEach((e) => c.lineTo(X(e.time_s), Y(value(e, total) + half(e, total))));
    [...history].reverse().forEach((e) => c.lineTo(X(e.time_s), Y(value(e, total) - half(e, total)))); c.fill();
    c.strokeStyle = total[2]; c.lineWidth = 1.5; c.beginPath(); history.forEach((e) => c.lineTo(X(e.time_s), Y(value(e, total)))); c.stroke();
  }
  if (held) { c.strokeStyle = "#20242a"; c.lineWidth = 1; c.beginPath(); c.moveTo(X(held.time_s), Y(high)); c.lineTo(X(held.time_s), Y(low)); c.stroke(); }
}
async function paint(event) {
  const [rows, cols] = event.grid, n = rows * cols, forces = await unpack(event.forces);
  el("image").style.visibility = "visible";
  el("image").src = `data:image/jpeg;base64,${event.image}`;
  for (const [name, channel, title] of MAPS) drawMap(name, forces.subarray(channel * n, (channel + 1) * n), rows, cols, title, FULL_COLOUR_N[channel]);
  for (const [id, [name, channel]] of [["z", TOTALS[0]], ["x", TOTALS[1]], ["y", TOTALS[2]]]) el(id).textContent = fixed(event[name]) + (event.half_width ? ` ± ${fixed(event.half_width[channel])}` : "");
  for (const name of ["mx", "my", "mz"]) {
    const half = event[`${name}_half_width_nm`];
    el(name).textContent = event[`${name}_nm`] == null ? "–" : fixed(1000 * event[`${name}_nm`], 1) + (half == null ? "" : ` ± ${fixed(1000 * half, 1)}`);
  }
  el("edge").textContent = event.edge_peak == null ? "–" : `${fixed(100 * event.edge_peak, 0)} %`;
  el("flag").className = event.flag ? "on" : "";
  el("flag").textContent = event.flag ? event.reason : event.edge_peak >= BEYOND ? "the image crops a contact: the forces are those of the visible part" : "nothing seems wrong with the image";
  el("band").textContent = event.half_width ? "band: 90 % prediction interval of each force" : "";
  el("state").textContent = `frame ${event.frame} at ${fixed(event.time_s, 1)} s, read in ${fixed(event.ms, 1)} ms`;
  drawCurve();
}
async function show(event) {
  if (history.length && event.time_s < history.at(-1).time_s) history = [];
  if (!history.length || event.frame !== history.at(-1).frame) history.push(event);
  if (history.length > KEPT) history.shift();
  const recent = history.slice(-30), span = recent.at(-1).time_s - recent[0].time_s;
  el("rate").textContent = span > 0 ? fixed((recent.length - 1) / span, 1) : "–";
  const strongest = shown().reduce((best, e) => (Math.abs(e.fz_n) > Math.abs(best.fz_n) ? e : best), event);
  if (event.said && !event.fault && !held) await hold(strongest);  // it ended
  else await (held ? drawCurve() : paint(event));
  document.body.dataset.frame = event.frame;
}
// Show an earlier moment until the button leads back to the latest one; pages have images from when they were opened on.
const shown = () => history.filter((e) => e.image);
async function hold(event) {
  held = event === history.at(-1) ? null : event;
  el("replay").textContent = held ? "back to the latest frame" : "replay";
  await paint(event);
}
async function replay() {
  replaying = true;
  for (const event of shown()) {
    const began = performance.now(), next = history[history.indexOf(event) + 1];
    if (replaying) await hold(event);
    if (replaying && next) await new Promise((go) => setTimeout(go, 1000 * (next.time_s - event.time_s) - (performance.now() - began)));
  }
  replaying = false;
}
el("replay").onclick = () => {
  if (!held) return replay();
  replaying = false;
  return hold(history.at(-1));
};
el("curve").onclick = ({ offsetX }) => {
  const first = history[0]?.time_s, at = first + (history.at(-1)?.time_s - first) * (offsetX - LEFT) / (el("curve").clientWidth - LEFT - RIGHT);
  const nearest = shown().reduce((best, e) => (best && Math.abs(best.time_s - at) <= Math.abs(e.time_s - at) ? best : e), null);
  replaying = false;
  if (nearest) hold(nearest);
};
// Frames may come faster than they are drawn: draw the latest and skip those between.
async function take(event) {
  latest = event;
  if (drawing) return;
  drawing = true;
  while (latest) { const next = latest; latest = null; await show(next); await new Promise(requestAnimationFrame); }
  drawing = false;
}
const source = new EventSource("events");
source.onmessage = (message) => {
  const event = JSON.parse(message.data);
  if (event.before) history = event.before;
  if (event.said) { el("said").textContent = event.said; el("said").className = event.fault ? "reason" : "note"; }
  if (event.image) take(event);
};
source.onerror = () => { el("state").textContent = "the program that reads the sensor does not answer; start gelforge live --web again"; };
window.addEventListener("resize", drawCurve);
