// The page: the queue on the left, one job or a new scene on the right, keys, theme.

import { ended, json, picture, useKey } from "./api.js";
import { countsOf, el, fill, moreOf, notice } from "./dom.js";
import { JobView } from "./job.js";
import { submitView } from "./submit.js";

const main = document.getElementById("main"), queue = document.getElementById("queue");
const jobs = new Map(), rows = new Map();
const POLL_MS = 2500, SHOWN = 200;
let view = null, shown = "", lost = false, totals = {}, turns = 0;

async function route() {
  const [, kind, id] = location.hash.split("/"), turn = ++turns;
  const place = el("div"); // what is asked for late, for a view that was left, is not shown
  main.replaceChildren(place);
  view?.close?.();
  view = null;
  shown = kind === "job" ? id : "";
  markShown();
  try {
    if (kind === "job") {
      view = new JobView(place, id, noted);
      await view.open();
    } else if (kind === "new" || !jobs.size) {
      await submitView(place);
    } else {
      location.replace(`#/job/${newest()[0].id}`);
      return;
    }
  } catch (error) {
    if (error.name !== "AbortError" && turn === turns) failed(error);
  }
}

function failed(error) {
  const unknown = error.status === 401 || error.status === 403;
  fill(main, el("div", { class: "card bad" }, el("h2", {}, unknown ? "A key is needed" : "That did not work"),
    el("p", {}, error.message),
    unknown ? el("button", { type: "button", class: "strong", onclick: askKey }, "Give a key") : null));
}

const newest = () => [...jobs.values()].sort((a, b) => b.submitted.localeCompare(a.submitted));

// A job is known anew; its row changes, or is made.
function noted(job) {
  const before = jobs.get(job.id);
  jobs.set(job.id, job);
  if (!before || JSON.stringify(before) !== JSON.stringify(job)) drawRow(job);
  if (!before) order();
}

function drawRow(job) {
  let row = rows.get(job.id);
  if (!row) {
    row = el("li", {}, el("a", { href: `#/job/${job.id}` }));
    rows.set(job.id, row);
  }
  const link = row.firstChild;
  link.dataset.words = `${job.name} ${job.phase}`.toLowerCase();
  const bar = el("progress", { max: "1" });
  if (job.tiles_total) bar.value = job.tiles_done / job.tiles_total;
  const thumb = link.querySelector("img") || el("img", { alt: "", hidden: true, width: "44", height: "44" });
  if (job.links.preview && !thumb.src) {
    picture(job.links.preview).then((src) => { thumb.src = src; thumb.hidden = false; }, () => {});
  }
  const time = job.submitted.slice(0, 10) === new Date().toISOString().slice(0, 10)
    ? `${job.submitted.slice(11, 19)} UTC` : job.submitted.slice(0, 10);
  fill(link, el("span", { class: "thumb" }, thumb), el("span", { class: "what" },
    el("span", { class: "name" }, job.name),
    el("span", { class: "quiet" }, el("span", { class: `phase ${job.phase}` }, job.phase.toLowerCase()), ` ${time}`),
    job.phase === "EXECUTING" ? bar : null));
  if (job.id === shown) link.setAttribute("aria-current", "page");
}

function order() {
  queue.replaceChildren(...newest().map((job) => rows.get(job.id)));
  filter();
}

function markShown() {
  for (const [id, row] of rows) {
    if (id === shown) row.firstChild.setAttribute("aria-current", "page");
    else row.firstChild.removeAttribute("aria-current");
  }
}

function filter() {
  const wanted = document.getElementById("filter").value.trim().toLowerCase();
  for (const row of rows.values()) row.hidden = !row.firstChild.dataset.words.includes(wanted);
}

function counts() {
  document.getElementById("counts").textContent = countsOf(totals);
  document.getElementById("more").textContent = moreOf(totals, SHOWN);
}

// The newest jobs and all that run, as the list shows them; the counts are those of all jobs.
async function poll() {
  const ready = document.getElementById("ready");
  try {
    const [found, usage] = await Promise.all([listed(), json("/v1/usage")]);
    totals = usage.jobs;
    for (const id of [...jobs.keys()]) {
      if (!found.has(id)) {
        jobs.delete(id);
        rows.get(id)?.remove();
        rows.delete(id);
      }
    }
    for (const job of found.values()) noted(job);
    counts();
    if (!jobs.size) fill(queue, el("li", { class: "quiet none" }, "no jobs yet"));
    else queue.querySelector(".none")?.remove();
    ready.textContent = "";
    ready.className = "ready up";
    ready.title = "the service answers";
    lost = false;
  } catch (error) {
    ready.className = "ready down";
    const unknown = error.status === 401 || error.status === 403;
    ready.textContent = unknown ? "a key is needed" : error.status ? error.message : "no answer from the service";
    if (unknown && !lost) askKey();
    lost = true;
  }
}

async function listed() {
  const paths = [`/v1/queue?limit=${SHOWN}`, "/v1/jobs?phase=EXECUTING&limit=1000"];
  const lists = await Promise.all(paths.map((path) => json(path)));
  return new Map(lists.flatMap(({ jobs: list }) => list).map((job) => [job.id, job]));
}

function askKey() {
  const box = document.getElementById("keyform");
  if (!box.open) box.showModal();
}

document.getElementById("keyform").addEventListener("close", (event) => {
  const field = document.getElementById("keyvalue"), how = event.target.returnValue;
  if (how === "set" || how === "drop") {
    useKey(how === "set" ? field.value : "");
    field.value = "";
    lost = true;
    poll().then(route);
  }
});
document.getElementById("key").addEventListener("click", askKey);
document.getElementById("help").addEventListener("click", () => document.getElementById("keys").showModal());
document.getElementById("filter").addEventListener("input", filter);

const THEMES = ["auto", "dark", "light"];
function theme(name) {
  document.documentElement.dataset.theme = name;
  document.getElementById("theme").textContent = { auto: "◐", dark: "☾", light: "☀" }[name];
  localStorage.setItem("nightglass-theme", name);
}
document.getElementById("theme").addEventListener("click", () => {
  const now = document.documentElement.dataset.theme;
  theme(THEMES[(THEMES.indexOf(now) + 1) % THEMES.length]);
});
theme(localStorage.getItem("nightglass-theme") || "auto");

function step(by) {
  const all = newest().filter((job) => !rows.get(job.id).hidden);
  const at = all.findIndex((job) => job.id === shown);
  const next = all[Math.max(0, Math.min(all.length - 1, at + by))];
  if (next) location.hash = `#/job/${next.id}`;
}

document.addEventListener("keydown", (event) => {
  const field = event.target.closest("input, textarea, select, dialog");
  if (field || event.ctrlKey || event.metaKey || event.altKey) return;
  const does = {
    n: () => { location.hash = "#/new"; }, j: () => step(1), k: () => step(-1),
    "?": () => document.getElementById("keys").showModal(),
  }[event.key];
  if (does) does();
  else if (!view?.key?.(event)) return;
  event.preventDefault();
});

window.addEventListener("hashchange", route);
await poll();
route();
(async () => {
  for (;;) {
    const running = [...jobs.values()].some((job) => !ended(job));
    await new Promise((go) => setTimeout(go, running && !document.hidden ? POLL_MS : 2 * POLL_MS));
    await poll();
  }
})().catch((error) => notice(error.message));
