// Tables: the zones, and all points with a search.

import { fill, h, icon, setAttribute, setText } from "./dom.js";
import { exact, num, shown, withUnit, words } from "./format.js";
import { mayChange } from "./session.js";
import { change, view } from "./view.js";

const FIRST = 100;

/** Source of an actuator's value, for readers. */
export function sourceOf(state, actuator) {
  return state.sources?.[state.source?.[actuator]] || "";
}

/** Alarms of each point that are not normal, the most urgent first. */
export function alarmsByPoint(state) {
  const result = new Map();
  for (const alarm of state.alarms ?? []) {
    if (alarm.state === "normal") continue;
    const previous = result.get(alarm.point);
    if (!previous || (alarm.is_open && !previous.is_open)) result.set(alarm.point, alarm);
  }
  return result;
}

function alarmChip(cell, alarm) {
  const text = alarm ? words(alarm.state === "active" ? alarm.event_state : alarm.state) : "";
  if (cell.dataset.text === text) return;
  cell.dataset.text = text;
  fill(cell, alarm && h("span", { class: `chip ${alarm.is_open ? "alarm" : "muted"}`, title: alarm.alarm }, text));
}

function sourceChip(cell, source) {
  if (cell.dataset.text === source) return;
  cell.dataset.text = source;
  fill(cell, source ? h("span", { class: "chip source", title: source }, source) : h("span", { class: "muted" }, "baseline"));
}

export class ZoneTable {
  constructor(root, description, select) {
    this.description = description;
    const has = (role) => description.zones.some((zone) => zone[role] !== null);
    this.columns = { occupants: has("occupants"), humidity: has("humidity"), set: has("heating_actuator") || has("cooling_actuator") || has("heating_setpoint") };
    const heads = [["Zone", ""], ["°C", "number"], ["Band", "number"]];
    if (this.columns.humidity) heads.push(["% RH", "number"]);
    if (this.columns.occupants) heads.push(["People", "number"]);
    if (this.columns.set) heads.push(["Heats below", "number"], ["Cools above", "number"], ["Set by", ""]);
    heads.push(["Alarm", ""]);
    this.rows = description.zones.map((zone, number) => this.row(zone, number, select));
    fill(root, h("table", { class: "zones" },
      h("thead", {}, h("tr", {}, heads.map(([text, kind]) => h("th", { scope: "col", class: kind || null }, text)))),
      h("tbody", {}, this.rows.map((row) => row.element))));
  }

  row(zone, number, select) {
    const cells = {};
    const cell = (name, kind) => { cells[name] = h("td", { class: kind || null }); return cells[name]; };
    const setpoint = (name, role) => {
      const actuator = zone[`${role}_actuator`];
      const content = cell(name, "number");
      if (actuator !== null) {
        const point = this.description.points[actuator];
        cells[`${name}_button`] = h("button", { class: "value", title: `${mayChange() ? "Override" : "Show"} ${point.label}`, onclick: () => change({ point: point.id }) });
        content.append(cells[`${name}_button`]);
      }
      return content;
    };
    const element = h("tr", {},
      h("th", { scope: "row" }, h("button", { class: "plain", onclick: () => select(this.selected === number ? null : number) }, zone.name)),
      cell("temperature", "number"), cell("band", "number muted"),
      this.columns.humidity && cell("humidity", "number"),
      this.columns.occupants && cell("people", "number"),
      this.columns.set && [setpoint("heating", "heating"), setpoint("cooling", "cooling"), cell("source", "")],
      cell("alarm", ""));
    return { element, cells, zone };
  }

  update(state) {
    const actuators = this.description.points.length - (state.source?.length ?? 0);
    const alarms = alarmsByPoint(state);
    this.rows.forEach(({ element, cells, zone }, number) => {
      const now = state.zones?.[number];
      const value = (place) => (place === null || place === undefined ? null : state.values?.[place]);
      setText(cells.temperature, num(value(zone.temperature), "°C"));
      cells.temperature.classList.toggle("warm", now?.deviation > 0);
      cells.temperature.classList.toggle("cold", now?.deviation < 0);
      setText(cells.band, now ? bandText(now) : "");
      if (cells.humidity) setText(cells.humidity, num(value(zone.humidity), "people"));
      if (cells.people) setText(cells.people, num(value(zone.occupants), "people"));
      let source = "";
      for (const name of ["heating", "cooling"]) {
        const place = zone[`${name}_actuator`];
        const effective = value(place) ?? value(zone[`${name}_setpoint`]);
        if (cells[name]) setText(cells[`${name}_button`] ?? cells[name], num(effective, "°C"));
        if (place !== null && !source) source = sourceOf(state, place - actuators);
      }
      if (cells.source) sourceChip(cells.source, source);
      alarmChip(cells.alarm, alarms.get(this.description.points[zone.temperature]?.id));
      setAttribute(element, "data-occupied", now?.occupied ? "yes" : null);
    });
  }

  mark(selected) {
    this.selected = selected;
    this.rows.forEach(({ element }, number) => {
      element.classList.toggle("selected", number === selected);
      setAttribute(element, "aria-selected", number === selected ? "true" : null);
    });
  }
}

export class PointTable {
  /** `plot` is called with a point's id, to add it to the trends or remove it from them. */
  constructor(root, description, plot) {
    this.description = description;
    this.plot = plot;
    this.limit = FIRST;
    this.state = null;
    this.search = h("input", { type: "search", placeholder: "Search points (/)", "aria-label": "Search points", value: view().search ?? "",
      oninput: () => { this.limit = FIRST; change({ search: this.search.value }, { replace: true }); this.draw(); } });
    this.kind = h("select", { "aria-label": "Kind of point", onchange: () => { change({ kind: this.kind.value }, { replace: true }); this.draw(); } },
      [["", "all kinds"], ["actuator", "actuators"], ["sensor", "sensors"], ["meter", "meters"]].map(([value, text]) => h("option", { value }, text)));
    this.kind.value = view().kind ?? "";
    this.count = h("span", { class: "muted", role: "status" });
    this.body = h("tbody");
    this.more = h("button", { class: "wide-button", onclick: () => { this.limit += 400; this.draw(); } });
    const heads = [["Point", ""], ["Value", "number"], ["Command", "number"], ["Set by", ""], ["Alarm", ""], ["Trend", ""]];
    fill(root, h("div", { class: "row filters" }, this.search, this.kind, this.count),
      h("table", { class: "points" },
        h("thead", {}, h("tr", {}, heads.map(([text, kind]) => h("th", { scope: "col", class: kind || null }, text)))), this.body),
      this.more);
    this.draw();
  }

  matches() {
    const wanted = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const kind = this.kind.value;
    return this.description.points.map((point, place) => [point, place]).filter(([point]) => {
      if (kind && point.kind !== kind) return false;
      const text = `${point.name} ${point.label} ${point.unit} ${point.kind}`.toLowerCase();
      return wanted.every((word) => text.includes(word));
    });
  }

  draw() {
    const matches = this.matches();
    this.rows = matches.slice(0, this.limit).map(([point, place]) => {
      const cells = { value: h("td", { class: "number" }), command: h("td", { class: "number muted" }), source: h("td"), alarm: h("td") };
      const button = h("button", { class: "quiet small", "aria-label": `Trend of ${point.label}`, onclick: () => this.plot(point.id) }, icon("chart"));
      const element = h("tr", {},
        h("th", { scope: "row" }, h("button", { class: "plain", title: point.name, onclick: () => change({ point: point.id }) }, point.label)),
        cells.value, cells.command, cells.source, cells.alarm, h("td", {}, button));
      return { element, cells, point, place, button };
    });
    fill(this.body, this.rows.map((row) => row.element));
    setText(this.count, `${matches.length} of ${this.description.points.length}`);
    this.more.hidden = matches.length <= this.limit;
    setText(this.more, `Show more of the ${matches.length - this.limit} others`);
    if (this.state) this.update(this.state);
    this.mark(this.plotted ?? []);
  }

  update(state) {
    this.state = state;
    const first = this.description.points.length - (state.source?.length ?? 0);
    const alarms = alarmsByPoint(state);
    for (const { cells, point, place } of this.rows) {
      const value = state.values?.[place];
      setText(cells.value, withUnit(shown(point, value), point.unit));
      if (point.kind === "actuator") {
        const actuator = place - first;
        setText(cells.command, exact(state.commanded?.[actuator]));
        sourceChip(cells.source, sourceOf(state, actuator));
      }
      alarmChip(cells.alarm, alarms.get(point.id));
    }
  }

  mark(plotted) {
    this.plotted = plotted;
    for (const { point, button } of this.rows) setAttribute(button, "aria-pressed", String(plotted.includes(point.id)));
  }
}

function bandText({ low, high }) {
  const [from, to] = [num(low, "°C"), num(high, "°C")];
  if (low === null && high !== null) return `≤ ${to}`;
  return high === null && low !== null ? `≥ ${from}` : `${from} – ${to}`;
}
