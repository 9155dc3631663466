// Air and plant loops as a schematic: components in the direction of flow, with the values that belong to them.

import { fill, h, s, setAttribute, setText } from "./dom.js";
import { counted, num, shown, withUnit } from "./format.js";
import { cells, layout } from "./schematic_layout.js";
import { change, view } from "./view.js";

const LINE = 17, TOP = 40, CAPTION = 22, MOST_VALUES = 5, MOST_ZONES = 30, OTHERS = "zones", TITLE = "650 12px", LABEL = "11.5px";
const GROUPS = { AirLoopHVAC: "Air loops", PlantLoop: "Plant loops", CondenserLoop: "Condenser loops" };
const SYMBOLS = [
  [/^Fan/, "M9 1a8 8 0 1 0 .01 0M9 9L3.5 4M9 9l7-2.5M9 9l-2 7.5"],
  [/^Pump|^HeaderedPumps/, "M9 1a8 8 0 1 0 .01 0M4 3l13 6L4 15"],
  [/^Coil:(Cooling|Waterheating)|^CoilSystem:Cooling/, "M1 1h16v16H1zM1 17L17 1M4 5h5"],
  [/^Coil/, "M1 1h16v16H1zM1 17L17 1M4 5h5M6.5 2.5v5"],
  [/^Chiller|^Refrigeration/, "M1 3h16v12H1zM9 4.5v9M5 6.7l8 4.6M13 6.7l-8 4.6"],
  [/^Boiler|^DistrictHeating/, "M1 3h16v12H1zM9 5c4 4 2 7.5 0 7.5S5 9 9 5z"],
  [/^CoolingTower|^EvaporativeFluidCooler|^FluidCooler/, "M4 1h10l3 16H1zM5 5h8M4.5 9h9"],
  [/^WaterHeater|^ThermalStorage/, "M4 3c0-3 10-3 10 0v12c0 3-10 3-10 0zM4 3c0 3 10 3 10 0"],
  [/^WaterUse/, "M9 1c6 8 6 15 0 15S3 9 9 1z"],
  [/OutdoorAirSystem|OutdoorAir:Mixer/, "M1 5h9M1 13h9M7 2l3 3-3 3M13 1v16M17 1v16"],
  [/HeatExchanger|EnergyRecovery/, "M1 1h16v16H1zM1 1l16 16M17 1L1 17"],
  [/AirDistributionUnit|^AirTerminal/, "M1 4h16M1 14h16M5 14L13 4"],
  [/Unitary|HeatPump|PackagedTerminal|FourPipeFanCoil|UnitHeater|VariableRefrigerant/, "M1 3h16v12H1zM5.5 9a3.5 3.5 0 1 0 7 0 3.5 3.5 0 1 0-7 0M9 3v12"],
  [/Baseboard|Radiant/, "M1 4h16v10H1zM5 4v10M9 4v10M13 4v10"],
];
const OTHER = "M2 2h14v14H2z";

const measure = document.createElement("canvas").getContext("2d");

/** A text, shortened to a width in pixels. */
function cut(text, width, font) {
  measure.font = `${font} ${getComputedStyle(document.documentElement).fontFamily}`;
  if (measure.measureText(text).width <= width) return text;
  let length = text.length;
  while (length > 1 && measure.measureText(`${text.slice(0, length)}…`).width > width) length -= 1;
  return `${text.slice(0, length)}…`;
}

export class Schematic {
  constructor(root, description) {
    this.root = root;
    this.description = description;
    this.systems = description.systems;
    this.chosen = h("select", { id: "loop", onchange: () => change({ loop: this.chosen.value, component: null }, { replace: true }) }, this.options());
    this.facts = h("p", { class: "muted loop-values" });
    this.drawing = h("div", { class: "schematic" });
    this.detail = h("div", { class: "component", role: "region", "aria-label": "Component", hidden: true });
    this.more = h("button", { class: "wide-button", hidden: true, onclick: () => { this.limit = Infinity; this.draw(); } });
    fill(root, h("div", { class: "row wrap loop-choice" }, h("label", { for: "loop" }, "Loop"), this.chosen, this.facts), this.drawing, this.more, this.detail);
    this.live = [];
    this.width = 0;
    this.resized = new ResizeObserver(() => { if (Math.abs(this.drawing.clientWidth - this.width) > 4) this.draw(); });
    this.resized.observe(this.drawing);
  }

  close() { this.resized.disconnect(); }

  options() {
    const groups = Object.entries(GROUPS).map(([kind, title]) => {
      const loops = this.systems.loops.map((loop, place) => [loop, place]).filter(([loop]) => loop.kind === kind);
      return loops.length ? h("optgroup", { label: `${title} (${loops.length})` }, loops.map(([loop, place]) => h("option", { value: place }, loop.name))) : null;
    });
    const others = this.systems.zones.length ? h("option", { value: OTHERS }, `Equipment on no air loop (${counted(this.systems.zones.length, "zone")})`) : null;
    return [groups, others];
  }

  /** Show what the address names. */
  onView() {
    const { loop, component } = view();
    const known = [...this.chosen.options].some((option) => option.value === loop);
    const next = known ? loop : this.chosen.options[0]?.value;
    this.component = /^\d+$/.test(component ?? "") && this.systems.components[component] ? Number(component) : null;
    if (next !== this.shown) { this.shown = next; this.chosen.value = next; this.limit = MOST_ZONES; this.draw(); }
    this.mark();
    this.showDetail();
  }

  // Boxes

  /** All values of a component and of its parts: `[point, label]`, with the parts as headings. */
  lines(number, depth = 0) {
    const component = this.systems.components[number];
    const own = component.values.map(([point, label]) => ({ point, label }));
    const parts = depth > 3 ? [] : component.parts.flatMap((part) => [{ part }, ...this.lines(part, depth + 1)]);
    return [...own, ...parts];
  }

  box(number, width) {
    const all = this.lines(number), values = all.filter((line) => line.point !== undefined);
    const lines = values.slice(0, values.length > MOST_VALUES ? MOST_VALUES - 1 : MOST_VALUES);
    const hidden = values.length - lines.length;
    return { number, lines, hidden, w: width, h: TOP + LINE * (lines.length + (hidden ? 1 : 0)) + (values.length ? 5 : 2) };
  }

  zoneBox(zone, width) { return { zone, w: width, h: 34 }; }

  draw() {
    this.width = this.drawing.clientWidth;
    if (!this.width || this.shown === undefined) return;
    const width = Math.max(260, this.width - 6);  // without the padding
    const size = Math.min(206, width < 420 ? width - 110 : 204);
    const branches = (list) => list.map((branch) => branch.map((number) => this.box(number, size)));
    const zones = (list) => list.slice(0, this.limit).map((zone) => [...zone.equipment.map((number) => this.box(number, size)), this.zoneBox(zone, size)]);
    let plan, captions = [];
    if (this.shown === OTHERS) plan = cells(zones(this.systems.zones), width);
    else {
      const loop = this.systems.loops[this.shown];
      const [supply, demand] = ["supply", "demand"].map((name) => (loop.sides.find((side) => side.name === name)?.stages ?? []).map(branches));
      const served = loop.zones.length ? [zones(loop.zones)] : demand;
      captions = [...(supply.length ? ["Supply"] : []), ...(served.length ? [loop.zones.length ? `Zones (${loop.zones.length})` : "Demand"] : [])];
      plan = layout(supply, served, width, CAPTION);
    }
    const left = (this.shown === OTHERS ? this.systems : this.systems.loops[this.shown]).zones.length - this.limit;
    this.more.hidden = left <= 0;
    setText(this.more, counted(left, "more zone"));
    this.live = [];
    const drawing = s("svg", { viewBox: `0 0 ${width} ${plan.height + 4}`, width, height: plan.height + 4, role: "group", "aria-label": this.title() },
      plan.captions.map((y, place) => s("text", { x: 26, y: y + 13, class: "caption" }, captions[place])),
      plan.pipes.map((pipe) => s("polyline", { points: pipe.map((point) => point.join()).join(" "), class: "pipe" })),
      plan.flow.map((pipe) => s("polyline", { points: pipe.map((point) => point.join()).join(" "), class: "pipe flow" })),
      plan.ends.map(([from, to]) => this.arrow(from, to)),
      plan.boxes.map((box) => (box.zone ? this.drawZone(box) : this.drawBox(box))));
    fill(this.drawing, drawing);
    if (this.state) this.update(this.state);
    this.mark();
  }

  title() {
    if (this.shown === OTHERS) return "Equipment on no air loop";
    const loop = this.systems.loops[this.shown];
    return `${GROUPS[loop.kind]?.replace(/s$/, "") ?? loop.kind} ${loop.name}`;
  }

  arrow([fromX], [x, y]) {
    const way = Math.sign(x - fromX) || 1;
    return s("path", { d: `M${x} ${y}l${-9 * way} -5v10z`, class: "arrow" });
  }

  drawBox({ number, lines, hidden, x, y, w, h: height }) {
    const component = this.systems.components[number];
    const group = s("g", { class: "box", transform: `translate(${x} ${y})`, tabindex: 0, role: "button", "data-component": number });
    const title = s("title", {});
    const symbol = SYMBOLS.find(([pattern]) => pattern.test(component.kind))?.[1] ?? OTHER;
    const texts = lines.map(({ point, label }, place) => {
      const line = TOP + LINE * place + 10;
      const value = s("text", { x: w - 9, y: line, "text-anchor": "end", class: "box-value" });
      this.live.push({ value, point });
      return [s("text", { x: 9, y: line, class: "box-label" }, cut(label, w - 92, LABEL)), value];
    });
    group.append(title, s("rect", { width: w, height, rx: 7, class: "frame" }),
      s("path", { d: symbol, transform: "translate(9 9)", class: "symbol" }),
      s("text", { x: 34, y: 17, class: "box-title" }, cut(component.type, w - 42, TITLE)),
      s("text", { x: 34, y: 31, class: "box-label" }, cut(component.name, w - 42, LABEL)),
      ...texts.flat(), ...(hidden ? [s("text", { x: 9, y: height - 8, class: "box-label" }, `${hidden} more`)] : []));
    const choose = () => change({ component: this.component === number ? null : number }, { replace: true });
    this.press(group, choose);
    this.live.push({ group, title, number, lines });
    return group;
  }

  drawZone({ zone, x, y, w, h: height }) {
    const known = zone.zone === null ? null : this.description.zones[zone.zone];
    const name = known?.name ?? zone.name;
    const group = s("g", { class: known ? "box zone-box" : "box plain-zone", transform: `translate(${x} ${y})`, ...(known ? { tabindex: 0, role: "button" } : {}) });
    const rect = s("rect", { width: w, height, rx: 7, class: "frame" });
    const value = s("text", { x: w - 9, y: 21, "text-anchor": "end", class: "box-value" });
    const band = s("rect", { width: 6, height: height - 12, x: 7, y: 6, rx: 3, class: "zone-color" });
    const title = s("title", {}, name);
    group.append(title, rect, ...(known ? [band] : []), s("text", { x: 20, y: 21, class: "box-title" }, cut(name, w - 88, TITLE)), value);
    if (known) {
      this.press(group, () => change({ zone: zone.zone, trend: null }, { replace: true }));
      this.live.push({ group, title, value, band, zone: zone.zone, name });
    }
    return group;
  }

  press(group, choose) {
    group.addEventListener("click", choose);
    group.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(); } });
  }

  // Values

  text(state, point) {
    const described = this.description.points[point];
    return withUnit(shown(described, state.values?.[point]), described.unit);
  }

  update(state) {
    this.state = state;
    for (const entry of this.live) {
      if (entry.point !== undefined) setText(entry.value, this.text(state, entry.point));
      else if (entry.zone !== undefined) {
        const now = state.zones?.[entry.zone];
        const text = withUnit(state.values?.[this.description.zones[entry.zone].temperature], "°C");
        setText(entry.value, text);
        setAttribute(entry.band, "fill", now?.color ?? "#808080");
        const deviation = now?.deviation ? `, ${num(Math.abs(now.deviation), "K")} K ${now.deviation > 0 ? "above" : "below"} the band` : "";
        setAttribute(entry.group, "aria-label", `Zone ${entry.name}: ${text}${deviation}`);
        setText(entry.title, `${entry.name}: ${text}${deviation}`);
      } else {
        const component = this.systems.components[entry.number];
        const values = entry.lines.map(({ point, label }) => `${label.toLowerCase()} ${this.text(state, point)}`);
        const label = `${component.type} ${component.name}${values.length ? `: ${values.join(", ")}` : ""}`;
        setAttribute(entry.group, "aria-label", label);
        setText(entry.title, label);
      }
    }
    const loop = this.systems.loops[this.shown];
    setText(this.facts, (loop?.values ?? []).map(([point, label]) => `${label} ${this.text(state, point)}`).join(" · "));
    for (const [point, cell] of this.detailed ?? []) setText(cell, this.text(state, point));
  }

  mark() {
    for (const group of this.drawing.querySelectorAll("[data-component]")) {
      const isChosen = Number(group.dataset.component) === this.component;
      group.classList.toggle("selected", isChosen);
      setAttribute(group, "aria-pressed", String(isChosen));
    }
  }

  showDetail() {
    const { component: number } = this;
    if (this.detailNumber === number) return;
    this.detailNumber = number;
    this.detail.hidden = number === null;
    this.detailed = new Map();
    if (number === null) { fill(this.detail); return; }
    const component = this.systems.components[number];
    const rows = this.lines(number).map(({ part, point, label }) => {
      if (point === undefined) {
        const { type, name } = this.systems.components[part];
        return h("tr", {}, h("th", { scope: "rowgroup", colspan: 2, class: "muted" }, `${type} ${name}`));
      }
      const cell = h("td", { class: "number" });
      this.detailed.set(point, cell);
      return h("tr", {}, h("th", { scope: "row" }, h("button", { class: "plain", onclick: () => change({ point: this.description.points[point].id }) }, label)), cell);
    });
    fill(this.detail,
      h("div", { class: "row wrap" }, h("h3", {}, component.type), h("span", { class: "muted" }, `${component.name} · ${component.kind}`)),
      h("p", { class: "row wrap" }, this.loopsOf(number).filter((place) => String(place) !== this.shown).map((place) =>
        h("button", { class: "small", onclick: () => change({ loop: place }, { replace: true }) }, `Also on ${this.systems.loops[place].name}`))),
      rows.length ? h("table", {}, h("tbody", {}, rows)) : null,
      this.detailed.size ? null : h("p", { class: "muted" }, "The node has no point of this component. Add some to the sensors of its scenario."));
    if (this.state) this.update(this.state);
  }

  /** Numbers of the loops on which a component, or one that it is a part of, is. */
  loopsOf(number) {
    const has = (each) => each === number || this.systems.components[each].parts.some(has);
    return this.systems.loops.map((loop, place) => [loop, place]).filter(([loop]) =>
      loop.sides.some((side) => side.stages.flat(2).some(has)) || loop.zones.some((zone) => zone.equipment.some(has))).map(([, place]) => place);
  }
}
