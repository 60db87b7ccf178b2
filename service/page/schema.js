// Reading a JSON Schema: references, variants by `kind`, labels and units from the keys.

export class Schema {
  constructor(root) {
    this.root = root;
  }

  resolve(node) {
    while (node && node.$ref) {
      const found = this.root.$defs[node.$ref.replace("#/$defs/", "")];
      const { $ref, ...rest } = node;
      node = { ...found, ...rest };
    }
    return node;
  }

  // The forms that a value may take: [{ name, node }]; null (absence) is omitted.
  forms(node) {
    node = this.resolve(node);
    const list = node.oneOf || node.anyOf;
    if (!list) return [{ name: formName(node), node }];
    return list.flatMap((one) => {
      const inner = this.resolve(one);
      if (inner.type === "null") return [];
      if (inner.oneOf || inner.anyOf) return this.forms(inner);
      return [{ name: formName(inner), node: inner }];
    });
  }

  // The form that a value has, or the first one.
  formOf(node, value) {
    const forms = this.forms(node);
    return forms.find(({ node: one }) => fits(one, value)) || forms[0];
  }

  // A smallest value of a form: its constants, and what is required in it.
  blank(node) {
    node = this.forms(node)[0].node;
    if (node.const !== undefined) return node.const;
    if (node.default !== undefined && node.default !== null) return structuredClone(node.default);
    if (node.enum) return node.enum[0];
    if (node.type === "object") {
      const value = {};
      for (const key of node.required || []) value[key] = this.blank(node.properties[key]);
      return value;
    }
    if (node.type === "array") {
      if (node.prefixItems) return node.prefixItems.map((item) => this.blank(item));
      return Array.from({ length: node.minItems || 0 }, () => this.blank(node.items));
    }
    if (node.type === "boolean") return true;
    if (node.type === "string") return "";
    return Math.max(0, node.minimum ?? 0);
  }
}

export function variantKey(node) {
  const found = Object.entries(node.properties || {}).find(([key, one]) =>
    (key === "kind" || key === "mode") && one.const !== undefined);
  return found ? found[0] : null;
}

function formName(node) {
  const key = variantKey(node);
  if (key) return node.properties[key].const;
  if (node.const !== undefined) return String(node.const);
  if (node.enum) return "choice";
  return { number: "number", integer: "number", string: "text", array: "list", boolean: "yes or no",
    object: "in detail" }[node.type] || node.type;
}

function fits(node, value) {
  if (node.const !== undefined) return value === node.const;
  if (node.enum) return node.enum.includes(value);
  if (Array.isArray(value)) return node.type === "array";
  if (value !== null && typeof value === "object") {
    const key = variantKey(node);
    return node.type === "object" && (!key || value[key] === node.properties[key].const);
  }
  if (typeof value === "number") return node.type === "number" || node.type === "integer";
  return node.type === typeof value;
}

const UNITS = [
  ["_mag_arcsec2", "mag/arcsec²"], ["_arcsec_per_s", "″/s"], ["_deg_per_s", "°/s"],
  ["_e_per_s", "e⁻/s"], ["_e_per_dn", "e⁻/DN"], ["_m_s", "m/s"], ["_m2", "m²"], ["_arcsec", "″"],
  ["_mag", "mag"], ["_deg", "°"], ["_um", "µm"], ["_nm", "nm"], ["_px", "px"], ["_km", "km"],
  ["_dn", "DN"], ["_rad", "rad"], ["_m", "m"], ["_s", "s"], ["_e", "e⁻"], ["_k", "K"],
];

// A key as a label and its unit: `pixel_pitch_um` is "pixel pitch" in µm.
export function label(key) {
  for (const [end, unit] of UNITS) {
    if (key.endsWith(end) && key.length > end.length) {
      return [key.slice(0, -end.length).replaceAll("_", " "), unit];
    }
  }
  return [key.replaceAll("_", " "), ""];
}

// What a field allows, in words.
export function limits(node) {
  const parts = [];
  if (node.exclusiveMinimum !== undefined) parts.push(`over ${node.exclusiveMinimum}`);
  if (node.minimum !== undefined) parts.push(`from ${node.minimum}`);
  if (node.exclusiveMaximum !== undefined) parts.push(`below ${node.exclusiveMaximum}`);
  if (node.maximum !== undefined) parts.push(`to ${node.maximum}`);
  return parts.join(" ");
}

// A scene without what is null, so that the form is short.
export function trimmed(value) {
  if (Array.isArray(value)) return value.map(trimmed);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).filter(([, v]) => v !== null).map(([k, v]) => [k, trimmed(v)]));
}
