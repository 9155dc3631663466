// The page of one node.

import { get, nodePath, operate } from "./api.js";
import { fill, h, icon, openDialog, panel, setAttribute, setText } from "./dom.js";
import { counted, dateTime, rate, withUnit } from "./format.js";
import { nodeState, pace } from "./overview.js";
import { AlarmPanel, ControllerPanel, EventPanel, FaultPanel, recordDialog } from "./panels.js";
import { Plans } from "./plan.js";
import { PointPanel } from "./point.js";
import { PointTable, ZoneTable } from "./points.js";
import { District } from "./district.js";
import { Schematic } from "./schematic.js";
import { forOperators, mayChange, refusal, showsReplay } from "./session.js";
import { Trends } from "./trends.js";
import { change, view } from "./view.js";
import { WhatIfPanel } from "./what_if.js";

const SPEEDS = [1, 2, 5, 10, 30, 60, 300, 900, 1800, 3600, 7200, 14400, 43200, 86400, 604800];
const TABS = [["alarms", "Alarms"], ["events", "Events"], ["what-if", "What if"], ["controllers", "Controllers"], ["faults", "Faults"]];

export class NodePage {
  constructor(root, node, operator) {
    this.root = root;
    this.node = node;
    this.operator = operator;
    this.state = null;
    this.description = null;
    this.entry = null;
    this.events = [];
    this.handlers = {
      overview: (content) => this.onOverview(content.nodes),
      node: (state) => this.onState(state),
      events: (content) => this.onEvents(content.events),
    };
    fill(root, h("p", { class: "empty", role: "status" }, `Waiting for node ${node} …`));
  }

  close() {
    this.isClosed = true;
    this.root.classList.remove("stale");
    showsReplay(false);
    this.trends?.close();
    this.schematic?.close();
    this.drawer?.close();
  }

  redraw() { this.trends?.draw(); }

  onKey(event) {
    if (!mayChange()) return;
    if (event.target.closest("button, a, summary, [role=button]") && (event.key === " " || event.key === "Enter")) return;
    if (event.target.matches("[data-kept]")) return;  // a list that kept the focus of a button that is gone
    const scrolls = event.shiftKey || event.target.matches(".scroll:focus-visible");  // the browser, by a space
    if (event.key === " " && !scrolls) { event.preventDefault(); if (!event.repeat) this.togglePause(); }
    if (event.key === "." && !event.repeat && this.state?.paused) operate(this.node, "step", { steps: 1 });
  }

  async describe(instance) {
    if (this.describing === instance) return;
    this.describing = instance;
    try {
      const description = await get(nodePath(this.node));
      if (this.isClosed) return;
      this.description = description;
      showsReplay(description.replay);
      this.build();
    } catch (error) {
      this.describing = null;
      if (!this.description) fill(this.root, h("p", { class: "empty problem", role: "alert" }, error.message));
    }
  }

  onOverview(nodes) {
    this.entry = nodes.find((entry) => entry.node === this.node) ?? null;
    this.online = new Map(nodes.filter((entry) => entry.online).map((entry) => [entry.node, entry]));
    this.district?.onOverview(this.online);
    if (this.state && this.description) this.showEntry();
    if (!this.entry && !this.description) fill(this.root, h("p", { class: "empty", role: "status" }, `No node ${this.node} is on this bus.`));
  }

  onState(state) {
    if (!state.online) {
      if (this.description) {
        this.problem.hidden = false;
        setText(this.problem, state.has_ended ? "The node has ended. The page continues if it is started again." : `Not reachable: ${state.problem}. The page continues when the node is back.`);
        setAttribute(this.problem, "class", `banner${state.has_ended ? "" : " problem"}`);
        this.root.classList.add("stale");
        this.gone = state;
        this.showEntry();
      }
      this.describing = null;
      return;
    }
    this.state = state;
    this.gone = null;
    if (!this.description || this.description.instance !== state.instance) { this.describe(state.instance); if (!this.description) return; }
    if (this.description.instance === state.instance) this.update();
  }

  /** Take the latest events from the stream; if they do not follow those that are known, request all. */
  onEvents(events) {
    if (!events.length) return;
    if (events.at(-1).number < this.events.at(-1)?.number) this.events = [];  // of an earlier server
    this.lacksEvents ||= events[0].number > (this.events.at(-1)?.number ?? 0) + 1;
    this.addEvents(events);
    if (this.lacksEvents) this.loadEvents();
  }

  async loadEvents() {
    if (this.isLoadingEvents) return;
    this.isLoadingEvents = true;
    try {
      while (this.lacksEvents && !this.isClosed) {
        this.lacksEvents = false;
        this.addEvents((await get(nodePath(this.node, "events"))).events);
      }
    } catch { this.lacksEvents = true; } finally { this.isLoadingEvents = false; }  // again with the next event
  }

  addEvents(events) {
    const known = new Map([...this.events, ...events].map((event) => [event.number, event]));
    this.events = [...known.values()].sort((a, b) => a.number - b.number).slice(-500);
    this.showEvents();
  }

  showEvents() {
    this.eventPanel?.show(this.events);
    this.drawer?.showEvents(this.events);
  }

  build() {
    const { description } = this;
    this.trends?.close();
    this.schematic?.close();
    this.drawer?.close();
    this.drawer = null;
    const select = (zone) => change({ zone, trend: null }, { replace: true });
    this.problem = h("p", { class: "banner problem", role: "alert", hidden: true });
    this.warnings = description.warnings.length ? h("details", { class: "banner" }, h("summary", {}, `${counted(description.warnings.length, "warning")} of the node`), h("ul", {}, description.warnings.slice(0, 50).map((text) => h("li", {}, text)))) : null;
    this.frame = h("div", { class: "node" });
    const grid = h("div", { class: "grid" });
    fill(this.root, this.bar(), this.problem, this.warnings, this.frame);
    this.frame.append(this.tiles(), grid);

    this.plans = null;
    if (description.storeys.length) {
      const body = h("div");
      grid.append(panel("Zones against the band", { class: "panel plan-panel" }, body));
      this.plans = new Plans(body, description, select);
    }
    const tables = panel("Points", { class: `panel table-panel${description.storeys.length ? "" : " full"}` });
    const zonesBody = h("div", { class: "scroll", role: "tabpanel", tabindex: "0", "aria-label": "Zones" });
    const pointsBody = h("div", { class: "scroll", role: "tabpanel", tabindex: "0", "aria-label": "All points" });
    this.tableTabs = this.tabs("table", description.zones.length ? [["zones", "Zones", zonesBody], ["points", "All points", pointsBody]] : [["points", "All points", pointsBody]]);
    tables.append(this.tableTabs.element, zonesBody, pointsBody);
    grid.append(tables);
    this.zoneTable = description.zones.length ? new ZoneTable(zonesBody, description, select) : null;
    this.pointTable = new PointTable(pointsBody, description, (id) => this.trends.toggle(id));

    const trendBody = h("div");
    grid.append(panel("Trends", { class: "panel trend-panel" }, trendBody));
    this.trends = new Trends(trendBody, this.node, description);

    const bodies = Object.fromEntries(TABS.map(([name, text]) => [name, h("div", { class: "scroll", role: "tabpanel", tabindex: "0", "aria-label": text })]));
    this.tabTabs = this.tabs("tab", TABS.map(([name, text]) => [name, text, bodies[name]]));
    grid.append(panel("Operation", { class: "panel tab-panel" }, this.tabTabs.element, Object.values(bodies)));
    this.alarmPanel = new AlarmPanel(bodies.alarms, this.node, description);
    this.eventPanel = new EventPanel(bodies.events);
    this.controllerPanel = new ControllerPanel(bodies.controllers);
    this.faultPanel = new FaultPanel(bodies.faults, this.node, description);
    this.whatIfPanel = new WhatIfPanel(bodies["what-if"], this.node, description);
    this.district = null;
    if (description.systems?.grids.length || description.systems?.members.length) {
      const body = h("div");
      grid.prepend(panel(description.systems.members.length ? "District" : "Electric grid", { class: "panel district-panel" }, body));
      this.district = new District(body, this.node, description);
      this.district.onOverview(this.online ?? new Map());
    }
    this.schematic = null;
    if (description.systems?.loops.length || description.systems?.zones.length) {
      const body = h("div");
      grid.append(panel("Systems", { class: "panel systems-panel" }, body));
      this.schematic = new Schematic(body, description);
    }
    this.onView();
    this.showEvents();
    if (this.state) this.update();
  }

  /** Tabs whose choice is the parameter `parameter` of the address. */
  tabs(parameter, entries) {
    const buttons = entries.map(([name, text]) => h("button", { role: "tab", "data-tab": name, onclick: () => change({ [parameter]: name === entries[0][0] ? null : name }, { replace: true }) }, text));
    const element = h("div", { class: "tabs", role: "tablist", "aria-label": parameter === "tab" ? "Operation" : "Tables" }, buttons);
    element.addEventListener("keydown", (event) => {
      const at = buttons.indexOf(document.activeElement);
      const next = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: buttons.length - 1 }[event.key];
      if (at < 0 || next === undefined) return;
      event.preventDefault();
      const button = buttons[(next + buttons.length) % buttons.length];
      button.click();
      button.focus();
    });
    return { element, buttons, show: () => {
      const wanted = view()[parameter];
      const chosen = entries.some(([name]) => name === wanted) ? wanted : entries[0][0];
      entries.forEach(([name, , body], place) => {
        body.hidden = name !== chosen;
        setAttribute(buttons[place], "aria-selected", String(name === chosen));
        setAttribute(buttons[place], "tabindex", name === chosen ? "0" : "-1");
        if (name === chosen) element.scrollLeft = Math.max(0, buttons[place].offsetLeft - element.offsetLeft - 24);  // on a phone
      });
    } };
  }

  bar() {
    const { description } = this;
    this.time = h("span", { class: "clock" });
    this.progress = h("progress", { max: description.steps });
    this.steps = h("span", { class: "muted" });
    this.chip = h("span", { class: "chip" });
    this.paceText = h("span", { class: "muted" });
    const building = h("span", { class: "muted" }, [description.building, description.location || description.weather].filter(Boolean).join(" · "));
    this.pauseButton = h("button", forOperators({ class: "transport", onclick: () => this.togglePause() }));
    this.stepButton = h("button", forOperators({ class: "transport", "aria-label": "One timestep", title: "One timestep (.)", onclick: () => operate(this.node, "step", { steps: 1 }) }), icon("step"));
    this.mode = h("select", forOperators({ "aria-label": "Mode", onchange: () => this.setPace(this.state.speed) }), ["lockstep", "paced", "free"].map((mode) => h("option", { value: mode }, mode)));
    this.speed = h("input", forOperators({ type: "range", min: 0, max: SPEEDS.length - 1, step: 1, "aria-label": "Speed",
      oninput: () => { this.isSliding = true; this.showSpeed(); }, onchange: () => { this.isSliding = false; this.mode.value = "paced"; this.setPace(SPEEDS[this.speed.value]); } }));
    this.speedText = h("output", { class: "speed" });
    this.recordButton = h("button", forOperators({ class: "transport", onclick: () => this.toggleRecording() }), icon("record"));
    const reset = h("button", forOperators({ class: "transport", "aria-label": "Reset", title: "Begin a new episode",
      onclick: () => openDialog({ title: "Reset", submit: () => operate(this.node, "reset") },
        h("p", {}, `End this episode of ${this.node} and begin a new one? Its history starts anew.`)) }), icon("reset"));
    return h("section", { class: "bar panel", "aria-label": "Time" },
      h("div", { class: "bar-time" }, this.time, h("div", { class: "row" }, this.progress, this.steps), building),
      h("div", { class: "bar-state" }, this.chip, this.paceText),
      h("span", { class: "grow" }),
      h("div", { class: "row controls" }, this.pauseButton, this.stepButton,
        h("div", { class: "row pace" }, this.mode, this.speed, this.speedText), this.recordButton, reset));
  }

  tiles() {
    this.tileValues = new Map();
    const tile = (name, title) => { const value = h("dd"); this.tileValues.set(name, value); return h("div", { class: "tile", "data-tile": name }, h("dt", {}, title), value); };
    const { outdoor, outdoor_label: outdoors, facility, hvac, zones } = this.description;
    return h("dl", { class: "tiles" },
      outdoor !== null && tile("outdoor", outdoors),
      facility && tile("facility", facility.label),
      hvac && tile("hvac", hvac.label),
      zones.length > 0 && tile("comfort", "In the band"),
      zones.length > 0 && tile("occupied", "Occupied outside it"),
      tile("alarms", "Alarms to acknowledge"),
      tile("control", "Set by"),
      this.description.slots > 1 && tile("slots", "Slot"));
  }

  update() {
    const { state } = this;
    this.problem.hidden = true;
    this.root.classList.remove("stale");
    setText(this.time, dateTime(state.time));
    this.progress.value = state.step;
    setAttribute(this.progress, "aria-label", `Step ${state.step} of ${this.description.steps}`);
    setText(this.steps, `step ${state.step} of ${this.description.steps}${state.episode ? `, episode ${state.episode}` : ""}`);
    const label = state.paused ? "Resume" : "Pause";
    if (this.pauseButton.getAttribute("aria-label") !== label) {
      setAttribute(this.pauseButton, "aria-label", label);
      setAttribute(this.pauseButton, "title", refusal() ?? `${label} (space)`);
      fill(this.pauseButton, icon(state.paused ? "play" : "pause"));
    }
    this.stepButton.disabled = !state.paused || !mayChange();
    if (document.activeElement !== this.mode) this.mode.value = state.mode;
    if (!this.isSliding) {
      const nearest = SPEEDS.reduce((best, speed, place) => (Math.abs(Math.log(speed / state.speed)) < Math.abs(Math.log(SPEEDS[best] / state.speed)) ? place : best), 0);
      this.speed.value = nearest;
      this.showSpeed(state.speed);
    }
    this.speed.classList.toggle("idle", state.mode !== "paced");
    const isRecording = state.recording && ["armed", "recording"].includes(state.recording.state);
    setAttribute(this.recordButton, "aria-label", isRecording ? "Stop recording" : "Record");
    setAttribute(this.recordButton, "title", refusal() ?? (isRecording ? `Recording to ${state.recording.path}; stop` : "Record"));
    setAttribute(this.recordButton, "aria-pressed", String(Boolean(isRecording)));
    this.plans?.update(state);
    this.schematic?.update(state);
    this.district?.update(state);
    this.zoneTable?.update(state);
    this.pointTable.update(state);
    this.alarmPanel.update(state);
    this.controllerPanel.update(state);
    this.faultPanel.update(state);
    this.whatIfPanel.update(state);
    this.trends.update(state);
    this.drawer?.update(state);
    this.showTiles();
    this.showEntry();
  }

  showEntry() {
    const entry = this.entry ?? { ...this.state };
    const [text, kind] = nodeState({ ...entry, ...this.state, ...this.gone });
    setText(this.chip, text);
    setAttribute(this.chip, "class", `chip ${kind}`);
    if (this.gone) { setText(this.paceText, ""); return; }
    const parts = [pace({ ...this.state, rate: entry.rate }), this.state.failure, this.state.faults?.length ? `faults: ${this.state.faults.join(", ")}` : ""];
    setText(this.paceText, parts.filter(Boolean).join(" · "));
  }

  showTiles() {
    const { state, description } = this;
    const set = (name, text, kind = "") => {
      const cell = this.tileValues.get(name);
      if (cell) { setText(cell, text); setAttribute(cell, "class", kind || null); }
    };
    const value = (place, factor = 1) => (state.values?.[place] === null || state.values?.[place] === undefined ? null : state.values[place] * factor);
    set("outdoor", withUnit(value(description.outdoor), "°C"));
    if (description.facility) set("facility", withUnit(value(description.facility.point, description.facility.to_kw), "kW"));
    if (description.hvac) set("hvac", withUnit(value(description.hvac.point, description.hvac.to_kw), "kW"));
    const zones = state.zones ?? [];
    set("comfort", `${zones.filter((zone) => zone.deviation === 0).length} of ${counted(zones.length, "zone")}`);
    const occupied = zones.filter((zone) => zone.deviation && zone.occupied).length;
    set("occupied", occupied ? counted(occupied, "zone") : "none", occupied ? "bad" : "fine");
    const open = state.alarms.filter((alarm) => alarm.is_open && alarm.notify === "alarm").length;
    set("alarms", open ? String(open) : "none", open ? "bad" : "fine");
    const names = [...new Set((state.source ?? []).map((place) => state.sources[place]).filter(Boolean))];
    set("control", names.join(", ") || "baseline control");
    set("slots", `0 of ${description.slots}`);
    for (const [tab, count] of [["alarms", open]]) {
      const button = this.tabTabs.buttons.find((each) => each.dataset.tab === tab);
      setText(button, count ? `Alarms (${count})` : "Alarms");
    }
  }

  showSpeed(speed = SPEEDS[this.speed.value]) {
    setText(this.speedText, rate(speed));
    setAttribute(this.speed, "aria-valuetext", `${rate(speed)}`);
  }

  setPace(speed) {
    const mode = this.mode.value;
    operate(this.node, "pace", mode === "paced" ? { mode, speed } : { mode });
  }

  togglePause() { if (this.state) operate(this.node, this.state.paused ? "resume" : "pause"); }

  toggleRecording() {
    const isRecording = this.recordButton.getAttribute("aria-pressed") === "true";
    if (isRecording) operate(this.node, "stop_recording"); else recordDialog(this.node, this.state);
  }

  onView() {
    if (!this.description) return;
    const { zone, point } = view();
    this.tableTabs.show();
    this.tabTabs.show();
    const selected = zone === undefined ? null : Number(zone);
    this.plans?.mark(selected);
    this.schematic?.onView();
    this.zoneTable?.mark(selected);
    this.trends.onView();
    this.pointTable.mark(this.trends.names());
    const place = point ? this.description.points.findIndex((each) => each.id === point) : -1;
    if (this.drawer && this.drawer.place !== place) { this.drawer.close(); this.drawer = null; }
    if (place >= 0 && !this.drawer) {
      this.drawer = new PointPanel(document.getElementById("drawer"), this.node, this.description, place);
      this.drawer.showEvents(this.events);
      if (this.state) this.drawer.update(this.state);
    }
  }
}

