// How a force is coloured, on every page: along its axis red, against it blue, as reporting/forcemaps.py does in pictures.
const DIVERGING = [[5, 48, 97], [67, 147, 195], [247, 247, 247], [214, 96, 77], [103, 0, 31]];
function ramp(stops, t) {
  const x = Math.min(Math.max(t, 0), 1) * (stops.length - 1), k = Math.min(Math.floor(x), stops.length - 2), f = x - k;
  return stops[k].map((v, c) => v + f * (stops[k + 1][c] - v));
}
function paintMap(canvas, map, rows, cols, reach) {
  canvas.width = cols; canvas.height = rows;
  const c = canvas.getContext("2d"), pixels = c.createImageData(cols, rows);
  map.forEach((v, k) => pixels.data.set([...ramp(DIVERGING, 0.5 + v / (2 * reach)), 255], 4 * k));
  c.putImageData(pixels, 0, 0);
}
