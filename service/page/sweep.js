// A sweep: it has no frames; at the end its failures and the spread of what was measured.

import { download, json } from "./api.js";
import { el, fill, notice, number, seconds } from "./dom.js";

export const waiting = (job) => (job.tiles_done
  ? `${job.tiles_done} of ${job.tiles_total} points are rendered and measured.`
  : job.phase === "EXECUTING" ? "Its first points are rendered and measured." : "It waits for its turn.");

const FILES = { "points.parquet": "table of points, Parquet", "summary.html": "summary, a page",
  "report.json": "report, JSON", "sweep.json": "the sweep, JSON" };

export function downloads(path, named) {
  const get = (name) => () => download(`${path}/results/${name}`, named(name)).catch((error) => notice(error.message));
  return Object.entries(FILES).map(([name, text]) => el("button", { type: "button", onclick: get(name) }, text));
}

// Into `stage` the spread of each metric, from the sweep's report.
export async function showSweep(stage, path) {
  const report = await json(`${path}/report`);
  const row = ([name, s]) => el("tr", { "data-metric": name }, el("td", {}, el("code", {}, name)),
    [s.known, s.least, s.mean, s.largest].map((value) => el("td", { class: "num" }, number(value))));
  const faults = Object.entries(report.messages).map(([text, n]) => el("li", {}, `${n} × `, el("code", {}, text)));
  fill(stage, el("div", { class: "card", id: "sweep" },
    el("p", {}, `${report.points} points over ${report.axes.join(", ")}: ${report.failed} failed, ${seconds(report.seconds)}.`),
    el("div", { class: "scroll" }, el("table", {},
      el("thead", {}, el("tr", {}, ["metric", "known", "least", "mean", "largest"].map((h) => el("th", {}, h)))),
      el("tbody", {}, Object.entries(report.metrics).map(row)))),
    faults.length ? [el("h2", {}, "Failures"), el("ul", {}, faults)] : null));
}
