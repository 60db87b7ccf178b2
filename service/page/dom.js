// Making elements: text is always text, never markup.

export function el(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "value" || key === "checked" || key === "disabled") node[key] = value;
    else node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.flat(Infinity).filter((c) => c !== null && c !== undefined && c !== false));
  return node;
}

export function fill(node, ...children) {
  node.replaceChildren(...children.flat(Infinity).filter((c) => c !== null && c !== undefined && c !== false));
  return node;
}

export function number(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  if (Number.isInteger(value) && Math.abs(value) < 1e7) return String(value);
  if (value !== 0 && Math.abs(value) < 1e-3) return value.toExponential(Math.max(0, digits - 1));
  return String(Number(value.toPrecision(digits)));
}

export function amount(bytes) {
  const units = ["B", "kB", "MB", "GB", "TB"], shown = Number(bytes.toPrecision(3));
  const k = Math.min(units.length - 1, Math.max(0, Math.floor(Math.log10(Math.max(1, shown)) / 3)));
  return `${number(bytes / 1000 ** k, 3)} ${units[k]}`;
}

export function seconds(value) {
  if (value < 59.5) return `${value.toFixed(value < 9.95 ? 1 : 0)} s`;
  const s = Math.round(value), min = Math.round(value / 60);
  if (s < 3600) return `${Math.floor(s / 60)} min ${s % 60} s`;
  return `${Math.floor(min / 60)} h ${min % 60} min`;
}

// What `/v1/usage` counts, in words; and, where the list shows fewer, that it does.
export function countsOf(phases) {
  const parts = [[phases.EXECUTING, "running"], [phases.QUEUED + phases.PENDING, "waiting"]];
  return parts.filter(([n]) => n).map(([n, text]) => `${n} ${text}`).join(", ");
}

export function moreOf(phases, listed) {
  const all = Object.values(phases).reduce((sum, n) => sum + n, 0);
  return listed < all ? `the newest ${listed} of ${all} are shown, and all that run` : "";
}

// What hides a source of the truth all through the exposure: "earth", "horizon", or nothing.
export const hiddenBy = (source) => (source.visible_fraction === 0 ? source.hidden_by : null);

// A button that copies text, and says that it did.
export function copier(text, what) {
  const button = el("button", { type: "button", class: "copy", title: `copy ${what}` }, "copy");
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text());
    } catch {
      const area = el("textarea", {}, text());
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1500);
  });
  return button;
}

let timer = 0;
export function notice(text) {
  const box = document.getElementById("notice");
  box.textContent = text;
  box.hidden = !text;
  clearTimeout(timer);
  if (text) timer = setTimeout(() => { box.hidden = true; }, 8000);
}
