// Submit a scene: a form from the schema and the JSON itself, side by side; plan, then submit.
// A sweep or a study, known by its `schema`, is text alone.

import { json, send } from "./api.js";
import { copier, el, fill, notice, number, seconds } from "./dom.js";
import { SceneForm } from "./form.js";
import { Schema, trimmed } from "./schema.js";
import { submitSnippets } from "./snippets.js";
import { TEMPLATES } from "./templates.js";

const DRAFT = "nightglass-draft";
const PLACES = { "nightglass/sweep/1": "/v1/sweeps", "nightglass/study/1": "/v1/studies" };
const isScene = (scene) => !Object.hasOwn(PLACES, scene.schema);
const placeOf = (scene) => (isScene(scene) ? "/v1/jobs" : PLACES[scene.schema]);

export async function submitView(main, begin) {
  fill(main, el("p", { class: "quiet" }, "loading the schema…"));
  const [root, known] = await Promise.all([
    json("/v1/schema/scene"), json("/v1/catalogues").catch(() => ({ catalogues: [] }))]);
  const names = known.catalogues.filter((c) => c.usable).map((c) => c.name);
  const state = { scene: begin || draft() || Object.values(TEMPLATES)[0](names[0]) };
  const text = el("textarea", { id: "json", spellcheck: "false", "aria-label": "the scene as JSON or YAML" });
  const fault = el("p", { class: "mistake", role: "alert" });
  const answer = el("div", { id: "answer", "aria-live": "polite" });
  const form = new SceneForm(new Schema(root), names, () => { write(); fill(answer); });

  const show = (scene) => {
    observer.hidden = !isScene(scene);
    if (isScene(scene)) form.show(scene);
    else fill(form.node, el("p", { class: "quiet", id: "text-alone" }, "The form is of scenes: edit this as text."));
  };
  let turn = 0; // of the texts that are read, the newest counts
  const write = () => {
    turn += 1;
    text.value = JSON.stringify(state.scene, null, 2);
    fault.textContent = "";
    keepDraft(JSON.stringify(state.scene));
  };
  const load = (scene) => {
    state.scene = scene;
    form.mistakes.clear();
    show(scene);
    write();
    fill(answer);
  };
  let reading = null; // YAML takes a moment
  text.addEventListener("input", () => { reading = read(); });
  const read = async () => {
    const mine = ++turn;
    try {
      const scene = isJson(text.value) ? JSON.parse(text.value) : await readYaml(text.value, () => mine === turn);
      if (mine !== turn) return;
      if (scene === null || typeof scene !== "object" || Array.isArray(scene)) throw new Error("a scene is an object {…}");
      state.scene = trimmed(scene);
      form.mistakes.clear();
      show(state.scene);
      fault.textContent = "";
      keepDraft(JSON.stringify(state.scene));
    } catch (error) {
      if (mine === turn) fault.textContent = `not ${isJson(text.value) ? "JSON" : "YAML"} yet: ${error.message}`;
    }
  };

  const refused = (error) => {
    if (isScene(state.scene)) form.mark(error.errors || []);
    fill(answer, el("div", { class: "card bad" }, el("strong", {}, error.message || "refused"),
      el("ul", {}, (error.errors || []).map((e) =>
        el("li", {}, el("code", {}, e.pointer || "scene"), ` is ${e.value}; ${e.allowed}`)))));
  };
  const busy = (button, work) => async () => {
    await reading;
    if (fault.textContent) return notice("the text is not JSON or YAML");
    button.disabled = true;
    button.classList.add("busy");
    try {
      await work();
    } catch (error) {
      refused(error);
    }
    button.disabled = false;
    button.classList.remove("busy");
  };
  const planner = el("button", { type: "button", id: "plan" }, "Plan");
  planner.addEventListener("click", busy(planner, async () => {
    fill(answer, el("p", { class: "quiet" }, "planning…"));
    const scene = state.scene;
    const plan = await send(`${placeOf(scene)}?dry_run=1`, text.value, kindOf(text.value));
    fill(answer, isScene(scene) ? planCard(plan) : forecastCard(plan));
  }));
  const observer = el("button", { type: "button", id: "observe" }, "Observe");
  observer.addEventListener("click", busy(observer, async () => {
    fill(answer, el("p", { class: "quiet" }, "observing…"));
    fill(answer, observedCard(await send("/v1/observe", text.value, kindOf(text.value))));
  }));
  const sender = el("button", { type: "button", id: "submit", class: "strong" }, "Submit");
  let again = crypto.randomUUID(); // a second press after a lost answer makes no second job
  sender.addEventListener("click", busy(sender, async () => {
    const job = await send(placeOf(state.scene), text.value, { "Idempotency-Key": again, ...kindOf(text.value) });
    again = crypto.randomUUID();
    location.hash = `#/job/${job.id}`;
  }));
  const starts = el("select", { "aria-label": "start from" },
    el("option", { value: "" }, "start from…"),
    Object.keys(TEMPLATES).map((name) => el("option", { value: name }, name)));
  starts.addEventListener("change", () => {
    if (starts.value) load(TEMPLATES[starts.value](names[0]));
    starts.value = "";
  });
  const file = el("input", { type: "file", accept: ".json,.yaml,.yml,application/json,application/yaml", class: "sr", id: "file" });
  file.addEventListener("change", async () => {
    if (!file.files.length) return;
    text.value = await file.files[0].text();
    text.dispatchEvent(new Event("input"));
    file.value = "";
  });

  fill(main,
    el("div", { class: "bar" }, el("h1", {}, "New scene"), starts,
      el("label", { class: "button", for: "file" }, "Open file"), file,
      el("span", { class: "spring" }), planner, observer, sender),
    el("div", { class: "split" },
      el("section", { "aria-label": "form" }, form.node),
      el("section", { class: "side", "aria-label": "text and answers" }, answer,
        el("div", { class: "card" }, el("div", { class: "bar" }, el("h2", {}, "The scene as JSON or YAML"),
          el("span", { class: "quiet" }, "edit or paste here"), el("span", { class: "spring" }),
          copier(() => text.value, "the scene")), text, fault),
        submitSnippets())));
  load(state.scene);
}

// The text for when the page is opened again; none where it is too large for the browser.
export function keepDraft(text) {
  try {
    sessionStorage.setItem(DRAFT, text);
  } catch {
    sessionStorage.removeItem(DRAFT);
  }
}

const isJson = (text) => /^\s*([{[]|$)/.test(text);
const kindOf = (text) => ({ "Content-Type": isJson(text) ? "application/json" : "application/yaml" });

// YAML is read by the service, once its writer rests.
async function readYaml(text, current) {
  await new Promise((go) => setTimeout(go, 400));
  return current() ? (await send("/v1/schema/scene/read", text, kindOf(text))).scene : null;
}

function draft() {
  try {
    return JSON.parse(sessionStorage.getItem(DRAFT));
  } catch {
    return null;
  }
}

// What is seen of each target at each exposure, or why it is not; the best seen first.
const SHOWN = 200;
function observedCard({ counts, notes, rows }) {
  const best = [...rows].sort((a, b) => (b.seen === "yes") - (a.seen === "yes") || b.snr - a.snr);
  const angle = (v) => (v === null ? "–" : v.toFixed(2));
  const cells = (r) => [r.object_name, r.utc.slice(11, 19), r.seen, angle(r.ra_deg), angle(r.dec_deg),
    angle(r.azimuth_deg), angle(r.elevation_deg), number(r.range_m / 1e3, 4), number(r.rate_arcsec_s, 3),
    angle(r.v_mag), number(r.snr, 3)];
  const heads = ["target", "UTC", "seen", "RA °", "Dec °", "az °", "el °", "km", "″/s", "V", "SNR"];
  return el("div", { class: "card", id: "observed" }, el("h2", {}, "Observed"),
    el("p", {}, Object.entries(counts).map(([why, n]) => `${n} ${why === "yes" ? "seen" : why}`).join(", ")),
    el("div", { class: "scroll" }, el("table", {},
      el("thead", {}, el("tr", {}, heads.map((h) => el("th", {}, h)))),
      el("tbody", {}, best.slice(0, SHOWN).map((r) => el("tr", {}, cells(r).map((c) => el("td", {}, String(c)))))))),
    rows.length > SHOWN ? el("p", { class: "quiet" }, `the best ${SHOWN} of ${rows.length} rows`) : null,
    remarks(notes));
}

// What a scene needs, and each decision with its bound.
export function planCard(plan) {
  const p = plan.predicted || {};
  const facts = [
    ["frames", `${plan.frames} of ${plan.shape.join(" × ")} px`],
    ["field", `${plan.field_deg.map((v) => number(v, 3)).join(" × ")}°, ${number(plan.ifov_arcsec, 3)}″ a pixel`],
    ["stars a frame", `about ${plan.stars_per_frame}`],
    ["tiles", `${plan.tiles} of ${plan.tile_shape.join(" × ")} px`],
    ["noise floor", `${number(plan.noise_floor_e, 3)} e⁻ (sky ${number(plan.background_e, 3)} e⁻)`],
    ["predicted", `${seconds(p.cpu_s || 0)} of one core, ${number(p.worker_memory_mb, 3)} MB a worker, `
      + `product ${number(p.product_mb, 3)} MB before compression`],
  ];
  return el("div", { class: "card", id: "planned" }, el("h2", {}, "Plan"),
    warnings(plan.warnings),
    el("dl", { class: "facts" }, facts.map(([k, v]) => [el("dt", {}, k), el("dd", {}, v)])),
    decisions(plan.decisions), remarks(plan.remarks));
}

// What a study takes, or a sweep: its points, and the plan of its base scene.
function forecastCard({ base, remarks: told, ...sizes }) {
  const facts = Object.entries(sizes).map(([key, value]) => [el("dt", {}, key.replaceAll("_", " ")), el("dd", {}, number(value))]);
  return [el("div", { class: "card", id: "forecast" }, el("h2", {}, "Forecast"), el("dl", { class: "facts" }, facts), remarks(told)),
    base ? planCard(base) : null];
}

export function decisions(list = []) {
  return el("details", {}, el("summary", {}, `${list.length} decisions, each with its bound`),
    el("div", { class: "scroll" }, el("table", {},
      el("thead", {}, el("tr", {}, ["component", "", "error at most", "reason"].map((h) => el("th", {}, h)))),
      el("tbody", {}, list.map((d) => el("tr", {},
        el("td", {}, String(d.component).replaceAll("_", " ")),
        el("td", {}, el("span", { class: d.kept ? "chip on" : "chip" }, d.kept ? "in" : "omitted")),
        el("td", { class: "num" }, d.error_bound_e ? `${number(d.error_bound_e, 2)} e⁻` : "–"),
        el("td", {}, d.reason)))))));
}

// What is wrong in the product though the scene accepts it: before everything else.
export function warnings(list = []) {
  return list.map((w) => el("p", { class: "warning", role: "alert" }, `Warning: ${w}`));
}

function remarks(list = []) {
  return list.length ? el("ul", { class: "quiet" }, list.map((r) => el("li", {}, r))) : null;
}
