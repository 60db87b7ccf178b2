// A frame on a canvas: tiles at the resolution that is needed, stretched here, truth drawn over.

import { ask } from "./api.js";
import { hiddenBy } from "./dom.js";
import { Stretch } from "./stretch.js";

const KEEP_PX = 48e6; // pixels of values kept in memory
const SHOWN_SIDE = 1200; // the whole frame is fetched at about this many pixels a side

export class Viewer extends EventTarget {
  constructor(canvas, path, about) {
    super();
    this.canvas = canvas;
    this.path = path;
    this.frame = 0;
    this.layer = "dn";
    this.tiles = new Map();
    this.drawn = new Set();
    this.stretch = new Stretch();
    this.truth = null;
    this.wcs = null;
    this.overlay = { targets: true, stars: false, names: true };
    this.scale = 0;
    this.centre = [0, 0];
    this.marked = null;
    this.abort = new AbortController();
    this.describe(about);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(canvas);
    this.pointers();
  }

  describe(about) {
    this.about = about;
    const [ny, nx] = about.shape, [ty, tx] = about.tile_shape;
    this.grid = [Math.ceil(ny / ty), Math.ceil(nx / tx)];
    this.coarsest = 1;
    while (Math.max(ny, nx) / this.coarsest > SHOWN_SIDE && this.coarsest < 64) this.coarsest *= 2;
    this.finest = 1; // the service gives at most 2^24 pixels at once
    while (Math.min(ty, ny) * Math.min(tx, nx) / this.finest ** 2 > 2 ** 24) this.finest *= 2;
    this.coarsest = Math.max(this.coarsest, this.finest);
  }

  close() {
    this.abort.abort();
    this.observer.disconnect();
  }

  show(frame, layer) {
    const same = layer === this.layer;
    this.frame = frame;
    this.layer = layer;
    if (!same) this.stretch.fresh = true;
    this.truth = null;
    this.wcs = null;
    this.drawn = new Set();
    this.paint();
  }

  // Tiles [[row, column], …] of the frame that is shown are drawn and may be fetched.
  has(tiles) {
    this.drawn = new Set(tiles.map(([r, c]) => `${r}/${c}`));
    this.fetchSeen();
    this.paint();
  }

  resize() {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(box.width * ratio));
    this.canvas.height = Math.max(1, Math.round(box.height * ratio));
    if (!this.touched) this.fit();
    else this.paint();
  }

  fit() {
    const [ny, nx] = this.about.shape;
    this.touched = false;
    this.scale = Math.min(this.canvas.width / nx, this.canvas.height / ny);
    this.centre = [(nx - 1) / 2, (ny - 1) / 2];
    this.changed();
  }

  // Zoom so that the pixel under (x, y) of the canvas stays there; `to` is device px a pixel.
  zoom(to, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    const [px, py] = this.pixel(x, y);
    this.touched = true;
    const whole = Math.min(this.canvas.width / this.about.shape[1],
      this.canvas.height / this.about.shape[0]);
    this.scale = Math.min(64, Math.max(0.5 * whole, to));
    this.centre[0] += px - this.pixel(x, y)[0];
    this.centre[1] += py - this.pixel(x, y)[1];
    this.changed();
  }

  move(dx, dy) {
    this.touched = true;
    this.centre[0] -= dx / this.scale;
    this.centre[1] += dy / this.scale;
    this.changed();
  }

  go(x, y, scale) {
    this.touched = true;
    this.centre = [x, y];
    if (scale) this.scale = Math.max(this.scale, scale);
    this.changed();
  }

  changed() {
    const [ny, nx] = this.about.shape;
    this.centre[0] = Math.min(nx - 1, Math.max(0, this.centre[0]));
    this.centre[1] = Math.min(ny - 1, Math.max(0, this.centre[1]));
    clearTimeout(this.later);
    this.later = setTimeout(() => this.fetchSeen(), 80);
    this.paint();
    this.dispatchEvent(new Event("view"));
  }

  // Canvas to frame: pixel (0, 0) is the centre of the first one; row 0 is at the bottom.
  pixel(x, y) {
    return [this.centre[0] + (x - this.canvas.width / 2) / this.scale,
      this.centre[1] - (y - this.canvas.height / 2) / this.scale];
  }

  place(px, py) {
    return [this.canvas.width / 2 + (px - this.centre[0]) * this.scale,
      this.canvas.height / 2 - (py - this.centre[1]) * this.scale];
  }

  wanted() {
    let bin = this.coarsest;
    while (bin > this.finest && bin * this.scale > 1.01) bin /= 2;
    return bin;
  }

  seen() {
    const [ty, tx] = this.about.tile_shape;
    const [x0, y0] = this.pixel(0, this.canvas.height), [x1, y1] = this.pixel(this.canvas.width, 0);
    const found = [];
    for (let r = 0; r < this.grid[0]; r++) {
      for (let c = 0; c < this.grid[1]; c++) {
        const out = (r + 1) * ty - 0.5 < y0 || r * ty - 0.5 > y1
          || (c + 1) * tx - 0.5 < x0 || c * tx - 0.5 > x1;
        if (!out) found.push([r, c]);
      }
    }
    return found;
  }

  fetchSeen() {
    if (!this.scale) return;
    const bin = this.wanted();
    for (const [r, c] of this.seen()) {
      if (this.drawn.has(`${r}/${c}`)) this.fetch(r, c, bin);
    }
  }

  name(r, c, bin) {
    return `${this.frame}/${this.layer}/${bin}/${r}/${c}`;
  }

  async fetch(r, c, bin) {
    const name = this.name(r, c, bin);
    if (this.tiles.has(name)) return;
    this.tiles.set(name, null);
    try {
      const query = `?layer=${encodeURIComponent(this.layer)}&bin=${bin}`;
      const where = `${this.path}/frames/${this.frame}/tiles/${r}/${c}${query}`;
      const answer = await ask(where, { signal: this.abort.signal });
      const [rows, columns] = answer.headers.get("X-Shape").split(",").map(Number);
      const values = typed(await answer.arrayBuffer(), answer.headers.get("X-Type"));
      this.tiles.set(name, { values, rows, columns, bin, version: -1 });
      this.forget();
      if (this.stretch.fresh && name.startsWith(`${this.frame}/${this.layer}/`)) this.auto();
      this.paint();
      this.dispatchEvent(new Event("tiles"));
    } catch (error) {
      this.tiles.delete(name);
      if (error.name !== "AbortError") this.dispatchEvent(new CustomEvent("fault", { detail: error }));
    }
  }

  forget() {
    let total = 0;
    for (const [name, tile] of [...this.tiles].reverse()) {
      total += tile ? tile.values.length : 0;
      if (total > KEEP_PX && !name.startsWith(`${this.frame}/${this.layer}/`)) this.tiles.delete(name);
    }
  }

  loaded() {
    const start = `${this.frame}/${this.layer}/`;
    return [...this.tiles].filter(([name, tile]) => tile && name.startsWith(start)).map(([, t]) => t);
  }

  // Cuts from what is loaded of the frame.
  auto() {
    const tiles = this.loaded();
    if (!tiles.length) return;
    const bin = Math.max(...tiles.map((t) => t.bin));
    this.stretch.measure(tiles.filter((t) => t.bin === bin).map((t) => t.values));
    this.stretch.fresh = tiles.length < this.grid[0] * this.grid[1] && !this.about.complete;
    this.dispatchEvent(new Event("stretch"));
    this.paint();
  }

  // The value under a pixel, and over how many pixels on a side it was binned; null if not there.
  value(px, py) {
    const [ty, tx] = this.about.tile_shape, [ny, nx] = this.about.shape;
    const x = Math.round(px), y = Math.round(py);
    if (x < 0 || y < 0 || x >= nx || y >= ny) return null;
    const r = Math.floor(y / ty), c = Math.floor(x / tx);
    for (let bin = this.finest; bin <= this.coarsest; bin *= 2) {
      const tile = this.tiles.get(this.name(r, c, bin));
      if (tile) {
        const at = Math.floor((y - r * ty) / bin) * tile.columns + Math.floor((x - c * tx) / bin);
        return { value: tile.values[at], bin };
      }
    }
    return null;
  }

  paint() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => { this.waiting = 0; this.draw(); });
  }

  draw() {
    const pen = this.canvas.getContext("2d"), { width, height } = this.canvas;
    pen.fillStyle = "#05070c";
    pen.fillRect(0, 0, width, height);
    if (!this.scale) return;
    const [ty, tx] = this.about.tile_shape, [ny, nx] = this.about.shape, bin = this.wanted();
    let shown = 0;
    for (const [r, c] of this.seen()) {
      const [x0, y1] = this.place(c * tx - 0.5, r * ty - 0.5);
      const [x1, y0] = this.place(Math.min((c + 1) * tx, nx) - 0.5, Math.min((r + 1) * ty, ny) - 0.5);
      const tile = this.best(r, c, bin);
      if (!tile) {
        blank(pen, x0, y0, x1 - x0, y1 - y0);
        continue;
      }
      shown++;
      pen.imageSmoothingEnabled = this.scale * tile.bin < 1;
      pen.imageSmoothingQuality = "high";
      const w = tile.columns * tile.bin * this.scale, h = tile.rows * tile.bin * this.scale;
      pen.save();
      pen.beginPath();
      pen.rect(Math.floor(x0), Math.floor(y0), Math.ceil(x1) - Math.floor(x0), Math.ceil(y1) - Math.floor(y0));
      pen.clip();
      pen.drawImage(this.stretch.picture(tile), x0, y1 - h, w, h);
      pen.restore();
    }
    this.canvas.dataset.tiles = shown; // in view and drawn here
    const inside = this.place(-0.5, ny - 0.5).concat([nx * this.scale, ny * this.scale]);
    pen.strokeStyle = "#3b465c";
    pen.strokeRect(...inside);
    drawTruth(pen, this);
    if (this.wcs) drawCompass(pen, this.wcs, width);
  }

  best(r, c, bin) {
    for (let b = bin; b <= this.coarsest; b *= 2) {
      const tile = this.tiles.get(this.name(r, c, b));
      if (tile) return tile;
    }
    for (let b = bin / 2; b >= this.finest; b /= 2) {
      const tile = this.tiles.get(this.name(r, c, b));
      if (tile) return tile;
    }
    return null;
  }

  pointers() {
    const canvas = this.canvas, options = { signal: this.abort.signal };
    const at = (event) => {
      const box = canvas.getBoundingClientRect();
      return [(event.clientX - box.left) * canvas.width / box.width,
        (event.clientY - box.top) * canvas.height / box.height];
    };
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      held = at(event);
      canvas.setPointerCapture(event.pointerId);
    }, options);
    canvas.addEventListener("pointerup", () => { held = null; }, options);
    canvas.addEventListener("pointermove", (event) => {
      const now = at(event);
      if (held) {
        this.move(now[0] - held[0], now[1] - held[1]);
        held = now;
      }
      this.dispatchEvent(new CustomEvent("pointer", { detail: this.pixel(...now) }));
    }, options);
    canvas.addEventListener("pointerleave", () => {
      this.dispatchEvent(new CustomEvent("pointer", { detail: null }));
    }, options);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(this.scale * Math.exp(-event.deltaY * 0.0015), ...at(event));
    }, { passive: false, ...options });
    canvas.addEventListener("dblclick", (event) => this.zoom(this.scale * 2, ...at(event)), options);
  }
}

function typed(buffer, kind) {
  if (kind === "<f4") return new Float32Array(buffer);
  if (kind === "<u2") return new Uint16Array(buffer);
  if (kind === "|u1") return new Uint8Array(buffer);
  if (kind === "<u4") return new Uint32Array(buffer);
  if (kind === "<i4") return new Int32Array(buffer);
  if (kind === "<u8") return Float64Array.from(new BigUint64Array(buffer), Number);
  if (kind === "<i8") return Float64Array.from(new BigInt64Array(buffer), Number);
  if (kind === "<f8") return new Float64Array(buffer);
  throw new Error(`values of type ${kind} cannot be shown`);
}

function blank(pen, x, y, w, h) {
  pen.fillStyle = "#0d1320";
  pen.fillRect(x, y, w, h);
  pen.strokeStyle = "#1d2638";
  pen.beginPath();
  pen.rect(x + 0.5, y + 0.5, w - 1, h - 1);
  pen.moveTo(x, y);
  pen.lineTo(x + w, y + h);
  pen.moveTo(x + w, y);
  pen.lineTo(x, y + h);
  pen.stroke();
}

function drawTruth(pen, view) {
  if (!view.truth) return;
  const unit = window.devicePixelRatio || 1;
  pen.lineWidth = 1.25 * unit;
  pen.font = `${12 * unit}px system-ui, sans-serif`;
  if (view.overlay.stars) {
    for (const star of view.truth.stars) ring(pen, view, star, "#6ea8fe", 7 * unit, "");
  }
  if (view.overlay.targets) {
    for (const target of view.truth.targets) {
      const hidden = hiddenBy(target) ? ` (behind the ${hiddenBy(target)})` : "";
      const name = view.overlay.names ? target.name + hidden : "";
      ring(pen, view, target, "#5cf28a", 13 * unit, name);
    }
  }
  if (view.marked) {
    pen.lineWidth = 2 * unit;
    ring(pen, view, view.marked, "#ffd479", 19 * unit, "");
  }
}

function ring(pen, view, thing, colour, radius, name) {
  const [x, y] = view.place(thing.x_px, thing.y_px);
  if (x < -200 || y < -200 || x > view.canvas.width + 200 || y > view.canvas.height + 200) return;
  pen.strokeStyle = colour;
  pen.fillStyle = colour;
  pen.setLineDash(hiddenBy(thing) ? [radius / 3, radius / 3] : []);
  const [xs, ys] = view.place(thing.x_start_px, thing.y_start_px);
  const [xe, ye] = view.place(thing.x_end_px, thing.y_end_px);
  const length = Math.hypot(xe - xs, ye - ys);
  pen.beginPath();
  if (length > 2 * radius) { // a long box of round ends about the streak
    const angle = Math.atan2(ye - ys, xe - xs), quarter = Math.PI / 2;
    pen.arc(xs, ys, radius, angle + quarter, angle - quarter);
    pen.arc(xe, ye, radius, angle - quarter, angle + quarter);
    pen.closePath();
  } else {
    pen.arc(x, y, radius, 0, 2 * Math.PI);
  }
  pen.stroke();
  pen.setLineDash([]);
  if (name) {
    pen.save();
    pen.strokeStyle = "#000c";
    pen.lineWidth = 4 * (window.devicePixelRatio || 1);
    pen.lineJoin = "round";
    pen.strokeText(name, x + radius * 1.1, y - radius * 0.9);
    pen.fillText(name, x + radius * 1.1, y - radius * 0.9);
    pen.restore();
  }
}

function drawCompass(pen, wcs, width) {
  const unit = window.devicePixelRatio || 1, r = 26 * unit, x = width - 46 * unit, y = 50 * unit;
  const arrows = wcs.compass();
  pen.save();
  pen.lineWidth = 1.5 * unit;
  pen.font = `${11 * unit}px system-ui, sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.shadowColor = "#000";
  pen.shadowBlur = 4;
  for (const [name, [dx, dy], colour] of
    [["N", arrows.north, "#ffd479"], ["E", arrows.east, "#9fb0c9"]]) {
    pen.strokeStyle = colour;
    pen.fillStyle = colour;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + r * dx, y - r * dy);
    pen.stroke();
    pen.fillText(name, x + 1.35 * r * dx, y - 1.35 * r * dy);
  }
  pen.restore();
}
