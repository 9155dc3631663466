// One point: its value, its trend, its priority array, and overrides.

import { get, nodePath, operate } from "./api.js";
import { fill, h, icon, refill, setText } from "./dom.js";
import { exact, hoursBefore, shortTime, shown, withUnit, words } from "./format.js";
import { eventItem } from "./panels.js";
import { forOperators, mayChange, refusalNote } from "./session.js";
import { chart, loadHistory } from "./trends.js";
import { change, view } from "./view.js";

const PRIORITIES = { 1: "manual life safety", 2: "automatic life safety", 5: "critical equipment", 6: "minimum on/off time", 8: "manual operator", 10: "controllers", 16: "lowest" };
const DURATIONS = [[3600, "1 h"], [7200, "2 h"], [14400, "4 h"], [28800, "8 h"], [86400, "1 day"], ["", "until relinquished"]];

function priorityName(number) {
  return PRIORITIES[number] ? `${number} · ${PRIORITIES[number]}` : String(number);
}

/** A list of the 16 priorities to choose from. */
export function prioritySelect(id) {
  return h("select", { id }, Array.from({ length: 16 }, (_, place) => h("option", { value: place + 1 }, priorityName(place + 1))));
}

export class PointPanel {
  constructor(root, node, description, place) {
    this.root = root;
    this.node = node;
    this.description = description;
    this.place = place;
    const point = this.point = description.points[place];
    this.value = h("span", { class: "big" });
    this.note = h("p", { class: "muted" });
    this.canvas = h("div", { class: "chart" });
    this.rows = new Map();
    this.entries = h("tbody");
    const heads = [["Priority", ""], ["Value", "number"], ["By", ""], ["Until", ""], ["", ""]];
    this.table = h("table", {}, h("thead", {}, h("tr", {}, heads.map(([text, kind]) => h("th", { scope: "col", class: kind || null }, text || h("span", { class: "visually-hidden" }, "Change"))))), this.entries);
    this.array = h("div");
    this.events = h("ul", { class: "log" });
    const back = document.activeElement;
    this.close = () => {
      this.plot?.destroy();
      fill(root);
      if (back?.isConnected) back.focus();
    };
    const content = h("aside", { class: "drawer", "aria-label": point.label, tabindex: "-1" },
      h("div", { class: "row" },
        h("h2", {}, point.label), h("span", { class: "grow" }),
        h("button", { class: "quiet", "aria-label": "Close", onclick: () => change({ point: null }) }, icon("close"))),
      h("p", { class: "banner problem lost" }, "no connection"),
      h("p", { class: "muted code" }, point.name),
      h("div", { class: "row" }, this.value), this.note, this.canvas,
      point.kind === "actuator" && [mayChange() ? this.form() : refusalNote(), h("h3", {}, "Priority array"), this.array],
      h("h3", {}, "Events"), this.events);
    fill(root, content);
    content.focus();
    this.load();
  }

  form() {
    const { point } = this;
    const bounds = { low: point.low ?? undefined, high: point.high ?? undefined };
    this.input = h("input", { id: "override", type: "number", step: "any", min: bounds.low, max: bounds.high, required: true });
    this.priority = prioritySelect("priority");
    this.priority.value = "8";
    this.duration = h("select", { id: "duration" }, DURATIONS.map(([value, text]) => h("option", { value }, text)));
    this.duration.value = "7200";
    const submit = async (event) => {
      event.preventDefault();
      const content = { point: point.name, value: Number(this.input.value), priority: Number(this.priority.value) };
      if (this.duration.value) content.duration_s = Number(this.duration.value);
      await operate(this.node, "write", content);
      this.load();
    };
    const range = [point.low, point.high].map((bound) => exact(bound));
    return h("form", { class: "override", onsubmit: submit },
      h("h3", {}, "Override"),
      h("div", { class: "fields" },
        h("div", {}, h("label", { for: "override" }, `Value${point.unit ? `, ${point.unit}` : ""}`), this.input),
        h("div", {}, h("label", { for: "duration" }, "For"), this.duration),
        h("div", {}, h("label", { for: "priority" }, "Priority"), this.priority)),
      h("div", { class: "row" },
        h("span", { class: "muted" }, point.low !== null || point.high !== null ? `Bounds: ${range[0]} to ${range[1]}` : ""), h("span", { class: "grow" }),
        h("button", { class: "primary" }, "Override")));
  }

  async relinquish(priority) {
    await operate(this.node, "write", { point: this.point.name, value: null, priority });
    this.load();
  }

  async load() {
    await this.loadArray();
    await this.trend();
  }

  async loadArray() {
    const { point } = this;
    if (point.kind !== "actuator") return;
    try {
      this.draw(await get(`${nodePath(this.node, "priorities")}?point=${encodeURIComponent(point.name)}`));
    } catch (error) { fill(this.array, h("p", { class: "muted" }, error.message)); }  // such as a replay, which takes no requests
  }

  async trend() {
    if (!this.description.history_samples || !this.state?.time) return;
    const { point } = this, from = hoursBefore(this.state.time, 24, this.description.begin);
    try {
      const { time, values: [values], lows: [lows], highs: [highs] } = await loadHistory(this.node, [point], { max: 400, from });
      this.plot?.destroy();
      fill(this.canvas);
      if (!this.canvas.isConnected || values.every((value) => value === null)) return;
      this.plot = chart(this.canvas, { time, height: 170,
        series: [{ label: point.label, unit: point.unit, color: "#2878dc", values, lows, highs, stepped: point.kind === "actuator" }] });
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", `${point.label} in the last day`);
    } catch { /* a reset in between; the next sample draws it */ }
  }

  draw(content) {
    const { point } = this;
    const used = content.entries.map((entry, place) => ({ ...entry, priority: place + 1 })).filter((entry) => entry.value !== null);
    const first = used[0]?.priority, isBaseline = !used.length;
    refill(this.array, this.table);
    refill(this.entries, used.map((entry) => this.row(entry, entry.priority === first)),
      h("tr", { class: isBaseline ? "effective" : null }, h("th", { scope: "row" }, "baseline control"),
        h("td", { class: "number" }, point.default === null || point.default === undefined ? "" : withUnit(point.default, point.unit)), h("td", {}, isBaseline ? "in effect" : ""), h("td"), h("td")));
  }

  /** The row of an entry; the same one for as long as nothing of the entry changes. */
  row(entry, isEffective) {
    const text = JSON.stringify([entry, isEffective]), previous = this.rows.get(entry.priority);
    if (previous?.text === text) return previous.element;
    const element = h("tr", { class: isEffective ? "effective" : null },
      h("th", { scope: "row" }, priorityName(entry.priority)),
      h("td", { class: "number" }, exact(entry.value, this.point.unit)),
      h("td", {}, entry.source),
      h("td", {}, entry.expires ? shortTime(entry.expires) : "–"),
      h("td", {}, h("button", forOperators({ class: "small", "aria-label": `Relinquish priority ${entry.priority}`, onclick: () => this.relinquish(entry.priority) }), "Relinquish")));
    this.rows.set(entry.priority, { text, element });
    return element;
  }

  update(state) {
    const isNew = state.sample_step !== this.state?.sample_step || state.episode !== this.state?.episode;
    const isFirst = !this.state?.time;
    this.state = state;
    const { point, place } = this;
    const value = shown(point, state.values?.[place]);
    setText(this.value, withUnit(value, point.unit));
    if (point.kind === "actuator") {
      const actuator = place - (this.description.points.length - (state.source?.length ?? 0));
      const source = state.sources?.[state.source?.[actuator]];
      const command = state.commanded?.[actuator];
      setText(this.note, source ? `Set by ${source}${command === null ? "" : ` to ${exact(command, point.unit)}`}` : "Under baseline control");
      if (this.input && !this.isFilled && value !== null) { this.input.value = value; this.isFilled = true; }
    } else setText(this.note, words(point.kind));
    if (isFirst) this.trend();
    else if (isNew && !this.timer) this.timer = setTimeout(() => { this.timer = null; if (view().point === point.id) this.load(); }, 1500);
  }

  showEvents(events) {
    const own = events.filter((event) => names(event.text, this.point.name)).slice(-8).reverse();
    const latest = JSON.stringify(own[0]);
    if (this.latest !== undefined && latest !== this.latest) this.loadArray();
    this.latest = latest;
    fill(this.events, own.length ? own.map(eventItem) : h("li", { class: "muted" }, "none since the control room was started"));
  }
}

/** Whether a text has a name, and not only as a part of a longer one. */
export function names(text, name) {
  const escaped = name.replace(/[\\^$.*+?()[\]{}|/]/g, "\\$&");
  return new RegExp(`(?<![\\p{L}\\p{N}_][.-]?)${escaped}(?![.-]?[\\p{L}\\p{N}_])`, "u").test(text);
}
