// Points of a scenario: a search over all points of the building, and those that are chosen.

import { get, toast } from "./api.js";
import { fill, h, setText } from "./dom.js";
import { counted } from "./format.js";

const KINDS = { sensors: "sensor", meters: "meter", actuators: "actuator" };
const AGGREGATIONS = ["mean", "instant", "sum"];
/** Fields of a point in the order of a list; the first ones say which point it is. */
const FIELDS = { sensors: ["variable", "key", "aggregation", "lead_h"], meters: ["variable"], actuators: ["component_type", "control_type", "key", "low", "high"] };
const IDENTITY = { sensors: 2, meters: 1, actuators: 3 };

/** A name on the bus for a point: of its object and its variable. */
function busName(point, taken) {
  const [variable] = point.name.split(" / ").slice(-1);
  const text = `${point.key} ${variable}`.toLowerCase().replace(/[^a-z0-9]+/g, "_").replace(/^_+|_+$/g, "").slice(0, 60) || "point";
  let name = text;
  for (let number = 2; name in taken; number += 1) name = `${text}_${number}`;
  return name;
}

export class BuilderPoints {
  constructor(root, { building, get: read, set }) {
    Object.assign(this, { building, read, set });
    this.search = h("input", { type: "search", id: "point-search", placeholder: "words of name, object, zone or loop", autocomplete: "off", spellcheck: "false", oninput: () => this.find() });
    this.kind = h("select", { id: "point-kind", onchange: () => this.find() }, [["", "all kinds"], ...Object.entries(KINDS).map(([kinds, kind]) => [kind, kinds])].map(([value, text]) => h("option", { value }, text)));
    this.count = h("p", { class: "muted", role: "status" });
    this.rows = h("tbody");
    this.chosen = {};
    const parts = Object.keys(KINDS).map((kinds) => {
      this.chosen[kinds] = h("div", { class: "stack" });
      return [h("h3", {}, kinds[0].toUpperCase() + kinds.slice(1)), this.chosen[kinds]];
    });
    fill(root,
      h("div", { class: "row wrap filters" },
        h("div", { class: "grow" }, h("label", { for: "point-search" }, "Search"), this.search),
        h("div", {}, h("label", { for: "point-kind" }, "Kind"), this.kind)),
      this.count,
      h("div", { class: "scroll point-results", tabindex: 0, role: "region", "aria-label": "Points of the building" }, h("table", {},
        h("thead", {}, h("tr", {}, ["Point", "Object", "Unit", "Where", ""].map((head) => h("th", { scope: "col" }, head || h("span", { class: "visually-hidden" }, "Add"))))), this.rows)),
      parts);
    this.show();
    setText(this.count, "Search the points of the building; the first time takes some seconds.");
  }

  find() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.request(), 250);
  }

  async request() {
    const building = this.building();
    const number = this.number = (this.number ?? 0) + 1;
    if (!building) { setText(this.count, "Choose a building first."); fill(this.rows); return; }
    setText(this.count, "Reading the points of the building …");
    try {
      const query = new URLSearchParams({ building, search: this.search.value, kind: this.kind.value });
      const answer = await get(`/api/builder/points?${query}`);
      if (number !== this.number) return;
      setText(this.count, `${answer.count} of ${counted(answer.total, "point")}${answer.count > answer.points.length ? `, the first ${answer.points.length} of them` : ""}`);
      fill(this.rows, answer.points.map((point) => h("tr", {},
        h("th", { scope: "row" }, point.name), h("td", {}, point.key), h("td", {}, point.unit), h("td", {}, point.where),
        h("td", {}, h("button", { type: "button", class: "small", "aria-label": `Add ${point.name} ${point.key}`, onclick: () => this.add(point) }, "Add")))));
    } catch (error) { if (number === this.number) { setText(this.count, error.message); fill(this.rows); } }
  }

  add(point, name = null) {
    const kinds = Object.keys(KINDS).find((each) => KINDS[each] === point.kind);
    const points = { ...(this.read(kinds) ?? {}) };
    const spec = point.kind === "meter" ? point.name : point.kind === "sensor" ? [point.name, point.key] : [...split(point.name), point.key];
    if (!name && Object.values(points).some((each) => JSON.stringify(identity(kinds, each)) === JSON.stringify(identity(kinds, spec)))) { toast(`${point.name} ${point.key} is chosen already.`, true); return; }
    points[name ?? busName(point, points)] = spec;
    this.set(kinds, points);
    this.show();
  }

  /** Replace the points of a kind by those that a node has by default. */
  async addDefaults(kinds) {
    try {
      const query = new URLSearchParams({ building: this.building(), kind: KINDS[kinds], default: 1 });
      const answer = await get(`/api/builder/points?${query}`);
      this.set(kinds, {});
      for (const point of answer.points) this.add(point, point.bus_name);
      this.show();
    } catch (error) { toast(error.message, true); }
  }

  show() {
    for (const [kinds, root] of Object.entries(this.chosen)) {
      const points = this.read(kinds);
      const none = kinds === "actuators" ? "None: the building runs under baseline control." : "None.";
      const rows = Object.entries(points ?? {}).map(([name, spec]) => this.row(kinds, name, spec));
      fill(root,
        points === undefined || points === null ? h("p", { class: "muted" }, `A default set of the model's ${kinds}.`) : rows.length ? rows : h("p", { class: "muted" }, none),
        h("div", { class: "row wrap" },
          points ? h("button", { type: "button", class: "small", onclick: () => { this.set(kinds, undefined); this.show(); } }, `Default ${kinds}`) : [
            h("button", { type: "button", class: "small", onclick: () => this.addDefaults(kinds) }, `List the default ${kinds}`),
            h("button", { type: "button", class: "small", onclick: () => { this.set(kinds, {}); this.show(); } }, `No ${kinds}`)]));
    }
  }

  row(kinds, name, spec) {
    const fields = fieldsOf(kinds, spec), object = identity(kinds, spec);
    const change = (next, value) => {
      spec = value;
      const points = Object.entries(this.read(kinds)).map(([each, old]) => (each === name ? [next, value] : [each, old]));
      this.set(kinds, Object.fromEntries(points));
    };
    const rename = (event) => {
      const next = event.target.value.trim();
      if (!next || next === name || next in this.read(kinds)) { event.target.value = name; return; }
      change(next, spec);
      this.show();
    };
    const bound = (field) => h("input", { type: "number", step: "any", class: "bound", "aria-label": `${field} of ${name}`, placeholder: field, value: fields[field] ?? "",
      onchange: (event) => change(name, withField(kinds, spec, field, event.target.value === "" ? null : Number(event.target.value))) });
    const aggregation = () => h("select", { "aria-label": `Aggregation of ${name}`, onchange: (event) => change(name, withField(kinds, spec, "aggregation", event.target.value || null)) },
      ["", ...AGGREGATIONS].map((each) => h("option", { value: each, selected: each === (fields.aggregation ?? "") }, each || "default")));
    return h("div", { class: "chosen-point" },
      h("input", { "aria-label": `Name of ${object.join(", ")}`, value: name, maxlength: 128, spellcheck: "false", onchange: rename }),
      h("span", { class: "muted grow" }, object.join(" · ")),
      kinds === "sensors" && aggregation(), kinds === "actuators" && [bound("low"), bound("high")],
      h("button", { type: "button", class: "quiet small", "aria-label": `Remove ${name}`, onclick: () => { const { [name]: _, ...others } = this.read(kinds); this.set(kinds, others); this.show(); } }, "×"));
  }
}

/** Component type and control type of an actuator's name in a list. */
function split(name) {
  const at = name.indexOf(" / ");
  return [name.slice(0, at), name.slice(at + 3)];
}

const isMapping = (spec) => typeof spec === "object" && spec !== null && !Array.isArray(spec);

/** Fields of a point by their names; a file has them as a mapping in any order, as a list, or as a name alone. */
const fieldsOf = (kinds, spec) => (isMapping(spec) ? spec : Object.fromEntries([spec].flat().map((value, place) => [FIELDS[kinds][place], value])));

const identity = (kinds, spec) => FIELDS[kinds].slice(0, IDENTITY[kinds]).map((field) => fieldsOf(kinds, spec)[field] ?? "");

/** A point with another value of a field, null for its default, in the form that it has. */
function withField(kinds, spec, field, value) {
  if (isMapping(spec)) {
    const { [field]: _, ...others } = spec;
    return value === null ? others : { ...spec, [field]: value };
  }
  const fields = { ...fieldsOf(kinds, spec), [field]: value };
  const list = FIELDS[kinds].map((each) => fields[each] ?? null);
  while (list.at(-1) === null) list.pop();
  return list;
}
