// Sweeps and studies: they have no frames; at the end their figures, tables and pages.

import { ask, json } from "./api.js";
import { el, fill, notice, number, seconds } from "./dom.js";
import { warnings } from "./submit.js";

const table = (heads, rows) => el("div", { class: "scroll" }, el("table", { class: "figures" },
  el("thead", {}, el("tr", {}, heads.map((h) => el("th", {}, h)))), el("tbody", {}, rows)));
const shown = (value) => (typeof value === "number" || value === null || value === undefined ? number(value)
  : typeof value === "string" ? value : JSON.stringify(value));
const numbers = (values) => values.map((value) => el("td", { class: "num" }, shown(value)));
const named = (key) => key.replaceAll("_", " ");

const GAPS = { objects: "objects", gap_median_h: "median gap [h]", gap_p95_h: "95 % [h]",
  gap_longest_h: "longest [h]", first_detection_h: "first detection [h]", custody_fraction: "in custody" };
const GROUPS = { by_regime: "orbit", by_kind: "kind of object", by_altitude_km: "altitude [km]" };

// The spread of each metric of a sweep.
function sweepCard(report) {
  const rows = Object.entries(report.metrics).map(([name, s]) => el("tr", { "data-metric": name },
    el("td", {}, el("code", {}, name)), numbers([s.known, s.least, s.mean, s.largest])));
  const faults = Object.entries(report.messages).map(([text, n]) => el("li", {}, `${n} × `, el("code", {}, text)));
  const doubts = Object.entries(report.doubts ?? {}).map(([text, n]) => `${n} × ${text}`);
  return [
    warnings([...doubts, ...(report.warnings ?? [])]),
    el("p", {}, `${report.points} points over ${report.axes.join(", ")}: ${report.failed} failed, ${seconds(report.seconds)}.`),
    table(["metric", "known", "least", "mean", "largest"], rows),
    faults.length ? [el("h2", {}, "Failures"), el("ul", {}, faults)] : null];
}

const notesOf = ({ notes = [] }) => (notes.length ? el("ul", {}, notes.map((note) => el("li", {}, note))) : null);

// What a study found; of one with axes, the figures of each point.
function studyCard(report) {
  if (report.points) {
    const keys = Object.keys(report.points[0]);
    const rows = report.points.map((p) => el("tr", { "data-point": p.point }, numbers(keys.map((key) => p[key]))));
    return [table(keys.map(named), rows), notesOf(report)];
  }
  const f = report.figures;
  return [
    el("p", {}, `${f.objects} objects for ${number(report.hours)} h from ${report.start}: `
      + `${f.observations} observations, ${f.detections} detections of ${f.objects_detected} objects; `
      + `${number(100 * f.sensor_time_used, 3)} % of the sensors' time used, ${seconds(report.seconds)}.`),
    notesOf(report),
    Object.entries(GROUPS).map(([group, word]) => table([word, ...Object.values(GAPS)],
      Object.entries(report[group]).map(([name, g]) => el("tr", { "data-group": name },
        el("td", {}, name), numbers(Object.keys(GAPS).map((key) => g[key]))))))];
}

// A picture from what a file of the job holds.
function image(alt, content, type) {
  const src = URL.createObjectURL(new Blob([content], { type }));
  return el("img", { alt, src, onload: () => URL.revokeObjectURL(src) });
}
const textOf = async (path) => (await ask(path)).text();

async function sweepPictures(report, path) {
  return [image("what was measured over the axes", await textOf(`${path}/summary.svg`), "image/svg+xml")];
}

// Those that the study's own page carries inside.
async function studyPictures(report, path) {
  if (report.points) return [];
  const inside = /alt="([^"]*)" src="data:image\/png;base64,([^"]*)"/g;
  return [...(await textOf(`${path}/report.html`)).matchAll(inside)].map(([, alt, text]) =>
    image(alt, Uint8Array.from(atob(text), (c) => c.charCodeAt(0)), "image/png"));
}

const POINTS = { "points.parquet": "table of points, Parquet" }, REPORT = { "report.json": "report, JSON" };
const sweepFiles = () => ({ ...POINTS, "summary.html": "summary, a page", ...REPORT, "sweep.json": "the sweep, JSON" });
const studyFiles = (report) => (report.points ? { ...POINTS, ...REPORT }
  : { "report.html": "report with figures, a page", "objects.parquet": "table of objects, Parquet",
    "sensors.parquet": "table of sensors, Parquet", ...REPORT, "study.json": "the study, JSON" });
const KINDS = {
  sweep: { unit: "points", does: "rendered and measured", card: sweepCard, pictures: sweepPictures, files: sweepFiles },
  study: { unit: "tasks", does: "worked out", card: studyCard, pictures: studyPictures, files: studyFiles },
};

export const hasFrames = (job) => !KINDS[job.kind];
export const unitOf = (job) => KINDS[job.kind]?.unit ?? "tiles";

export function waiting(job) {
  const { unit, does } = KINDS[job.kind];
  return job.tiles_done ? `${job.tiles_done} of ${job.tiles_total} ${unit} are ${does}.`
    : job.phase === "EXECUTING" ? `Its first ${unit} are ${does}.` : "It waits for its turn.";
}

// A button for each file that people ask for, once its report is read.
export function downloads(job, report, get) {
  const files = report ? KINDS[job.kind].files(report) : REPORT;
  return Object.entries(files).map(([name, text]) =>
    el("button", { type: "button", onclick: get(`results/${name}`, name) }, text));
}

// Into `stage` what came out; returns the job's report.
export async function showTables(stage, job, path) {
  const report = await json(`${path}/report`);
  const { card, pictures } = KINDS[job.kind];
  const box = el("div", { class: "card", id: job.kind }, card(report));
  fill(stage, box);
  pictures(report, `${path}/results`).then((found) => box.append(...found)).catch((error) => notice(error.message));
  return report;
}
