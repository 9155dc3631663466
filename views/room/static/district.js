// A district: its feeder as a one-line diagram, its members, solved loops and markets.

import { fill, h, s, setAttribute, setText } from "./dom.js";
import { num, shown, withUnit, words } from "./format.js";
import { address, change, link } from "./view.js";

const ROW = 50, BOX = 178, BAR = 18, LABEL = 78, STEP = BOX + BAR + LABEL;
const KINDS = { load: "M4 4l10 5-10 5z", pv: "M2 3h14v12H2zM2 9h14M9 3v12", battery: "M3 5h12v9H3zM6 5V3h6v2M7 9.5h4M9 7.5v4", charger: "M10 1L4 10h4l-1 7 7-10h-5z",
  transformer: "M7 9m-5.5 0a5.5 5.5 0 1 0 11 0a5.5 5.5 0 1 0-11 0M11 9m-5.5 0a5.5 5.5 0 1 0 11 0a5.5 5.5 0 1 0-11 0", line: "M1 9h16M5 5v8M13 5v8" };

/** Class of a loading in percent of the rating. */
const load = (value) => (value > 100 ? "over" : value > 80 ? "high" : "fine");
/** Class of a voltage in per unit: the limits of EN 50160. */
const level = (value) => (Math.abs(value - 1) > 0.1 ? "over" : Math.abs(value - 1) > 0.05 ? "high" : "fine");

export class District {
  constructor(root, node, description) {
    this.node = node;
    this.description = description;
    this.live = [];
    const { grids, members, solved } = description.systems;
    fill(root,
      grids.map((grid) => [h("h3", {}, grid.name ? `Grid ${grid.name}` : "Grid"), h("div", { class: "one-line", tabindex: "0", role: "region", "aria-label": `One-line diagram${grid.name ? ` of ${grid.name}` : ""}` }, this.diagram(grid))]),
      members.length ? [h("h3", {}, "Members"), this.table(["Plant", "Kind", "State", "Power"], members.map((each) => this.member(each)), "members")] : null,
      members.filter((each) => each.market).map((each) => [h("h3", {}, `Market ${each.name}`), this.market(each)]),
      solved.length ? [h("h3", {}, "Solved loops"), this.table(["Name", "Kind", "Residual", "Trials", "State"], solved.map((each) => this.loop(each)), "solved")] : null);
  }

  table(heads, rows, kind) {
    return h("div", { class: "district-table" }, h("table", { class: kind }, h("thead", {}, h("tr", {}, heads.map((head) => h("th", { scope: "col", class: ["Power", "Residual", "Trials"].includes(head) ? "number" : null }, head)))), h("tbody", {}, rows)));
  }

  // One-line diagram: the source's bus at the left, its branches and devices as rows, each bus again a bar

  diagram(grid) {
    const items = [], done = new Set(), drawn = new Set();
    let row = 0, deepest = 0;
    const bus = (name, depth) => {
      done.add(name);
      const first = row;
      deepest = Math.max(deepest, depth);
      for (const device of grid.devices.filter((each) => each.bus === name)) items.push(this.device(device, depth, row++));
      for (const branch of grid.branches.filter((each) => each.start === name || each.end === name)) {
        if (drawn.has(branch)) continue;
        drawn.add(branch);
        const end = branch.start === name ? branch.end : branch.start;
        const at = row;
        const isKnown = done.has(end);
        items.push(this.branch(branch, depth, at, isKnown ? end : null));
        if (isKnown) row += 1; else bus(end, depth + 1);
      }
      if (row === first) row += 1;
      items.push(this.bus(grid.buses.find((each) => each.name === name), depth, first, row - 1));
    };
    bus(grid.source, 0);
    for (const each of grid.buses) if (!done.has(each.name)) bus(each.name, 0); // what is not connected to the source
    const width = (deepest + 1) * STEP + BAR + 90, height = row * ROW + 8;
    return s("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": `${grid.buses.length} buses, ${grid.branches.length} branches` }, items);
  }

  /** A box on a row, behind the bar of its bus; `live` gives its texts and class at each update. */
  box(depth, row, kind, name, live) {
    const x = depth * STEP + 90, y = row * ROW + 4;
    const value = s("text", { x: BOX - 8, y: 32, "text-anchor": "end", class: "box-value" });
    const title = s("title", {});
    const group = s("g", { class: "box", transform: `translate(${x + BAR} ${y})`, tabindex: 0, role: "button" },
      title, s("rect", { width: BOX, height: 40, rx: 6, class: "frame" }), s("path", { d: KINDS[kind] ?? KINDS.load, transform: "translate(8 6) scale(.8)", class: "symbol" }),
      s("text", { x: 30, y: 16, class: "box-title" }, name.length > 17 ? `${name.slice(0, 16)}…` : name), s("text", { x: 30, y: 32, class: "box-label" }, kind === "pv" ? "PV" : kind), value);
    const open = () => { if (live.point !== null && live.point !== undefined) change({ point: this.description.points[live.point].id }); };
    group.addEventListener("click", open);
    group.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(); } });
    this.live.push((state) => {
      const [text, kindOf] = live.read(state);
      setText(value, text);
      setAttribute(value, "class", `box-value ${kindOf ?? ""}`);
      setAttribute(group, "aria-label", `${words(kind)} ${name}: ${text}`);
      setText(title, `${name}: ${text}`);
    });
    return [s("line", { x1: x, y1: y + 20, x2: x + BAR, y2: y + 20, class: "pipe" }), group];
  }

  device(device, depth, row) {
    const read = (state) => {
      const charge = this.number(state, device.charge);
      return [`${charge === null ? "" : `${num(100 * charge, "%")} % · `}${this.text(state, device.power)}`];
    };
    return this.box(depth, row, device.kind, device.name, { point: device.power, read });
  }

  branch(branch, depth, row, known) {
    const x = depth * STEP + 90, y = row * ROW + 24;
    const read = (state) => [this.text(state, branch.loading), load(this.number(state, branch.loading) ?? 0)];
    const wire = s("line", { x1: x + BAR + BOX, y1: y, x2: x + STEP, y2: y, class: "pipe" });
    const end = known ? s("text", { x: x + STEP + 4, y: y + 4, class: "box-label" }, `to ${known}`) : null;
    this.live.push((state) => setAttribute(wire, "class", `pipe ${load(this.number(state, branch.loading) ?? 0)}`));
    return [...this.box(depth, row, branch.kind, branch.name, { point: branch.loading, read }), wire, ...(end ? [end] : [])];
  }

  bus(bus, depth, first, last) {
    const x = depth * STEP + 90;
    const bar = s("line", { x1: x, y1: first * ROW + 8, x2: x, y2: last * ROW + 40, class: "bus" });
    const voltage = s("text", { x: x - 7, y: first * ROW + 40, "text-anchor": "end", class: "box-value" });
    this.live.push((state) => {
      const kind = level(this.number(state, bus.voltage) ?? 1);
      setText(voltage, bus.voltage === null ? "" : `${this.number(state, bus.voltage)?.toFixed(3) ?? "–"}`);
      setAttribute(voltage, "class", `box-value ${kind}`);
      setAttribute(bar, "class", `bus ${kind}`);
    });
    const name = bus.name.length > 11 ? `${bus.name.slice(0, 10)}…` : bus.name;
    return [bar, s("text", { x: x - 7, y: first * ROW + 18, "text-anchor": "end", class: "box-label" }, name), voltage];
  }

  // Tables

  cell(read, attributes = { class: "number" }) {
    const cell = h("td", attributes);
    this.live.push((state) => { const [text, kind] = read(state); setText(cell, text); setAttribute(cell, "class", [attributes.class, kind].filter(Boolean).join(" ") || null); });
    return cell;
  }

  member(member) {
    const target = member.node || `${this.node}.${member.name}`;
    const anchor = h("a", { href: address({ node: target }, false), onclick: (event) => link(event, { node: target }), hidden: true }, member.name);
    const search = h("button", { class: "plain", onclick: () => change({ table: "points", search: `${member.name}.` }) }, member.name);
    this.nodes = [...(this.nodes ?? []), { target, anchor, search }];
    const state = (now) => {
      if (this.online.get(target)?.paused) return ["paused", "warm"];  // the district waits for it
      const value = this.number(now, member.available);
      return value === null ? ["–"] : value > 0 ? ["available", "better"] : ["lost", "worse"];
    };
    return h("tr", {}, h("th", { scope: "row" }, anchor, search), h("td", {}, member.kind), this.cell(state, {}), this.cell((now) => [this.text(now, member.power)]));
  }

  loop(loop) {
    const ends = (now) => (loop.solved === undefined || loop.solved === null ? [""] : this.number(now, loop.solved) ? ["solved", "better"] : ["not solved", "worse"]);
    return h("tr", {}, h("th", { scope: "row" }, loop.name), h("td", {}, loop.kind), this.cell((now) => [this.text(now, loop.residual)]),
      this.cell((now) => [loop.trials === undefined || loop.trials === null ? "" : num(this.number(now, loop.trials), "people")]), this.cell(ends, {}));
  }

  market(member) {
    return h("dl", { class: "facts" }, Object.entries(member.market).filter(([, place]) => place !== null).flatMap(([name, place]) => {
      const value = h("dd", {});
      this.live.push((state) => setText(value, name === "cleared" ? (this.number(state, place) ? "yes" : "no") : this.text(state, place)));
      return [h("dt", {}, name === "cleared_demand" ? "bid at the price" : name), value];
    }));
  }

  number(state, place) { return place === null || place === undefined ? null : state.values?.[place] ?? null; }

  text(state, place) {
    if (place === null || place === undefined) return "–";
    const point = this.description.points[place];
    return withUnit(shown(point, this.number(state, place)), point.unit);
  }

  update(state) { this.state = state; for (const show of this.live) show(state); }

  /** Members whose nodes are on this bus are links; `online` has the entries of these by name. */
  onOverview(online) {
    this.online = online;
    for (const { target, anchor, search } of this.nodes ?? []) { anchor.hidden = !online.has(target); search.hidden = online.has(target); }
    if (this.state) this.update(this.state);
  }
}
