// A form made from the scene's JSON Schema: what is set and required, the rest by "add".

import { el, fill } from "./dom.js";
import { label, limits, variantKey } from "./schema.js";

const NOT_HERE = new Set(["schema"]);
const OPEN = new Set(["/exposure", "/pointing", "/targets", "/stars", "/background", "/sensor"]);

export class SceneForm {
  // changed() is called after every edit; catalogues are the names that may be chosen.
  constructor(schema, catalogues, changed) {
    this.schema = schema;
    this.catalogues = catalogues;
    this.changed = changed;
    this.node = el("div", { class: "form" });
    this.closed = new Map();
    this.mistakes = new Map();
  }

  show(scene) {
    this.scene = scene;
    this.ids = 0;
    try {
      fill(this.node, this.group(this.schema.root, scene, "", true));
    } catch { // a list or number stands where an object belongs
      fill(this.node, el("p", { class: "quiet" }, "The form cannot show this scene: edit it as text."));
    }
  }

  // Mistakes of the server's answer, [{ pointer, allowed }], shown beside their fields.
  mark(errors) {
    this.mistakes = new Map(errors.map((e) => [e.pointer, e.allowed]));
    this.show(this.scene);
    this.node.querySelector(".wrong")?.scrollIntoView({ block: "center" });
  }

  edit(change) {
    change();
    this.mistakes.clear();
    this.changed();
  }

  reshape(change) {
    this.edit(change);
    const at = document.activeElement?.id;
    this.show(this.scene);
    if (at) document.getElementById(at)?.focus();
  }

  // The fields of an object: those it has or needs, and a list of those it may get.
  group(node, value, path, top = false) {
    const properties = Object.entries(node.properties || {}).filter(([key]) => !NOT_HERE.has(key));
    const variant = variantKey(node), required = new Set(node.required || []);
    const has = ([key]) => key !== variant && (key in value || required.has(key));
    const shown = properties.filter(has);
    const plain = shown.filter(([key, one]) => !this.isBlock(one, value[key]));
    const blocks = shown.filter(([key, one]) => this.isBlock(one, value[key]));
    const more = properties.filter((entry) => entry[0] !== variant && !has(entry));
    return [
      el("div", { class: top ? "fields top" : "fields" },
        plain.map(([key, one]) => this.field(one, value, key, path, required.has(key)))),
      blocks.map(([key, one]) => this.block(one, value, key, path, required.has(key))),
      more.length ? this.adder(more, value) : null,
    ];
  }

  isBlock(node, value) {
    const form = this.schema.formOf(node, value).node;
    return form.type === "object" || (form.type === "array" && !isRow(form, value));
  }

  adder(more, value) {
    const list = el("select", { class: "adder", "aria-label": "add a field" },
      el("option", { value: "" }, "add…"),
      more.map(([key, one]) => {
        const told = this.schema.resolve(one).description?.split("\n")[0];
        return el("option", { value: key, title: told }, label(key)[0]);
      }));
    list.addEventListener("change", () => {
      const [key, one] = more.find(([name]) => name === list.value);
      this.reshape(() => { value[key] = this.start(one); });
    });
    return list;
  }

  start(node) {
    const made = this.schema.blank(node);
    if (Array.isArray(made) && !made.length) {
      const form = this.schema.formOf(node, made).node;
      if (form.items) made.push(this.schema.blank(form.items));
    }
    return made;
  }

  block(node, holder, key, path, required) {
    const where = `${path}/${key}`, form = this.schema.formOf(node, holder[key]).node;
    if (holder[key] === undefined || holder[key] === null) holder[key] = this.schema.blank(node);
    const inner = form.type === "array"
      ? this.list(form, holder[key], where)
      : this.group(form, holder[key], where);
    const box = el("details", { class: "block", "data-path": where },
      el("summary", {}, label(key)[0],
        form.description ? el("span", { class: "quiet" }, form.description.split("\n")[0]) : null,
        el("span", { class: "spring" }),
        required ? null : this.remover(() => { delete holder[key]; }, label(key)[0])),
      this.chooser(node, holder, key, where), this.mistake(where), inner);
    box.open = this.closed.get(where) ?? (OPEN.has(where) || path !== "");
    box.addEventListener("toggle", () => this.closed.set(where, box.open));
    return box;
  }

  list(node, values, path) {
    return [
      values.map((value, i) => {
        const form = this.schema.formOf(node.items, value).node, name = value?.name || `${i + 1}`;
        const inner = form.type === "object"
          ? this.group(form, value, `${path}/${i}`)
          : this.field(node.items, values, i, path, true);
        return el("details", { class: "item", open: this.closed.get(`${path}/${i}`) ?? i === 0,
          ontoggle: (event) => this.closed.set(`${path}/${i}`, event.target.open) },
        el("summary", {}, name, el("span", { class: "spring" }),
          this.remover(() => values.splice(i, 1), name)), inner);
      }),
      el("button", { type: "button", class: "adder",
        onclick: () => this.reshape(() => values.push(another(values) ?? this.schema.blank(node.items))),
      }, "add one"),
    ];
  }

  remover(change, name) {
    return el("button", { type: "button", class: "remove", title: `leave ${name} out`,
      "aria-label": `leave ${name} out`,
      onclick: (event) => { event.preventDefault(); this.reshape(change); } }, "×");
  }

  // Which of several forms a value has (`kind`, `mode`, a number or a list…).
  chooser(node, holder, key, where) {
    const forms = this.schema.forms(node), names = [...new Set(forms.map((f) => f.name))];
    if (names.length < 2) return null;
    const now = this.schema.formOf(node, holder[key]).name;
    const list = el("select", { class: "kind", "aria-label": `kind of ${key}`, id: `kind${where}` },
      names.map((name) => el("option", { value: name }, name.replaceAll("_", " "))));
    list.value = now;
    list.addEventListener("change", () => this.reshape(() => {
      const next = forms.find((f) => f.name === list.value).node;
      const made = this.schema.blank(next);
      if (made && typeof made === "object" && !Array.isArray(made)) { // keep what both forms have
        const variant = variantKey(next);
        for (const [name, value] of Object.entries(holder[key] || {})) {
          if (name in (next.properties || {}) && name !== variant) made[name] = value;
        }
      }
      holder[key] = made;
    }));
    return list;
  }

  field(node, holder, key, path, required) {
    const where = `${path}/${key}`, [name, unit] = label(String(key));
    if (holder[key] === undefined) holder[key] = this.schema.blank(node);
    const form = this.schema.formOf(node, holder[key]).node;
    const id = `f${this.ids++}`, wrong = this.mistakes.has(where);
    const told = this.schema.resolve(node).description;
    return el("div", { class: wrong ? "field wrong" : "field", "data-path": where },
      el("label", { for: id, title: [told, limits(form)].filter(Boolean).join("; ") }, name,
        unit ? el("span", { class: "unit" }, unit) : null),
      el("span", { class: "inputs" }, this.chooser(node, holder, key, where),
        this.input(form, holder, key, id),
        required ? null : this.remover(() => { delete holder[key]; }, name)),
      this.mistake(where));
  }

  input(node, holder, key, id) {
    const value = holder[key], set = (found) => this.edit(() => { holder[key] = found; });
    if (node.const !== undefined) return el("span", { class: "const" }, String(node.const));
    if (key === "catalogue" && typeof value === "string") {
      return this.choice(id, this.catalogues, value, set, "no catalogue is registered");
    }
    if (node.enum) return this.choice(id, node.enum, value, set);
    if (node.type === "boolean") {
      return el("input", { type: "checkbox", id, checked: value,
        onchange: (event) => set(event.target.checked) });
    }
    if (node.type === "array") return this.row(node, value, id);
    if (node.type === "number" || node.type === "integer") {
      return el("input", { id, class: "number", inputmode: "decimal", value: String(value ?? ""),
        autocomplete: "off", oninput: (event) => set(asNumber(event.target.value)) });
    }
    const wide = node.maxLength > 60 || String(key).startsWith("line");
    return el("input", { id, value: value ?? "", spellcheck: "false", autocomplete: "off",
      class: wide ? "wide" : "", oninput: (event) => set(event.target.value) });
  }

  choice(id, names, value, set, none) {
    const all = names.includes(value) || value === "" ? names : [value, ...names];
    const list = el("select", { id, onchange: (event) => set(event.target.value) },
      all.includes(value) ? null : el("option", { value: "" }, names.length ? "choose…" : none),
      all.map((name) => el("option", { value: name }, name)));
    list.value = all.includes(value) ? value : "";
    return list;
  }

  // A short list of numbers or words, side by side.
  row(node, values, id) {
    if (node.items?.enum) {
      return el("span", { class: "checks", id }, node.items.enum.map((name) =>
        el("label", {}, el("input", { type: "checkbox", checked: values.includes(name),
          onchange: (event) => this.edit(() => {
            if (event.target.checked) values.push(name);
            else values.splice(values.indexOf(name), 1);
          }) }), name)));
    }
    return values.map((value, i) => el("input", { id: i ? `${id}-${i}` : id, class: "number",
      inputmode: "decimal", value: String(value), "aria-label": `${i + 1} of ${values.length}`,
      oninput: (event) => this.edit(() => { values[i] = asNumber(event.target.value); }) }));
  }

  mistake(where) {
    const text = this.mistakes.get(where);
    return text ? el("p", { class: "mistake" }, `allowed: ${text.replace(/^allowed: /, "")}`) : null;
  }
}

// What is typed as a number where it is one; the service judges the rest.
function asNumber(text) {
  const value = Number(text);
  return text.trim() !== "" && Number.isFinite(value) ? value : text;
}

function isRow(node, value) {
  if (node.items?.enum) return true;
  return Array.isArray(value) && value.length <= 4 && value.every((v) => typeof v !== "object");
}

// A copy of a list's last entry, named anew.
function another(values) {
  if (!values.length) return undefined;
  const made = structuredClone(values[values.length - 1]);
  if (made && made.name) {
    const stem = made.name.replace(/-\d+$/, "");
    let n = values.length + 1;
    while (values.some((v) => v.name === `${stem}-${n}`)) n++;
    made.name = `${stem}-${n}`;
  }
  return made;
}
