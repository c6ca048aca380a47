// How a force is coloured, on every page: along its axis red, against it blue, as reporting/forcemaps.py does in pictures.
const DIVERGING = [[5, 48, 97], [67, 147, 195], [247, 247, 247], [214, 96, 77], [103, 0, 31]];
function ramp(stops, t) {
  const x = Math.min(Math.max(t, 0), 1) * (stops.length - 1), k = Math.min(Math.floor(x), stops.length - 2), f = x - k;
  return stops[k].map((v, c) => v + f * (stops[k + 1][c] - v));
}
// Round numbers (1, 2 or 5 times a power of ten) from low to high, `count` to three times as many.
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough)), unit = power * [5, 2, 1].find((m) => m * power <= rough * (1 + 1e-9));
  const first = Math.ceil(low / unit - 1e-9), last = Math.floor(high / unit + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, k) => Number(((first + k) * unit).toPrecision(12)));
}
function paintMap(canvas, map, rows, cols, reach) {
  canvas.width = cols; canvas.height = rows;
  const c = canvas.getContext("2d"), pixels = c.createImageData(cols, rows);
  map.forEach((v, k) => pixels.data.set([...ramp(DIVERGING, 0.5 + v / (2 * reach)), 255], 4 * k));
  c.putImageData(pixels, 0, 0);
}
