// The scenario builder: a form from the schema of scenarios, the check of the command line, the YAML, and nodes from it.

import { Failure, copyText, get, post, toast } from "./api.js";
import { BuilderPoints } from "./builder_points.js";
import { fill, h, openDialog, panel, setText } from "./dom.js";
import { counted } from "./format.js";
import { field, names, resolve } from "./schema_form.js";
import { address, change, link, view } from "./view.js";

const MAIN = ["building", "weather", "begin", "end", "steps_per_hour", "time"];
const OWN = [...MAIN, "sensors", "meters", "actuators", "actions", "control", "relative", "discrete", "reward"];
const DRAFT = "scenario-draft";
const EXAMPLE = { building: "office-small", weather: ["USA_CO_Denver"], begin: "07-01", end: "07-07" };

export class BuilderPage {
  constructor(root) {
    this.root = root;
    this.online = new Set();
    this.started = [];
    this.handlers = { overview: (content) => { this.online = new Set(content.nodes.filter((each) => each.online).map((each) => each.node)); this.showStarted(); }, started: (content) => { this.started = content.nodes; this.showStarted(); } };
    fill(root, h("p", { class: "empty", role: "status" }, "…"));
    this.load();
  }

  async load() {
    try {
      this.form = await get("/api/builder");
      const { scenario } = view();
      const { fields, digest } = scenario ? await get(`/api/builder/scenario?${new URLSearchParams({ name: scenario })}`) : { fields: draft() };
      Object.assign(this, { fields, digest });
      if (!this.isClosed) this.build(scenario ?? "scenario");
    } catch (error) { if (!this.isClosed) fill(this.root, h("p", { class: "problem", role: "alert" }, error.message)); }
  }

  onView() {
    if ((view().scenario ?? null) !== (this.opened ?? null)) this.load();
  }

  close() { this.isClosed = true; clearTimeout(this.timer); }

  build(name) {
    this.opened = view().scenario ?? null;
    const { form } = this;
    this.inputs = {};
    const own = (field) => this.field(field);
    const buildings = [...form.own_buildings, ...form.buildings];
    const weathers = [...form.own_weathers, ...form.weathers];
    const points = h("div");
    this.rewardParameters = h("div", { class: "form" });
    this.actionRows = h("div", { class: "stack" });
    const more = Object.keys(form.schema.properties).filter((each) => !OWN.includes(each));
    fill(this.root, h("div", { class: "builder" },
      h("form", { class: "stack", onsubmit: (event) => event.preventDefault() },
        panel("Building and weather", {},
          h("datalist", { id: "buildings" }, buildings.map((value) => h("option", { value }))),
          h("datalist", { id: "weathers" }, weathers.map((value) => h("option", { value }))),
          h("div", { class: "form" }, this.field("building", "buildings"), this.field("weather", "weathers"), own("begin"), own("end"), own("steps_per_hour"), own("time"))),
        panel("Points", {}, points),
        panel("Actions", {}, h("div", { class: "form" }, own("control"), own("relative"), own("discrete")), h("h3", {}, "Dimensions"), this.actionRows),
        panel("Reward", {}, this.rewardKind(), this.rewardParameters),
        h("details", { class: "panel" }, h("summary", {}, "More fields"), h("div", { class: "form" }, more.map(own)))),
      h("div", { class: "stack builder-side" }, this.sheet(name), this.files(), form.can_start ? this.starter() : h("p", { class: "muted" }, "To save scenarios and to start nodes from them, start the control room with ", h("code", {}, "--scenarios FOLDER"), "."), this.startedPanel())));
    this.points = new BuilderPoints(points, { building: () => this.fields.building, get: (each) => this.fields[each], set: (each, value) => { this.set(each, value); if (each === "actuators") this.showActions(); } });
    for (const [each, input] of Object.entries(this.inputs)) input.set(this.fields[each]);
    this.showReward();
    this.showActions();
    this.showStarted();
    this.check();
  }

  field(name, list = null) {
    const built = field(name, this.form.schema.properties[name], this.form.schema, (value) => this.set(name, value), { list });
    this.inputs[name] = built;
    return built.element;
  }

  set(name, value) {
    if (value === undefined) delete this.fields[name]; else this.fields[name] = value;
    try { sessionStorage.setItem(DRAFT, JSON.stringify(this.fields)); } catch { /* private windows */ }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(), 500);
  }

  // Actions: rows of names, their actuators and bounds

  showActions() {
    const { actions } = this.fields;
    const rows = Object.entries(actions ?? {}).map(([name, spec]) => this.action(name, Array.isArray(spec) ? { actuators: spec } : spec));
    const add = () => { let name = "action"; for (let number = 2; name in (this.fields.actions ?? {}); number += 1) name = `action_${number}`; this.set("actions", { ...(this.fields.actions ?? {}), [name]: { actuators: Object.keys(this.fields.actuators ?? {}).slice(0, 1) } }); this.showActions(); };
    fill(this.actionRows, rows.length ? rows : h("p", { class: "muted" }, "By default one for each actuator, or as the default actions say."),
      h("div", { class: "row" }, h("button", { type: "button", class: "small", onclick: add }, "Add a dimension")));
  }

  action(name, spec) {
    const update = (changes, next = name) => {
      const all = Object.entries(this.fields.actions).map(([each, old]) => (each === name ? [next, clean({ ...spec, ...changes })] : [each, old]));
      Object.assign(spec, changes);
      this.set("actions", Object.fromEntries(all));
    };
    const rename = (event) => { const next = event.target.value.trim(); if (!next || next in this.fields.actions) { event.target.value = name; return; } update({}, next); this.showActions(); };
    const bound = (field) => h("input", { type: "number", step: "any", class: "bound", "aria-label": `${field} of ${name}`, placeholder: field, value: spec[field] ?? "", onchange: (event) => update({ [field]: event.target.value === "" ? undefined : Number(event.target.value) }) });
    const remove = () => { const { [name]: _, ...others } = this.fields.actions; this.set("actions", Object.keys(others).length ? others : undefined); this.showActions(); };
    return h("div", { class: "chosen-point" },
      h("input", { "aria-label": `Name of the action ${name}`, value: name, maxlength: 128, spellcheck: "false", onchange: rename }),
      h("input", { class: "grow", "aria-label": `Actuators of ${name}`, value: (spec.actuators ?? []).join(", "), placeholder: "names of actuators, separated by commas", spellcheck: "false", onchange: (event) => update({ actuators: names(event.target.value) }) }),
      bound("low"), bound("high"),
      h("button", { type: "button", class: "quiet small", "aria-label": `Remove ${name}`, onclick: remove }, "×"));
  }

  // Reward: a kind, and its parameters from the schema

  rewards() {
    const { schema } = this.form;
    return (schema.properties.reward.anyOf ?? []).map((each) => resolve(each, schema)).filter((each) => each.properties?.kind);
  }

  rewardKind() {
    const kinds = this.rewards().map((each) => each.properties.kind.const ?? each.properties.kind.default);
    const choose = () => { this.set("reward", select.value === "" ? undefined : select.value === "null" ? null : { kind: select.value }); this.showReward(); };
    const select = h("select", { id: "reward-kind", onchange: choose }, h("option", { value: "" }, "default: linear"), kinds.map((kind) => h("option", { value: kind }, kind.replaceAll("_", " "))), h("option", { value: "null" }, "none: always 0"));
    this.rewardSelect = select;
    return h("div", { class: "form-field" }, h("label", { for: "reward-kind" }, "Kind"), select);
  }

  showReward() {
    const { reward } = this.fields;
    const kind = reward === null ? "null" : typeof reward === "string" ? reward : reward?.kind ?? "";
    this.rewardSelect.value = kind;
    const schema = this.rewards().find((each) => (each.properties.kind.const ?? each.properties.kind.default) === kind);
    fill(this.rewardParameters, schema && Object.entries(schema.properties).filter(([name]) => name !== "kind").map(([name, each]) => {
      const built = field(name, each, this.form.schema, (value) => { const next = { kind, ...(typeof this.fields.reward === "object" ? this.fields.reward : {}) }; if (value === undefined) delete next[name]; else next[name] = value; this.set("reward", next); });
      built.set(reward?.[name]);
      return built.element;
    }));
  }

  // The sheet: errors and YAML

  sheet(name) {
    this.status = h("p", { role: "status" });
    this.errors = h("ul", { class: "check-errors", "aria-live": "polite", "aria-label": "Errors" });
    this.yaml = h("pre", { tabindex: 0, role: "region", "aria-label": "Scenario as YAML" });
    this.name = h("input", { id: "scenario-name", value: name, maxlength: 64, pattern: "[A-Za-z0-9_][A-Za-z0-9_.\\-]*", spellcheck: "false", autocomplete: "off", oninput: () => { clearTimeout(this.timer); this.timer = setTimeout(() => this.check(), 500); } });
    const buttons = [
      h("button", { type: "button", onclick: () => copyText(this.yaml) }, "Copy"),
      h("button", { type: "button", onclick: () => this.download() }, "Download"),
      this.form.can_start && h("button", { type: "button", onclick: () => this.save() }, "Save"),
      h("button", { type: "button", onclick: () => this.startAnew() }, "New")];
    return panel("Scenario", { "aria-busy": "false" }, h("div", { class: "stack" },
      h("div", {}, h("label", { for: "scenario-name" }, "Name of the file, without .yaml"), this.name), this.status, this.errors, this.yaml, h("div", { class: "row wrap end" }, buttons)));
  }

  /** Show the example, which belongs to no file yet. */
  startAnew() {
    this.fields = { ...EXAMPLE };
    this.set("building", EXAMPLE.building);
    this.opened = null;
    change({ scenario: null });
    this.build("scenario");
  }

  async check() {
    if (this.isChecking) { this.isStale = true; return; }
    this.isChecking = true;
    setText(this.status, "Checking …");
    try {
      const answer = await post("/api/builder/check", { fields: this.fields, name: this.name.value });
      if (this.isClosed) return;
      setText(this.yaml, answer.yaml);
      const count = answer.errors.length;
      setText(this.status, count ? counted(count, "error") : `No errors: ${answer.summary}`);
      this.status.className = count ? "problem" : "fine";
      fill(this.errors, answer.errors.map((text) => h("li", { class: "problem" }, text)), answer.warnings.map((text) => h("li", { class: "muted" }, `warning: ${text}`)));
    } catch (error) { setText(this.status, error.message); this.status.className = "problem"; } finally {
      this.isChecking = false;
      if (this.isStale) { this.isStale = false; this.check(); }
    }
  }

  download() {
    const url = URL.createObjectURL(new Blob([this.yaml.textContent], { type: "application/yaml" }));
    const anchor = h("a", { href: url, download: `${this.name.value || "scenario"}.yaml` });
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
  }

  /** Send the scenario with more fields; asks whether it replaces an earlier one. */
  async send(operation, more = {}) {
    const content = { fields: this.fields, name: this.name.value, ...(this.opened === this.name.value && { replaces: this.digest }), ...more };
    try {
      const { text, digest } = await post(`/api/builder/${operation}`, content);
      toast(text);
      this.digest = digest;
    } catch (error) {
      if (!(error instanceof Failure) || error.kind !== "NameInUse" || content.overwrite || !(await this.replaces(error.message))) { if (error) toast(error.message, true); return false; }
      return this.send(operation, { ...more, overwrite: true });
    }
    this.opened = this.name.value;
    change({ scenario: this.name.value }, { replace: true });
    return true;
  }

  replaces(text) {
    if (!text.endsWith("replace it")) return Promise.resolve(false);
    return new Promise((answer) => {
      const dialog = openDialog({ title: "Replace the scenario", action: "Replace", submit: () => answer(true) },
        h("p", {}, `${text.slice(0, 1).toUpperCase()}${text.slice(1)}.`));
      dialog.addEventListener("close", () => answer(false));
    });
  }

  async save() { if (await this.send("save")) this.form.scenarios = [...new Set([...this.form.scenarios, this.name.value])].sort(); this.showFiles(); }

  files() {
    this.fileList = h("div");
    this.showFiles();
    return this.fileList;
  }

  showFiles() {
    const { scenarios } = this.form;
    fill(this.fileList, scenarios.length > 0 && panel("Saved scenarios", {}, h("ul", { class: "saved" }, scenarios.map((name) => h("li", {},
      h("a", { href: address({ page: "builder", scenario: name }, false), onclick: (event) => link(event, { page: "builder", scenario: name }) }, name))))));
  }

  // Nodes from scenarios

  starter() {
    const node = h("input", { id: "node-name", value: "office", maxlength: 128, spellcheck: "false", autocomplete: "off", required: true });
    const mode = h("select", { id: "node-mode", onchange: () => { speedField.hidden = mode.value !== "paced"; } }, ["paced", "lockstep", "free"].map((each) => h("option", {}, each)));
    const speed = h("input", { id: "node-speed", type: "number", min: 0, step: "any", value: 60, required: true });
    const speedField = h("div", {}, h("label", { for: "node-speed" }, "Times the wall clock"), speed);
    const start = async (event) => {
      event.preventDefault();
      button.disabled = true;
      await this.send("start", { node: node.value.trim(), mode: mode.value, ...(mode.value === "paced" && { speed: Number(speed.value) }) });
      button.disabled = false;
    };
    const button = h("button", { class: "primary" }, "Save and start");
    return panel("Start a node", {}, h("form", { class: "stack", onsubmit: start },
      h("div", { class: "fields" }, h("div", {}, h("label", { for: "node-name" }, "Name on the bus"), node), h("div", {}, h("label", { for: "node-mode" }, "Mode"), mode), speedField),
      h("p", { class: "muted" }, "It joins this bus, and ends with the control room."), h("div", { class: "row end" }, button)));
  }

  startedPanel() {
    this.startedList = h("ul", { class: "started" });
    return this.startedBox = panel("Nodes from this page", { hidden: true }, this.startedList);
  }

  showStarted() {
    if (!this.startedBox) return;
    this.startedBox.hidden = !this.started.length;
    const end = async (node) => { try { toast((await post("/api/builder/stop", { node })).text); } catch (error) { toast(error.message, true); } };
    fill(this.startedList, [...this.started].reverse().map((each) => {
      const isRunning = each.state === "running" || each.state === "starting";
      const kind = { running: "good", failed: "alarm", starting: "warning" }[each.state] ?? "muted";
      return h("li", {}, h("div", { class: "row wrap" },
        this.online.has(each.name) && isRunning ? h("a", { href: address({ node: each.name }, false), onclick: (event) => link(event, { node: each.name }) }, `Open ${each.name}`) : h("span", {}, each.name),
        h("span", { class: `chip ${kind}` }, each.state), h("span", { class: "muted grow" }, `${each.scenario}, ${each.operator}`),
        isRunning && h("button", { type: "button", class: "small", "aria-label": `End ${each.name}`, onclick: () => end(each.name) }, "End")),
      each.text && h("p", { class: "problem" }, each.text));
    }));
  }
}

/** The scenario of this tab that was not saved, or an example to start from. */
function draft() {
  try { return JSON.parse(sessionStorage.getItem(DRAFT)) ?? { ...EXAMPLE }; } catch { return { ...EXAMPLE }; }
}

const clean = (spec) => Object.fromEntries(Object.entries(spec).filter(([, value]) => value !== undefined && value !== null));
