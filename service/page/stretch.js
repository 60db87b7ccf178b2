// From values to grey: cuts, asinh, linear or logarithmic, upright or inverted; and a histogram.

const LEVELS = 4096;
export const KINDS = ["asinh", "linear", "log", "sqrt"];

export class Stretch {
  constructor() {
    this.kind = "asinh";
    this.invert = false;
    this.low = 0;
    this.high = 1;
    this.range = [0, 1];
    this.soft = 0.05;
    this.counts = null;
    this.version = 0;
    this.fresh = true; // cuts are to be measured anew
  }

  set(values) {
    Object.assign(this, values);
    if (!(this.high > this.low)) this.high = this.low + (Math.abs(this.low) || 1) * 1e-6;
    this.version++;
    this.table = null;
  }

  // Robust cuts: the sky's lower percent, and a bright percentile or 12 sigma of the sky.
  measure(arrays) {
    const total = arrays.reduce((n, a) => n + a.length, 0), step = Math.max(1, Math.floor(total / 2e5));
    const sample = [];
    for (const array of arrays) {
      for (let i = 0; i < array.length; i += step) if (isFinite(array[i])) sample.push(array[i]);
    }
    if (!sample.length) sample.push(0); // pixels that are masked are no numbers
    const sorted = Float64Array.from(sample).sort();
    const at = (q) => sorted[Math.min(sorted.length - 1, Math.floor(q * sorted.length))];
    const middle = at(0.5);
    const spread = Float64Array.from(sorted, (v) => Math.abs(v - middle)).sort();
    const sigma = 1.4826 * spread[Math.floor(spread.length / 2)] || 1;
    const low = at(0.01), high = Math.max(at(0.997), middle + 12 * sigma);
    this.range = [Math.min(at(0), low), Math.max(at(0.999), 1.25 * high - 0.25 * low)];
    this.soft = Math.min(1, 3 * sigma / (high - low));
    this.counts = counts(sorted, this.range);
    this.set({ low, high });
  }

  // Values to RGBA, as 32-bit words.
  lookup() {
    if (this.table) return this.table;
    this.table = new Uint32Array(LEVELS + 1);
    for (let i = 0; i <= LEVELS; i++) {
      let s = i / LEVELS;
      if (this.kind === "asinh") s = Math.asinh(s / this.soft) / Math.asinh(1 / this.soft);
      else if (this.kind === "log") s = Math.log1p(1000 * s) / Math.log1p(1000);
      else if (this.kind === "sqrt") s = Math.sqrt(s);
      const grey = Math.round(255 * (this.invert ? 1 - s : s));
      this.table[i] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
    }
    return this.table;
  }

  // The tile as a small canvas, its first row at the bottom; made again when the stretch changes.
  picture(tile) {
    if (tile.version === this.version) return tile.picture;
    const { rows, columns, values } = tile, table = this.lookup();
    const canvas = tile.picture || new OffscreenCanvas(columns, rows);
    const image = new ImageData(columns, rows), words = new Uint32Array(image.data.buffer);
    const low = this.low, factor = LEVELS / (this.high - this.low);
    for (let y = 0; y < rows; y++) {
      const from = y * columns, to = (rows - 1 - y) * columns;
      for (let x = 0; x < columns; x++) {
        const level = (values[from + x] - low) * factor;
        words[to + x] = table[level <= 0 ? 0 : level >= LEVELS ? LEVELS : level | 0];
      }
    }
    canvas.getContext("2d").putImageData(image, 0, 0);
    tile.picture = canvas;
    tile.version = this.version;
    return canvas;
  }

  // The histogram (counts by their logarithm) with both cuts.
  chart(canvas) {
    const pen = canvas.getContext("2d"), { width, height } = canvas;
    pen.clearRect(0, 0, width, height);
    if (!this.counts) return;
    const colour = getComputedStyle(canvas).color, top = Math.log1p(Math.max(...this.counts));
    pen.fillStyle = colour;
    pen.globalAlpha = 0.45;
    this.counts.forEach((n, i) => {
      const h = top ? Math.log1p(n) / top * (height - 4) : 0;
      pen.fillRect(i * width / this.counts.length, height - h, width / this.counts.length + 0.5, h);
    });
    pen.globalAlpha = 1;
    for (const [value, shade] of [[this.low, "#6ea8fe"], [this.high, "#ffd479"]]) {
      const x = (value - this.range[0]) / (this.range[1] - this.range[0]) * width;
      pen.fillStyle = shade;
      pen.fillRect(Math.min(width - 3, Math.max(0, x - 1.5)), 0, 3, height);
    }
  }
}

function counts(sorted, [from, to], bins = 128) {
  const found = new Array(bins).fill(0);
  for (const v of sorted) {
    found[Math.max(0, Math.min(bins - 1, Math.floor((v - from) / (to - from) * bins)))]++;
  }
  return found;
}
