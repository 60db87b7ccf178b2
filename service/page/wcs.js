// FITS TAN and TAN-SIP: pixel to ICRS and the directions of north and east, from header cards.

const RAD = Math.PI / 180;

export class Wcs {
  constructor(cards) {
    const get = (name) => cards[name] || 0;
    this.crpix = [get("CRPIX1"), get("CRPIX2")];
    this.crval = [get("CRVAL1") * RAD, get("CRVAL2") * RAD];
    this.cd = [get("CD1_1"), get("CD1_2"), get("CD2_1"), get("CD2_2")].map((v) => v * RAD);
    this.a = terms(cards, "A");
    this.b = terms(cards, "B");
  }

  // RA and Dec in degrees of a pixel (0, 0 is the centre of the first one).
  world(x, y) {
    const u = x + 1 - this.crpix[0], v = y + 1 - this.crpix[1];
    const f = u + sum(this.a, u, v), g = v + sum(this.b, u, v);
    const xi = this.cd[0] * f + this.cd[1] * g, eta = this.cd[2] * f + this.cd[3] * g;
    const [ra0, dec0] = this.crval, below = Math.cos(dec0) - eta * Math.sin(dec0);
    const ra = ra0 + Math.atan2(xi, below);
    const dec = Math.atan2(Math.sin(dec0) + eta * Math.cos(dec0), Math.hypot(xi, below));
    return [((ra / RAD) % 360 + 360) % 360, dec / RAD];
  }

  // Unit vectors in pixels towards north and east at the reference pixel.
  compass() {
    const [a, b, c, d] = this.cd, det = a * d - b * c;
    const unit = (x, y) => [x / Math.hypot(x, y), y / Math.hypot(x, y)];
    return { north: unit(-b / det, a / det), east: unit(d / det, -c / det) };
  }

  // Seconds of arc a pixel.
  scale() {
    return Math.sqrt(Math.abs(this.cd[0] * this.cd[3] - this.cd[1] * this.cd[2])) / RAD * 3600;
  }
}

function terms(cards, letter) {
  const found = [];
  for (const [name, value] of Object.entries(cards)) {
    const match = name.match(`^${letter}_(\\d+)_(\\d+)$`);
    if (match && value !== 0) found.push([Number(match[1]), Number(match[2]), value]);
  }
  return found;
}

const sum = (table, u, v) => table.reduce((s, [p, q, c]) => s + c * u ** p * v ** q, 0);

const two = (n) => String(n).padStart(2, "0");

function sexagesimal(value, places) {
  const unit = 10 ** places;
  let rest = Math.round(value * 3600 * unit);
  const s = rest % (60 * unit);
  rest = (rest - s) / (60 * unit);
  const text = (s / unit).toFixed(places).padStart(places ? 3 + places : 2, "0");
  return [Math.floor(rest / 60), two(rest % 60), text];
}

export function hms(degrees) {
  const [h, m, s] = sexagesimal(degrees / 15, 3);
  return `${two(h % 24)}h${m}m${s}s`;
}

export function dms(degrees) {
  const [d, m, s] = sexagesimal(Math.abs(degrees), 2), below = Math.round(degrees * 360000) < 0;
  return `${below ? "−" : "+"}${two(d)}°${m}′${s}″`;
}
