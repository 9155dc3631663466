// Panels of a node: alarms, events, controllers, faults.

import { operate, toast } from "./api.js";
import { fill, h, openDialog, refill, setText } from "./dom.js";
import { bytes, duration, exact, num, shortTime, shown, withUnit, words } from "./format.js";
import { forOperators, mayChange, refusal, refusalNote } from "./session.js";
import { change } from "./view.js";

const ORDER = ["active", "returned", "acknowledged", "shelved", "out_of_service", "suppressed"];

export class AlarmPanel {
  constructor(root, node, description) {
    this.root = root;
    this.node = node;
    this.points = new Map(description.points.map((point) => [point.id, point]));
    this.list = h("ul", { class: "alarms" });
    this.items = new Map();
    this.text = "";
  }

  update(state) {
    const alarms = (state.alarms ?? []).filter((alarm) => alarm.state !== "normal");
    const text = JSON.stringify([alarms.map((alarm) => ({ ...alarm, value: this.condition(alarm) })), state.alarms?.length]);
    if (text === this.text || this.root.contains(document.activeElement) && document.activeElement.matches("input, select")) return;
    this.text = text;
    alarms.sort((a, b) => ORDER.indexOf(a.state) - ORDER.indexOf(b.state) || (b.raised > a.raised ? 1 : -1));
    refill(this.list, alarms.map((alarm) => this.item(alarm)));
    refill(this.root, alarms.length ? this.list
      : h("p", { class: "empty" }, state.alarms?.length ? state.alarms.length === 1 ? "The alarm is normal." : `All ${state.alarms.length} alarms are normal.` : refusal() ? "No alarms are known here." : "This node has no alarm rules. Start it with --alarms FILE.yaml."));
  }

  /** The item of an alarm; the same one for as long as only its value changes. */
  item(alarm) {
    const text = JSON.stringify({ ...alarm, value: null }), previous = this.items.get(alarm.alarm);
    const item = previous?.text === text ? previous : { text, ...this.newItem(alarm) };
    setText(item.condition, this.condition(alarm));
    this.items.set(alarm.alarm, item);
    return item.element;
  }

  condition(alarm) {
    const limit = alarm.event_state === "low_limit" ? alarm.low : alarm.high;
    const point = this.points.get(alarm.point) ?? { unit: alarm.unit };
    const value = withUnit(shown(point, alarm.value), point.unit);
    return { normal: `${value}, normal again`, fault: "value is missing" }[alarm.event_state] ?? `${value}, ${words(alarm.event_state)} ${exact(shown(point, limit), point.unit)}`;
  }

  newItem(alarm) {
    const condition = h("span");
    const set = async (operation, content = {}) => { await operate(this.node, operation, { alarm: alarm.alarm, ...content }); };
    const longest = Math.min(14400, alarm.max_shelve_s);
    const element = h("li", { class: alarm.is_open ? "open" : null },
      h("div", { class: "row wrap" },
        h("span", { class: `chip ${alarm.is_open ? "alarm" : "muted"}` }, words(alarm.state)),
        h("button", { class: "plain", onclick: () => change({ point: alarm.point }) }, alarm.alarm),
        h("span", { class: "grow" }),
        h("span", { class: "muted" }, alarm.priority)),
      h("p", {}, condition,
        alarm.raised && ` · since ${shortTime(alarm.raised)}`, alarm.acknowledged_by && ` · acknowledged by ${alarm.acknowledged_by}`,
        alarm.set_aside_by && ` · ${words(alarm.state)} by ${alarm.set_aside_by}`, alarm.set_aside_until && ` until ${shortTime(alarm.set_aside_until)}`),
      alarm.text && h("p", { class: "muted" }, alarm.text),
      (alarm.comment || alarm.set_aside_comment) && h("p", { class: "muted" }, `“${alarm.set_aside_comment || alarm.comment}”`),
      h("div", { class: "row wrap" },
        alarm.is_open && h("button", forOperators({ class: "small primary", "aria-label": `Acknowledge ${alarm.alarm}`, onclick: () => this.ask("Acknowledge", alarm, (comment) => set("acknowledge", { comment })) }), "Acknowledge"),
        alarm.state === "shelved" ? h("button", forOperators({ class: "small", "aria-label": `Unshelve ${alarm.alarm}`, onclick: () => set("unshelve") }), "Unshelve")
          : alarm.state !== "out_of_service" && longest > 0 && h("button", forOperators({ class: "small", "aria-label": `Shelve ${duration(longest)}: ${alarm.alarm}`, onclick: () => this.ask(`Shelve for ${duration(longest)}`, alarm, (comment) => set("shelve", { duration_s: longest, comment })) }), `Shelve ${duration(longest)}`)));
    return { element, condition };
  }

  ask(title, alarm, act) {
    const comment = h("input", { id: "comment", maxlength: 500, autocomplete: "off" });
    openDialog({ title, submit: () => act(comment.value) }, h("p", {}, alarm.alarm),
      h("label", { for: "comment" }, "Comment, for the record"), comment);
  }
}

export class EventPanel {
  constructor(root) {
    this.list = h("ol", { class: "log" });
    this.empty = h("p", { class: "empty" }, "Nothing has happened since the control room was started.");
    fill(root, this.empty, this.list);
  }

  show(events) {
    this.empty.hidden = events.length > 0;
    const latest = events.slice(-200).reverse();
    const numbers = latest.map((event) => event.number).join();
    if (numbers === this.numbers) return;
    this.numbers = numbers;
    fill(this.list, latest.map(eventItem));
  }
}

/** An event with its time, kind, text and source, as an item of a list. */
export function eventItem(event) {
  return h("li", { "data-number": event.number }, h("time", {}, shortTime(event.time)), " ",
    h("span", { class: `kind ${event.kind}` }, words(event.kind)), " ", event.text, event.source && h("em", {}, ` ${event.source}`));
}

export class ControllerPanel {
  constructor(root) { this.root = root; this.text = ""; }

  update(state) {
    const { controllers = [], counts, step_time: step } = state;
    const text = JSON.stringify([controllers, counts, step]);
    if (text === this.text) return;
    this.text = text;
    const heads = [["Controller", ""], ["State", ""], ["Priority", "number"], ["Accepted", "number"], ["Late", "number"], ["Missed", "number"], ["Response, ms", "number"]];
    fill(this.root,
      controllers.length ? h("table", {}, h("thead", {}, h("tr", {}, heads.map(([name, kind]) => h("th", { scope: "col", class: kind || null }, name)))),
        h("tbody", {}, controllers.map((each) => h("tr", {}, h("th", { scope: "row" }, each.controller),
          h("td", {}, h("span", { class: `chip ${each.state === "connected" ? "good" : "alarm"}` }, words(each.state))),
          [each.priority, each.accepted, each.late, each.missed].map((value) => h("td", { class: "number" }, num(value, "people"))),
          h("td", { class: "number", title: "median; 99th percentile" }, `${num(each.response.median_ms)}; ${num(each.response.p99_ms)}`)))))
        : h("p", { class: "empty" }, "No controller has a claim; the building is under baseline control where nobody has written."),
      step && h("dl", { class: "facts" },
        h("dt", {}, "A timestep takes"), h("dd", {}, `${num(step.median_ms)} ms, 99 % within ${num(step.p99_ms)} ms`),
        h("dt", {}, "Messages"), h("dd", {}, `${num(counts.accepted, "people")} accepted, ${counts.rejected} rejected, ${counts.late} late, ${counts.duplicate} duplicate`),
        h("dt", {}, "Late timesteps"), h("dd", {}, `${state.overruns}, at most ${num(state.max_lag_s)} s`),
        h("dt", {}, "Memory"), h("dd", {}, bytes(state.memory_bytes))));
  }
}

const FAULTS = { bias: ["offset", "Offset"], gain: ["factor", "Factor"], drift: ["rate_per_h", "Change per hour"], noise: ["sigma", "Standard deviation"], stuck: ["value", "Value"], quantize: ["resolution", "Resolution"], freeze: null, drop: null };

/** Unit of a fault's parameter: a difference of temperatures is in K. */
function unitOf(kind, point) {
  if (kind === "gain" || !point) return "";
  return point.unit === "°C" && kind !== "stuck" ? "K" : point.unit;
}

export class FaultPanel {
  constructor(root, node, description) {
    this.node = node;
    this.points = new Map(description.points.map((point) => [point.id, point]));
    this.plan = { faults: [] };
    this.active = h("p", { role: "status" });
    this.list = h("ul", { class: "log", "aria-label": "Injected faults" });
    this.kind = h("select", { id: "fault-kind", onchange: () => this.label() }, Object.keys(FAULTS).map((kind) => h("option", {}, kind)));
    this.point = h("input", { id: "fault-point", list: "fault-points", required: true, autocomplete: "off", oninput: () => this.label() });
    const options = h("datalist", { id: "fault-points" }, description.points.slice(0, 2000).map((point) => h("option", { value: point.id })));
    this.value = h("input", { id: "fault-value", type: "number", step: "any", required: true, value: 2 });
    this.valueLabel = h("label", { for: "fault-value" });
    this.valueField = h("div", {}, this.valueLabel, this.value);
    const add = (event) => {
      event.preventDefault();
      const point = this.points.get(this.point.value);
      if (!point) { toast(`There is no point ${this.point.value}.`, true); return; }
      const kind = this.kind.value;
      const fault = { kind, [point.kind === "actuator" ? "actuators" : "points"]: [point.name] };
      if (FAULTS[kind]) fault[FAULTS[kind][0]] = Number(this.value.value) / (kind === "gain" ? 1 : point.factor ?? 1);
      this.send([...this.plan.faults, fault]);
    };
    fill(root, this.active, this.list,
      mayChange() ? h("form", { class: "stack", onsubmit: add },
        h("div", { class: "fields" },
          h("div", {}, h("label", { for: "fault-point" }, "Point"), this.point, options),
          h("div", {}, h("label", { for: "fault-kind" }, "Fault"), this.kind), this.valueField),
        h("div", { class: "row end" },
          h("button", { type: "button", onclick: () => this.send([]) }, "End all faults"),
          h("button", { class: "primary" }, "Inject"))) : refusalNote());
    this.label();
  }

  /** Name the field of the value after the fault, in the unit in which the page shows the point. */
  label() {
    const parameter = FAULTS[this.kind.value];
    this.valueField.hidden = this.value.disabled = !parameter;
    if (!parameter) return;
    const unit = unitOf(this.kind.value, this.points.get(this.point.value));
    setText(this.valueLabel, unit ? `${parameter[1]}, ${unit}` : parameter[1]);
  }

  async send(faults) {
    const { plan } = this;
    if (await operate(this.node, "faults", { plan: { ...plan, faults }, replaces: plan })) { this.plan = { ...plan, faults }; this.show(); }
  }

  /** A fault of the plan in words, with its values in the units that the page shows. */
  text({ kind, points = [], actuators = [], when, name, ...values }) {
    const [point, ...others] = [...points.map((id) => this.points.get(id)), ...actuators.map((name) => this.points.get(`actuator/${name}`) ?? this.points.get(name))];
    const linear = point && !others.length && kind !== "gain";
    const parts = Object.entries(values).map(([key, value]) => `${words(key)} ${linear && FAULTS[kind]?.[0] === key ? withUnit(value * (point.factor ?? 1), unitOf(kind, point)) : JSON.stringify(value)}`);
    return [name ? `${name}: ${kind}` : kind, [...points, ...actuators].join(", "), ...parts, when && `when ${JSON.stringify(when)}`].filter(Boolean).join(", ");
  }

  show() {
    const { faults } = this.plan;
    const label = (fault) => `End ${this.text(fault)}`;
    refill(this.list, faults.map((fault, place) => h("li", { class: "row" }, h("span", {}, this.text(fault)), h("span", { class: "grow" }),
      h("button", forOperators({ class: "small", "aria-label": label(fault), onclick: () => this.send(faults.filter((_, other) => other !== place)) }), "End"))));
  }

  update(state) {
    setText(this.active, state.faults?.length ? `Active now: ${state.faults.join(", ")}` : "No injected fault is active.");
    const text = JSON.stringify(state.fault_plan);
    if (text === this.shownPlan) return;
    this.shownPlan = text;
    if (text === JSON.stringify(this.plan)) return;
    this.plan = state.fault_plan ?? { faults: [] };
    this.show();
  }
}

export function recordDialog(node, state) {
  const now = new Date().toISOString().slice(0, 16).replace(/[:T]/g, "-");
  const path = h("input", { id: "path", required: true, value: `/tmp/${node}-${now}.mcap`, spellcheck: "false" });
  const immediately = h("input", { id: "now", type: "checkbox", checked: true });
  openDialog({ title: "Record", submit: () => operate(node, "record", { path: path.value, now: immediately.checked }) },
    h("label", { for: "path" }, "File on the node's machine"), path,
    h("label", { class: "row" }, immediately, "at once (otherwise from the next reset, so that it can be verified)"),
    state.recording && h("p", { class: "muted" }, `Latest: ${state.recording.path}, ${words(state.recording.state)}`));
}
