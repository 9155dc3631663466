// The question "what if": setpoints or another controller on a copy of the building, beside the building as it is.

import { changeNode, copyText, get, nodePath, post, toast } from "./api.js";
import { fill, h, refill, setAttribute, setText } from "./dom.js";
import { counted, dateTime, duration, num, seconds, shown, words } from "./format.js";
import { prioritySelect } from "./point.js";
import { field } from "./schema_form.js";
import { mayChange, refusalNote } from "./session.js";
import { chart, swatch } from "./trends.js";
import { change, view } from "./view.js";

const KINDS = [["values", "Setpoints"], ["controller", "Another controller"]];
const NOTES = {
  values: "Simulates the next hours twice on copies of the building: with its commands as they are, and with these values. The controllers that run do not run on a copy; their last commands stay.",
  controller: "Simulates the next hours twice on copies of the building: with its commands as they are, and with a controller, which answers each timestep in place of the controllers that run. Overrides stay, with their ends.",
};
const PRIORITY = { values: "8", controller: "10" };
const TOTALS = [["facility_kwh", "Electricity", "kWh"], ["facility_peak_kw", "Peak power", "kW"], ["hvac_kwh", "HVAC electricity", "kWh"], ["degree_hours", "Outside the band, occupied", "K h"], ["degree_hours_always", "Outside the band, always", "K h"]];

function lengths({ what_if_hours: longest }) {
  const known = [6, 12, 24, 48].filter((hours) => hours <= longest);
  return known.length ? known : [longest];
}

export class WhatIfPanel {
  constructor(root, node, description) {
    this.node = node;
    this.description = description;
    this.actuators = description.points.filter((point) => point.kind === "actuator");
    this.result = h("div");
    if (!mayChange()) { fill(root, refusalNote()); return; }
    if (!this.actuators.length) { fill(root, h("p", { class: "empty" }, "This node has no actuators.")); return; }
    this.kinds = KINDS.map(([kind, text]) => h("button", { type: "button", "data-kind": kind, onclick: () => this.choose(kind) }, text));
    this.note = h("p", { class: "muted" });
    this.bodies = { values: h("div", { class: "stack" }), controller: h("div", { class: "stack" }) };
    this.setpoints = new Setpoints(this.bodies.values, this);
    this.controllers = new ControllerForm(this.bodies.controller, node);
    this.hours = h("select", { id: "hours" }, lengths(description).map((hours) => h("option", { value: hours }, `${num(hours)} h`)));
    this.hours.value = String(Math.max(...lengths(description).filter((hours) => hours <= 24)));
    this.priority = prioritySelect("what-if-priority");
    this.button = h("button", { class: "primary" }, "Simulate");
    fill(root,
      h("form", { class: "stack", onsubmit: (event) => { event.preventDefault(); this.run(); } },
        h("div", { class: "segments", role: "group", "aria-label": "What to try" }, this.kinds),
        this.note, this.bodies.values, this.bodies.controller,
        h("div", { class: "fields" },
          h("div", {}, h("label", { for: "hours" }, "Next"), this.hours),
          h("div", {}, h("label", { for: "what-if-priority" }, "At priority"), this.priority)),
        h("div", { class: "row end" }, this.button)),
      this.result);
    this.show(view().try === "controller" ? "controller" : "values");
  }

  choose(kind) {
    change({ try: kind === "values" ? null : kind }, { replace: true });
    this.show(kind);
  }

  show(kind) {
    this.kind = kind;
    for (const button of this.kinds) setAttribute(button, "aria-pressed", String(button.dataset.kind === kind));
    for (const [name, body] of Object.entries(this.bodies)) body.hidden = name !== kind;
    setText(this.note, NOTES[kind]);
    this.priority.value = PRIORITY[kind];
    if (kind === "controller") this.controllers.load();
  }

  async run() {
    const question = this.kind === "values" ? this.setpoints.question() : this.controllers.question();
    if (!question) return;
    this.button.disabled = true;
    setText(this.button, "Simulating …");
    const asked = { ...question, hours: Number(this.hours.value), priority: Number(this.priority.value) };
    try {
      const answer = await post(nodePath(this.node, "what_if"), asked);
      this.answer(answer, asked);
    } catch (error) { toast(error.message, true); } finally {
      this.button.disabled = false;
      setText(this.button, "Simulate");
    }
  }

  // The answer: totals, a curve, and how to apply it

  answer(answer, asked) {
    const name = asked.controller?.name ?? "what if";
    const canvas = h("div", { class: "chart" });
    const choice = h("select", { "aria-label": "Point that is drawn" }, this.affected(answer, asked).map((place) => h("option", { value: place }, this.description.points[place].label)));
    const legend = h("ul", { class: "legend" });
    const draw = () => this.draw(answer, name, Number(choice.value), canvas, legend);
    choice.addEventListener("change", draw);
    const { points } = this.description;
    const other = h("input", { list: "what-if-drawn", autocomplete: "off", placeholder: "another point", "aria-label": "Another point that is drawn" });
    other.addEventListener("change", () => {
      const place = points.findIndex((point) => point.id === other.value);
      if (place < 0) { if (other.value) toast(`There is no point ${other.value}.`, true); return; }
      if (![...choice.options].some((option) => Number(option.value) === place)) choice.append(h("option", { value: place }, points[place].label));
      choice.value = place;
      other.value = "";
      draw();
    });
    const drawn = h("datalist", { id: "what-if-drawn" }, points.slice(0, 2000).map((point) => h("option", { value: point.id }, point.label)));
    const apply = asked.values && h("button", { class: "primary", onclick: () => this.apply(asked, apply) }, `Apply for ${asked.hours} h`);
    const ended = h("p", { class: "problem", role: "status", hidden: true }, "The node has begun another episode since.");
    this.answered = { episode: answer.episode, ended, apply };
    const isCut = answer.time.length < Math.floor(asked.hours * 3600 / this.description.step_s + 1e-6);
    fill(this.result, h("h3", {}, `${duration(answer.as_is.totals.hours * 3600)} from ${dateTime(answer.begin)}${isCut ? ", to the end of the episode" : ""}`), ended, this.totals(answer, name),
      h("div", { class: "row wrap drawn" }, choice, other, drawn, legend, h("span", { class: "grow" }), apply), canvas,
      asked.controller && this.start(answer.command, asked));
    draw();
    this.checkEpisode();
    this.result.scrollIntoView({ block: "nearest" });
  }

  totals({ as_is: asIs, changed }, name) {
    const known = new Set(TOTALS.map(([each]) => each));
    const fuels = Object.keys(asIs.totals).filter((each) => each.endsWith("_kwh") && !known.has(each)).map((each) => [each, sentence(words(each.slice(0, -4))), "kWh"]);
    const rows = [...TOTALS.slice(0, 3), ...fuels, ...TOTALS.slice(3)].filter(([each]) => asIs.totals[each] !== undefined && asIs.totals[each] !== null);
    const difference = (each) => { const [a, b] = [asIs.totals[each], changed.totals[each]]; return `${b >= a ? "+" : "\u2212"}${num(Math.abs(b - a))}${a ? ` (${b >= a ? "+" : "\u2212"}${num(Math.abs(100 * (b - a) / a), "%")} %)` : ""}`; };
    const quality = (each) => (changed.totals[each] > asIs.totals[each] + 1e-9 ? "worse" : changed.totals[each] < asIs.totals[each] - 1e-9 ? "better" : "");
    return h("table", { class: "totals" }, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, h("span", { class: "visually-hidden" }, "Total")), ["as is", name, "difference"].map((text) => h("th", { scope: "col", class: "number" }, text)))),
      h("tbody", {}, rows.map(([each, label, unit]) => h("tr", {}, h("th", { scope: "row" }, `${label}, ${unit}`),
        h("td", { class: "number" }, num(asIs.totals[each])), h("td", { class: "number" }, num(changed.totals[each])),
        h("td", { class: `number ${quality(each)}` }, difference(each))))));
  }

  draw({ as_is: asIs, changed, time }, name, place, canvas, legend) {
    this.plot?.destroy();
    fill(canvas);
    const point = this.description.points[place];
    const series = [["as is", "#7d8a97", [6, 4], asIs], [name, "#eb6e00", undefined, changed]].map(([label, color, dash, future]) =>
      ({ label, color, ...(dash && { dash }), unit: point.unit, width: 2, values: future.series[place].map((value) => shown(point, value)), stepped: point.kind === "actuator" }));
    fill(legend, series.map((each) => h("li", {}, swatch(each), each.label)));
    this.plot = chart(canvas, { time: time.map(seconds), series, height: 220 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${point.label}, as is and ${name}`);
  }

  /** Places of the points that change most: temperatures, power, then the actuators that are commanded. */
  affected(answer, { values }) {
    const { zones, facility, hvac, points } = this.description;
    const effect = (place) => answer.changed.series[place].reduce((sum, value, row) => sum + Math.abs((value ?? 0) - (answer.as_is.series[place][row] ?? 0)), 0);
    const most = (places) => places.map((place) => [effect(place), place]).sort(([a], [b]) => b - a).map(([, place]) => place);
    const places = points.map((_, place) => place);
    const actuators = places.filter((place) => points[place].kind === "actuator");
    const commanded = values ? actuators.filter((place) => points[place].name in values) : most(actuators).slice(0, 20);
    const level = (place) => answer.as_is.series[place].reduce((sum, value) => sum + Math.abs(value ?? 0), 1e-9);
    const rest = places.slice(0, 2000).filter((place) => points[place].kind !== "actuator").map((place) => [effect(place) / level(place), place])
      .sort(([a], [b]) => b - a).map(([, place]) => place);
    return [...new Set([...most(zones.map((zone) => zone.temperature)), facility?.point, hvac?.point, ...commanded, ...rest].filter((place) => place !== undefined && place !== null))].slice(0, 60);
  }

  async apply({ values, priority, hours }, button) {
    const writes = Object.entries(values), { textContent: text } = button;
    let count = 0;
    button.disabled = true;
    try {
      for (const [point, value] of writes) {
        setText(button, `Applying ${count + 1} of ${writes.length} …`);
        await changeNode(this.node, "write", { point, value, priority, duration_s: hours * 3600 });
        count += 1;
      }
    } catch (error) { toast(error.message, true); }
    setText(button, text);
    button.disabled = false;
    this.checkEpisode();
    toast(`${count} of ${counted(writes.length, "value")} applied for ${hours} h`);
  }

  /** How to apply a controller: by a command, since the control room runs none. */
  start(command, { priority }) {
    const running = (this.state?.controllers ?? []).filter((each) => each.state === "connected");
    const code = h("pre", { class: "command", tabindex: 0, role: "region", "aria-label": "Command that starts the controller" }, command);
    return h("section", { class: "stack", "aria-labelledby": "apply-controller" }, h("h3", { id: "apply-controller" }, "Apply"),
      h("p", {}, "A controller is a program of its own; the control room runs none. This command, in a terminal on the control room's machine, starts it: it commands the building from then on, until the episode ends or you press Ctrl-C.",
        command.includes("--keys") && " Name the folder of your keys."),
      running.length > 0 && h("p", {}, `End ${running.map((each) => each.controller).join(", ")} first, which it replaced in the simulation${running.some((each) => each.priority === priority) ? `; priority ${priority} is in use` : ""}.`),
      code, h("div", { class: "row end" }, h("button", { type: "button", onclick: () => copyText(code) }, "Copy")));
  }

  update(state) {
    this.state = state;
    this.checkEpisode();
  }

  /** Close what an answer from another episode offers. */
  checkEpisode() {
    if (!this.answered || this.answered.episode === this.state?.episode) return;
    this.answered.ended.hidden = false;
    if (this.answered.apply) this.answered.apply.disabled = true;
  }
}

/** Values of actuators to try. */
class Setpoints {
  constructor(root, panel) {
    this.panel = panel;
    this.changes = new Map();
    this.rows = h("div", { class: "stack" });
    const { zones } = panel.description;
    this.point = h("input", { id: "what-if-point", list: "what-if-points", autocomplete: "off", placeholder: "actuator", "aria-label": "Actuator" });
    const options = h("datalist", { id: "what-if-points" }, panel.actuators.slice(0, 2000).map((point) => h("option", { value: point.name }, point.label)));
    const roles = ["cooling_actuator", "heating_actuator"].filter((role) => zones.some((zone) => zone[role] !== null));
    fill(root, h("div", { class: "row wrap adding" }, roles.map((role) => h("button", { type: "button", class: "small", onclick: () => this.addAll(role) }, `All ${words(role).replace(" actuator", "")} setpoints`)),
      this.point, options, h("button", { type: "button", class: "small", onclick: () => this.add(this.point.value) }, "Add")), this.rows);
  }

  addAll(role) {
    const { zones, points } = this.panel.description;
    const names = new Set(zones.map((zone) => zone[role]).filter((place) => place !== null).map((place) => points[place].name));
    this.group(`All ${words(role).replace(" actuator", "")} setpoints`, [...names]);
  }

  add(name) {
    const point = this.panel.actuators.find((each) => each.name === name);
    if (!point) { toast(name ? `There is no actuator ${name}.` : "Name an actuator.", true); return; }
    this.group(point.label, [name]);
    this.point.value = "";
  }

  group(label, names) {
    if (this.changes.has(label)) return;
    const place = this.panel.description.points.findIndex((point) => point.kind === "actuator" && point.name === names[0]);
    const point = this.panel.description.points[place];
    const now = shown(point, this.panel.state?.values?.[place]);
    const input = h("input", { type: "number", step: "any", required: true, "aria-label": label, value: now ?? "", min: point.low ?? undefined, max: point.high ?? undefined });
    const row = h("div", { class: "row what-if-row" }, h("span", { class: "grow" }, label), input, h("span", { class: "muted unit" }, point.unit),
      h("button", { type: "button", class: "quiet small", "aria-label": `Remove ${label}`, onclick: () => { this.changes.delete(label); this.show(); } }, "×"));
    this.changes.set(label, { names, input, row });
    this.show();
    input.focus();
  }

  show() { refill(this.rows, [...this.changes.values()].map(({ row }) => row)); }

  /** The question, or null if nothing is to be tried. */
  question() {
    const values = {};
    for (const { names, input } of this.changes.values()) for (const name of names) values[name] = Number(input.value);
    if (Object.keys(values).length) return { values };
    toast("Add an actuator and its value first.", true);
    return null;
  }
}

/** A controller and its parameters, from its schema. */
class ControllerForm {
  constructor(root, node) {
    this.root = root;
    this.node = node;
    this.parameters = {};
    fill(root, h("p", { class: "muted", role: "status" }, "…"));
  }

  async load() {
    if (this.list) return;
    try {
      ({ controllers: this.list, tuned: this.tuned } = await get(nodePath(this.node, "controllers")));
    } catch (error) { fill(this.root, h("p", { class: "problem", role: "alert" }, error.message)); return; }
    const fitting = this.list.filter((each) => !each.problem);
    const unfit = this.list.filter((each) => each.problem);
    this.choice = h("select", { id: "what-if-controller", onchange: () => this.choose() }, fitting.map((each) => h("option", { value: each.name }, each.name)));
    this.choice.value = (fitting.find((each) => each.name === "rbc") ?? fitting[0]).name;
    this.summary = h("p", { class: "hint", id: "what-if-controller-summary" });
    this.choice.setAttribute("aria-describedby", this.summary.id);
    this.presets = h("div");
    this.form = h("div", { class: "form" });
    this.details = h("details", {}, h("summary", {}, "Parameters"), this.form);
    fill(this.root, h("div", {}, h("label", { for: "what-if-controller" }, "Controller"), h("div", { class: "row" }, this.choice), this.summary), this.presets, this.details,
      unfit.length > 0 && h("details", {}, h("summary", {}, "Controllers that do not suit this node"), h("ul", { class: "log" }, unfit.map((each) => h("li", {}, h("strong", {}, each.name), `: ${each.problem}`)))));
    this.choose();
  }

  choose() {
    const { name: chosen, summary, schema } = this.chosen();
    this.parameters = {};
    setText(this.summary, plain(summary));
    const tuned = this.tuned.filter((each) => each.name === chosen);
    const preset = h("select", { id: "what-if-preset", onchange: () => this.fill(tuned[preset.value]?.parameters ?? {}) },
      h("option", { value: "" }, "defaults"), tuned.map((each, place) => h("option", { value: place }, `tuned by study ${each.study || "of the folder"}`)));
    fill(this.presets, tuned.length > 0 && [h("label", { for: "what-if-preset" }, "Begin with"), h("div", { class: "row" }, preset)]);
    const fields = Object.entries(schema.properties);
    this.details.hidden = !fields.length;
    this.details.open = Boolean(schema.required?.length);
    this.fields = new Map(fields.map(([name, each]) => [name, field(name, { ...each, description: plain(each.description ?? "") }, schema, (value) => {
      if (value === undefined) delete this.parameters[name]; else this.parameters[name] = value;
    })]));
    fill(this.form, [...this.fields.values()].map((each) => each.element));
  }

  /** Show these parameters, and the defaults of all others. */
  fill(parameters) {
    this.parameters = { ...parameters };
    for (const [name, each] of this.fields) each.set(parameters[name]);
    this.details.open = this.details.open || Object.keys(parameters).length > 0;
  }

  chosen() { return this.list.find((each) => each.name === this.choice.value); }

  /** The question, or null if the controller lacks a parameter that has no default. */
  question() {
    if (!this.choice) return null;
    const missing = (this.chosen().schema.required ?? []).filter((name) => !(name in this.parameters));
    if (!missing.length) return { controller: { name: this.choice.value, parameters: this.parameters } };
    this.details.open = true;
    toast(`${this.choice.value} needs ${missing.map(words).join(", ")}.`, true);
    return null;
  }
}

const sentence = (text) => text.slice(0, 1).toUpperCase() + text.slice(1);

/** A docstring's sentence for people who do not write Python. */
const plain = (text) => text.replaceAll("`", "").replace(/\bNone:/g, "empty:");
