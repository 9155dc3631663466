// Fields of a form from a JSON schema. A field that is left empty is not part of the result.

import { h, setAttribute } from "./dom.js";
import { words } from "./format.js";

/** A schema without references, and without the null that a field may have. */
export function resolve(schema, root) {
  let each = schema;
  while (each.$ref) each = { ...root.$defs[each.$ref.split("/").at(-1)], ...(each.description && { description: each.description }) };
  const choices = each.anyOf?.map((choice) => resolve(choice, root)).filter((choice) => choice.type !== "null");
  if (choices?.length === 1) return { ...choices[0], ...(each.default !== undefined && { default: each.default }), ...(each.description && { description: each.description }) };
  return choices ? { ...each, anyOf: choices } : each;
}

/** `lambda_energy` as `Lambda energy`. */
export const title = (name) => { const text = words(name); return text[0].toUpperCase() + text.slice(1); };

const isNames = (each) => (each.anyOf ?? [each]).some((choice) => choice.type === "array" && choice.items?.type === "string");
const isText = (each) => each.type === "string";
const scalar = (value) => (value === null || value === undefined ? "" : typeof value === "object" ? JSON.stringify(value) : String(value));

/** Names separated by commas, or by spaces. */
export const names = (text) => text.split(/[\s,]+/).filter(Boolean);

let count = 0;

/**
 * A field with its label: `{element, input, set}`; `set` shows a value, `onChange` receives each new one, undefined for an empty field.
 */
export function field(name, schema, root, onChange, { list = null, label = title(name) } = {}) {
  const each = resolve(schema, root);
  const id = `field-${count += 1}`;
  const hint = each.description ? h("p", { class: "hint", id: `${id}-hint` }, each.description) : null;
  const common = { id, "aria-describedby": hint && `${id}-hint` };
  const built = control(each, root, common, onChange, list);
  return { ...built, element: h("div", { class: "form-field" }, h("label", { for: built.group ? null : id, id: `${id}-label` }, label), built.element, hint) };
}

function control(each, root, common, onChange, list) {
  const items = each.type === "array" && resolve(each.items ?? {}, root);
  if (items?.enum) return checkboxes(items.enum, common, onChange);
  if (each.enum || each.const !== undefined) return select(each.enum ?? [each.const], each.default, common, onChange);
  if (each.type === "boolean") return select([true, false], each.default, common, onChange, (value) => (value ? "yes" : "no"));
  if (each.type === "number" || each.type === "integer") return number(each, common, onChange);
  if (isText(each)) return input(common, list, scalar(each.default), (text) => onChange(text === "" ? undefined : text), (value) => scalar(value));
  if (isNames(each)) return input(common, list, "names, separated by commas", (text) => onChange(names(text).length ? names(text) : undefined), (value) => [value ?? []].flat().join(", "));
  return json(each, common, onChange);
}

function input(common, list, placeholder, read, show) {
  const element = h("input", { ...common, autocomplete: "off", spellcheck: "false", list, placeholder: placeholder || null, oninput: () => read(element.value.trim()) });
  return { element, set: (value) => { element.value = show(value); } };
}

function number(each, common, onChange) {
  const read = () => onChange(element.value === "" ? undefined : Number(element.value));
  const element = h("input", { ...common, type: "number", step: each.type === "integer" ? 1 : "any", min: each.minimum, max: each.maximum, placeholder: scalar(each.default) || null, oninput: read });
  return { element, set: (value) => { element.value = scalar(value); } };
}

function select(values, initial, common, onChange, text = (value) => words(value)) {
  const options = values.map((value, place) => h("option", { value: place }, text(value)));
  const element = h("select", { ...common, onchange: () => onChange(element.value === "" ? undefined : values[Number(element.value)]) },
    h("option", { value: "" }, initial === undefined || initial === null ? "default" : `default: ${text(initial)}`), options);
  return { element, set: (value) => { const place = values.indexOf(value); element.value = place < 0 ? "" : String(place); } };
}

function checkboxes(values, common, onChange) {
  const boxes = values.map((value) => h("input", { type: "checkbox", onchange: () => { const chosen = values.filter((_, place) => boxes[place].checked); onChange(chosen.length ? chosen : undefined); } }));
  const element = h("div", { role: "group", "aria-labelledby": `${common.id}-label`, "aria-describedby": common["aria-describedby"], class: "row wrap checks" },
    values.map((value, place) => h("label", { class: "row" }, boxes[place], words(value))));
  return { element, group: true, set: (value) => { values.forEach((each, place) => { boxes[place].checked = Boolean(value?.includes(each)); }); } };
}

/** Anything else, as JSON; it is taken over when it is complete. */
function json(each, common, onChange) {
  const read = () => {
    const text = element.value.trim();
    try {
      onChange(text === "" ? undefined : JSON.parse(text));
      setAttribute(element, "aria-invalid", null);
    } catch { setAttribute(element, "aria-invalid", "true"); }
  };
  const element = h("textarea", { ...common, rows: 2, spellcheck: "false", class: "code", placeholder: each.default === undefined || each.default === null ? "JSON" : JSON.stringify(each.default), oninput: read });
  return { element, set: (value) => { element.value = value === undefined || value === null ? "" : JSON.stringify(value, null, 1); setAttribute(element, "aria-invalid", null); } };
}
