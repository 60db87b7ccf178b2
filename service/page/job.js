// One job: its progress, its frames with truth and coordinates, its report and plan.

import { ask, download, ended, follow, json } from "./api.js";
import { amount, el, fill, hiddenBy, notice, number, seconds } from "./dom.js";
import { jobSnippets } from "./snippets.js";
import { trimmed } from "./schema.js";
import { KINDS } from "./stretch.js";
import { decisions, keepDraft, warnings } from "./submit.js";
import { downloads, hasFrames, showTables, unitOf, waiting } from "./tables.js";
import { Viewer } from "./viewer.js";
import { Wcs, dms, hms } from "./wcs.js";

export class JobView {
  constructor(main, id, changed) {
    this.main = main;
    this.path = `/v1/jobs/${id}`;
    this.changed = changed;
    this.abort = new AbortController();
    this.asked = null; // frame chosen by hand
  }

  async open() {
    fill(this.main, el("p", { class: "quiet" }, "loading…"));
    this.job = await json(this.path, { signal: this.abort.signal });
    this.layOut();
    this.told(this.job);
    this.clock = setInterval(() => { if (!ended(this.job)) this.time(); }, 1000);
    if (!ended(this.job)) follow(this.path, (job) => this.told(job), this.abort.signal);
  }

  close() {
    this.abort.abort();
    clearInterval(this.clock);
    this.viewer?.close();
  }

  layOut() {
    this.head = el("div", { class: "jobhead" });
    this.stage = el("div", { class: "stage" });
    this.more = el("div", { class: "more" });
    fill(this.main, this.head, this.stage, this.more);
  }

  async told(job) {
    const before = this.job;
    this.job = job;
    this.changed(job);
    this.heading();
    if (!hasFrames(job)) {
      if (!ended(job)) fill(this.stage, el("div", { class: "empty" }, waiting(job)));
      else if (job.error) fill(this.stage, errorCard(job.error));
      else if (job.phase === "COMPLETED") {
        try {
          this.made = await showTables(this.stage, job, this.path);
          this.heading();
        } catch (error) {
          fill(this.stage, el("div", { class: "card bad" }, el("p", {}, error.message)));
        }
      } else fill(this.stage, el("div", { class: "empty" }, "It was stopped."));
      return;
    }
    if (!ended(job) && !this.viewer) {
      const text = job.phase === "EXECUTING" ? "The scene is planned and its stars are read; tiles follow."
        : "It waits for its turn; the frame appears here tile by tile.";
      fill(this.stage, el("div", { class: "empty" }, text));
    } else if (job.phase === "ABORTED" && !this.viewer) {
      fill(this.stage, el("div", { class: "empty" }, "It was stopped before anything was drawn."));
    } else if (job.error) {
      fill(this.stage, errorCard(job.error));
    }
    const new_ = !this.viewer || before.tiles_done !== job.tiles_done || before.phase !== job.phase;
    if (new_ && (job.tiles_done || job.phase === "COMPLETED")) await this.refresh();
    if (job.phase === "COMPLETED" && !this.reported) {
      this.reported = true;
      this.report();
    }
  }

  // Its buttons stay while tiles are counted: one that is replaced loses the click and the focus.
  heading() {
    const job = this.job, state = [job.phase, job.cancel_asked, Boolean(this.made)].join();
    if (state !== this.headed) {
      this.headed = state;
      this.spent = el("span", { class: "quiet num" });
      this.bar = el("progress", { max: "1", "aria-label": "tiles done" });
      fill(this.head,
        el("div", { class: "bar" }, el("h1", {}, job.name),
          el("span", { class: `phase ${job.phase}` }, job.phase.toLowerCase()),
          this.spent,
          el("span", { class: "spring" }), this.actions()),
        ended(job) ? null : this.bar);
    }
    this.time();
    if (job.tiles_total) this.bar.value = job.tiles_done / job.tiles_total;
    else if (job.phase !== "EXECUTING") this.bar.value = 0;
  }

  // How far it is and how long that took; told anew every second.
  time() {
    const job = this.job, share = job.tiles_total ? job.tiles_done / job.tiles_total : 0;
    const began = Date.parse(job.started || job.submitted);
    const spent = Math.max(0, ((job.ended ? Date.parse(job.ended) : Date.now()) - began) / 1000);
    const left = share > 0.02 && share < 1 && !ended(job)
      ? `about ${seconds(spent / share - spent)} to go` : "";
    fill(this.spent, [job.tiles_total ?
      `${job.tiles_done ?? 0} of ${job.tiles_total} ${unitOf(job)}` : "",
      job.started ? seconds(spent) : "", left,
      job.attempt > 1 ? `attempt ${job.attempt}` : "",
      ended(job) && job.bytes_kept ? `${amount(job.bytes_kept)} kept` : ""].filter(Boolean).join(", "));
  }

  actions() {
    const job = this.job, get = (path, name) => () =>
      download(`${this.path}/${path}`, this.named(name)).catch((error) => notice(error.message));
    if (job.phase === "COMPLETED") {
      const menu = el("details", { class: "menu" }, el("summary", { class: "button strong" }, "Download"),
        el("div", {}, !hasFrames(job) ? downloads(job, this.made, get) : [
          el("button", { type: "button", onclick: get("product.tar", "product.tar") }, "product, .tar"),
          el("button", { type: "button", onclick: () => {
            const frame = this.viewer?.frame ?? 0, layer = this.viewer?.layer ?? "dn";
            get(`frames/${frame}/fits?layer=${layer}`, `${layer}-${frame}.fits`)();
          } }, "this frame, FITS"),
          el("button", { type: "button", onclick: get("results/truth/targets.parquet", "targets.parquet") }, "targets' truth, Parquet"),
          el("button", { type: "button", onclick: get("report", "report.json") }, "report, JSON")],
          el("button", { type: "button", onclick: () => this.files().catch((error) => notice(error.message)) }, "all files")));
      return [menu, this.again(), this.remover()];
    }
    if (ended(job)) return [this.again(), this.remover()];
    return el("button", { type: "button", disabled: job.cancel_asked, onclick: async () => {
      try {
        this.told(await json(`${this.path}/cancel`, { method: "POST" }));
      } catch (error) {
        notice(error.message);
      }
    } }, job.cancel_asked ? "stopping…" : "Cancel");
  }

  // A file's name on the disk of who downloads it: the job's, and what it is.
  named(name) {
    return `${this.job.name.slice(0, 60)}-${this.job.id.slice(0, 8)}-${name.replaceAll("/", "-")}`;
  }

  // Every file of the product, each to be downloaded; those of the cube only as a whole (.tar).
  async files() {
    const found = new Map(), cube = "cube.zarr";
    for (const query of ["limit=100", `limit=1000&after=${cube}0`]) {
      for (const file of (await json(`${this.path}/results?${query}`)).files) {
        if (!file.path.startsWith(`${cube}/`)) found.set(file.path, file);
      }
    }
    const row = ({ path, bytes, href }) => el("tr", { "data-file": path },
      el("td", {}, el("button", { type: "button", onclick: () => download(href, this.named(path))
        .catch((error) => notice(error.message)) }, path)), el("td", { class: "num" }, amount(bytes)));
    this.list?.remove();
    this.list = el("div", { class: "card", id: "files" }, el("h2", {}, "Files"),
      el("p", { class: "quiet" }, `without those of ${cube}, which the product as .tar holds`),
      el("div", { class: "scroll" }, el("table", {}, el("tbody", {}, [...found.values()].map(row)))));
    this.more.prepend(this.list);
    this.list.scrollIntoView();
  }

  again() {
    if (!hasFrames(this.job)) return null; // the form is of scenes
    return el("button", { type: "button", title: "a new scene that starts as this one", onclick: async () => {
      try {
        keepDraft(JSON.stringify(trimmed(await json(`${this.path}/scene`))));
        location.hash = "#/new";
      } catch (error) {
        notice(error.message);
      }
    } }, "Edit as new");
  }

  remover() {
    return el("button", { type: "button", class: "danger", onclick: async () => {
      if (!confirm(`Delete the job “${this.job.name}” and its product?`)) return;
      try {
        await ask(this.path, { method: "DELETE" });
        location.hash = "#/";
      } catch (error) {
        notice(error.message);
      }
    } }, "Delete");
  }

  // The frames as far as they are drawn.
  async refresh() {
    if (this.refreshing) { this.stale = true; return; }
    this.refreshing = true;
    try {
      const about = await json(`${this.path}/frames`, { signal: this.abort.signal });
      if (!this.viewer) this.viewerUp(about);
      else this.viewer.describe(about);
      await this.show(this.asked ?? (about.complete ? this.viewer.frame : about.watch));
    } catch (error) {
      if (error.name !== "AbortError" && error.status !== 409) notice(error.message);
    }
    this.refreshing = false;
    if (this.stale) {
      this.stale = false;
      this.refresh();
    }
  }

  async show(frame, layer = this.viewer.layer) {
    const view = this.viewer, about = view.about;
    if (frame !== view.frame || layer !== view.layer) view.show(frame, layer);
    this.slider.value = frame;
    this.slider.max = about.frames - 1;
    fill(this.frameNo, `${frame + 1} of ${about.frames}`);
    const facts = await json(`${this.path}/frames/${frame}`, { signal: this.abort.signal });
    if (view.frame !== frame) return;
    view.has(facts.drawn);
    fill(this.when, facts.times ? `${facts.times.mid.slice(0, 23)} UTC` : "");
    view.wcs = facts.wcs ? new Wcs(facts.wcs) : null;
    this.residual = facts.wcs_residual_px;
    if (about.complete && !view.truth) {
      view.truth = await json(`${this.path}/frames/${frame}/truth`, { signal: this.abort.signal });
      this.targets();
    }
    view.paint();
  }

  pick(frame, layer) {
    const last = this.viewer.about.frames - 1;
    this.asked = Math.max(0, Math.min(last, frame));
    this.show(this.asked, layer).catch((error) => { if (error.name !== "AbortError") notice(error.message); });
  }

  viewerUp(about) {
    const canvas = el("canvas", { class: "sky", tabindex: "0", "aria-label": "the frame" });
    const view = this.viewer = new Viewer(canvas, this.path, about);
    this.slider = el("input", { type: "range", min: "0", max: String(about.frames - 1), value: "0",
      "aria-label": "frame", oninput: (event) => this.pick(Number(event.target.value)) });
    this.frameNo = el("span", { class: "num" });
    this.when = el("span", { class: "num quiet" });
    this.readout = el("div", { class: "readout num", "aria-live": "off" });
    this.table = el("div", { class: "scroll" });
    const layers = el("select", { "aria-label": "layer" }, Object.entries(about.layers).map(
      ([name, l]) => el("option", { value: name, title: l.long_name }, `${name} (${l.units})`)));
    layers.addEventListener("change", () => this.pick(view.frame, layers.value));
    const zoom = el("span", { class: "num quiet zoomed" });
    view.addEventListener("view", () => fill(zoom, `${number(100 * view.scale, 3)} %`));
    view.addEventListener("pointer", (event) => this.read(event.detail));
    view.addEventListener("fault", (event) => notice(event.detail.message));
    view.addEventListener("stretch", () => this.cuts());
    fill(this.stage, el("div", { class: "viewer" },
      el("div", { class: "picture" }, el("div", { class: "glass" }, canvas), this.readout,
        el("div", { class: "tools" },
          button("−", "zoom out", () => view.zoom(view.scale / 1.5)),
          button("+", "zoom in", () => view.zoom(view.scale * 1.5)),
          button("fit", "whole frame", () => view.fit()),
          button("1:1", "one pixel to one pixel", () => view.zoom(1)), zoom)),
      el("div", { class: "panel" },
        el("div", { class: "card" }, el("h2", {}, "Frame"),
          el("div", { class: "bar" }, button("‹", "previous frame", () => this.pick(view.frame - 1)),
            this.slider, button("›", "next frame", () => this.pick(view.frame + 1)), this.frameNo),
          this.when, el("label", { class: "line" }, "layer", layers)),
        this.stretchCard(), this.truthCard())));
    view.resize();
    this.read(null);
  }

  stretchCard() {
    const view = this.viewer, stretch = view.stretch;
    this.kinds = el("select", { "aria-label": "stretch" }, KINDS.map((k) => el("option", { value: k }, k)));
    const apply = (values) => { stretch.set(values); this.cuts(); view.paint(); };
    this.kinds.addEventListener("change", () => apply({ kind: this.kinds.value }));
    this.inverted = el("input", { type: "checkbox", onchange: (event) => apply({ invert: event.target.checked }) });
    this.chart = el("canvas", { class: "chart", width: "320", height: "56", "aria-hidden": "true" });
    const near = (event) => {
      const box = this.chart.getBoundingClientRect(), [from, to] = stretch.range;
      const value = from + (event.clientX - box.left) / box.width * (to - from);
      const low = Math.abs(value - stretch.low) < Math.abs(value - stretch.high);
      apply(low ? { low: Math.min(value, stretch.high) } : { high: Math.max(value, stretch.low) });
    };
    this.chart.addEventListener("pointerdown", (event) => { this.chart.setPointerCapture(event.pointerId); near(event); });
    this.chart.addEventListener("pointermove", (event) => { if (event.buttons) near(event); });
    const cut = (name) => el("input", { class: "number", inputmode: "decimal", "aria-label": `${name} cut`,
      onchange: (event) => { const v = Number(event.target.value); if (Number.isFinite(v)) apply({ [name]: v }); } });
    this.low = cut("low");
    this.high = cut("high");
    return el("div", { class: "card" }, el("h2", {}, "Stretch"), this.chart,
      el("div", { class: "bar" }, this.low, this.high, button("auto", "measure the cuts anew", () => view.auto())),
      el("div", { class: "bar" }, this.kinds, el("label", {}, this.inverted, "black on white")));
  }

  cuts() {
    const stretch = this.viewer.stretch;
    this.low.value = number(stretch.low, 5);
    this.high.value = number(stretch.high, 5);
    this.kinds.value = stretch.kind;
    this.inverted.checked = stretch.invert;
    stretch.chart(this.chart);
  }

  truthCard() {
    const view = this.viewer, box = (name, text) => {
      const input = el("input", { type: "checkbox", checked: view.overlay[name], id: `show-${name}`,
        onchange: (event) => { view.overlay[name] = event.target.checked; view.paint(); } });
      return el("label", {}, input, text);
    };
    return el("div", { class: "card" }, el("h2", {}, "Truth"),
      el("div", { class: "bar" }, box("targets", "targets"), box("names", "names"), box("stars", "stars")),
      this.table);
  }

  targets() {
    const view = this.viewer, truth = view.truth;
    const rows = truth.targets.map((t) => el("tr", { tabindex: "0", "data-target": t.name,
      onclick: () => mark(t), onkeydown: (event) => { if (event.key === "Enter") mark(t); } },
    el("td", {}, t.name, hiddenBy(t) ? el("span", { class: "quiet" }, ` behind the ${hiddenBy(t)}`) : null),
    el("td", { class: "num" }, number(t.snr, 3)),
    el("td", { class: "num" }, number(t.electrons, 3)), el("td", { class: "num" }, number(t.range_m / 1000, 5))));
    const mark = (t) => { view.marked = t; view.go(t.x_px, t.y_px, 4); };
    fill(this.table, rows.length ? el("table", { class: "pick" },
      el("thead", {}, el("tr", {}, ["target", "SNR", "e⁻", "km"].map((h) => el("th", {}, h)))),
      el("tbody", {}, rows)) : el("p", { class: "quiet" }, "no target in this frame"),
    el("p", { class: "quiet" }, `${truth.stars_in_frame} stars in the frame`
      + (truth.stars_hidden ? `, ${truth.stars_hidden} more are hidden` : "")
      + (truth.stars.length < truth.stars_in_frame ? `, the brightest ${truth.stars.length} can be marked` : "")));
  }

  read(at) {
    const view = this.viewer, parts = [];
    if (!at) {
      if (view.wcs) parts.push(el("span", {}, `${number(view.wcs.scale(), 4)}″ a pixel, coordinates to ${number(this.residual, 2)} px`));
    } else {
      const found = view.value(...at);
      parts.push(el("span", {}, `x ${at[0].toFixed(2)}  y ${at[1].toFixed(2)}`));
      if (found) {
        const unit = view.about.layers[view.layer].units;
        parts.push(el("span", {}, `${found.bin > 1 ? "≈ " : ""}${number(found.value, 6)} ${unit}`));
      }
      if (view.wcs) {
        const [ra, dec] = view.wcs.world(...at);
        parts.push(el("span", { id: "radec", "data-ra": ra.toFixed(7), "data-dec": dec.toFixed(7) },
          `${hms(ra)} ${dms(dec)}`), el("span", { class: "quiet" }, `${ra.toFixed(5)}° ${dec.toFixed(5)}°`));
      }
      const near = this.near(at);
      if (near) parts.push(el("span", { class: "near" }, near));
    }
    fill(this.readout, parts);
  }

  near([x, y]) {
    const view = this.viewer, reach = 14 * (window.devicePixelRatio || 1) / view.scale;
    if (!view.truth) return "";
    const lists = [[view.truth.targets, view.overlay.targets], [view.truth.stars, view.overlay.stars]];
    let best = null, distance = reach;
    for (const [list, on] of lists) {
      for (const t of on ? list : []) {
        const d = Math.hypot(t.x_px - x, t.y_px - y);
        if (d < distance) { best = t; distance = d; }
      }
    }
    if (!best) return "";
    const light = hiddenBy(best) ? `behind the ${hiddenBy(best)}`
      : `${number(best.electrons, 3)} e⁻, SNR ${number(best.snr, 3)}`;
    return best.name ? `${best.name}: ${light}` : `G ${number(best.g_mag, 4)}: ${light}`;
  }

  async report() {
    const [report, plan] = await Promise.all([json(`${this.path}/report`), json(`${this.path}/plan`)])
      .catch(() => [null, null]);
    if (!report) return;
    const e = report.errors, s = report.seconds;
    const facts = [
      ["error found by drawing again", e.achieved_error_sigma === null || e.achieved_error_sigma === undefined
        ? "not checked" : `${number(e.achieved_error_sigma, 2)} σ in ${e.windows} windows`
          + (e.windows_skipped ? `, ${e.windows_skipped} more take too long` : "")],
      ["bound of all approximations", `${number(e.bound_of_all_approximations_sigma, 2)} σ (asked ${e.asked_sigma})`],
      ["coordinates", `good to ${number(e.wcs_residual_px, 2)} px`],
      ["noise floor", `${number(e.noise_floor_e, 3)} e⁻`],
      ["time", `plan ${seconds(s.plan_s)}, draw ${seconds(s.draw_s)}, finish ${seconds(s.finish_s)}`],
      ["content", el("code", {}, report.content_digest.slice(0, 16))],
    ];
    fill(this.more, el("div", { class: "columns" },
      el("div", { class: "card" }, el("h2", {}, "Report"), warnings(report.warnings),
        el("dl", { class: "facts" }, facts.map(([k, v]) => [el("dt", {}, k), el("dd", {}, v)])),
        el("ul", { class: "quiet" }, report.remarks.map((r) => el("li", {}, r))), decisions(plan.decisions)),
      jobSnippets(this.job)));
  }

  // A key pressed anywhere outside of fields; true where it meant something here.
  key(event) {
    const view = this.viewer;
    if (!view) return false;
    const step = 60 * (window.devicePixelRatio || 1);
    const toggle = (name) => {
      view.overlay[name] = !view.overlay[name];
      const box = document.getElementById(`show-${name}`);
      if (box) box.checked = view.overlay[name];
      view.paint();
    };
    const does = {
      "+": () => view.zoom(view.scale * 1.5), "=": () => view.zoom(view.scale * 1.5),
      "-": () => view.zoom(view.scale / 1.5), "0": () => view.fit(), "1": () => view.zoom(1),
      ",": () => this.pick(view.frame - 1), ".": () => this.pick(view.frame + 1),
      ArrowLeft: () => view.move(step, 0), ArrowRight: () => view.move(-step, 0),
      ArrowUp: () => view.move(0, step), ArrowDown: () => view.move(0, -step),
      t: () => toggle("targets"), l: () => toggle("names"), b: () => toggle("stars"),
      i: () => { view.stretch.set({ invert: !view.stretch.invert }); this.cuts(); view.paint(); },
      s: () => {
        const next = KINDS[(KINDS.indexOf(view.stretch.kind) + 1) % KINDS.length];
        view.stretch.set({ kind: next });
        this.cuts();
        view.paint();
      },
    }[event.key];
    if (does) does();
    return Boolean(does);
  }
}

const button = (text, title, onclick) => el("button", { type: "button", title, "aria-label": title, onclick }, text);

function errorCard(error) {
  return el("div", { class: "card bad" }, el("h2", {}, "It ended with an error"),
    el("p", {}, error.message), el("ul", {}, (error.errors || []).map((e) =>
      el("li", {}, el("code", {}, e.pointer), ` is ${e.value}; ${e.allowed}`))));
}
