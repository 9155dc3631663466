// Trends by uPlot: the history that the node keeps, then each new sample; zoomed by dragging.

import { get, nodePath } from "./api.js";
import { fill, h, icon, refill } from "./dom.js";
import { clock, counted, DAYS, hoursBefore, seconds, shown, ticks, withUnit } from "./format.js";
import { change, view } from "./view.js";

const uPlot = window.uPlot;
export const COLORS = ["#2878dc", "#eb6e00", "#00903c", "#b44696", "#8a6fd1", "#c08a1e", "#19a0a5", "#e0566f", "#6b7f95", "#4f9a2f"];
export const RANGES = [["6", "6 h"], ["24", "24 h"], ["72", "3 d"], ["168", "7 d"], ["all", "all"]];
const MAX_SAMPLES = 1200, MAX_LINES = 24, MAX_AXES = 4;

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** Labels of a time axis: hours, and the day where it begins. */
function timeLabels(_, splits, axis, space, step) {
  return splits.map((split, place) => {
    const date = new Date(split * 1000);
    const day = `${DAYS[date.getUTCDay()]} ${date.getUTCDate()}/${date.getUTCMonth() + 1}`;
    const hour = clock(date, step);
    if (step >= 86400) return day;
    const isFirst = place === 0 || new Date(splits[place - 1] * 1000).getUTCDate() !== date.getUTCDate();
    return isFirst ? `${hour}\n${day}` : hour;
  });
}

/** A range around values, so that lines do not touch its ends. */
function padded(low, high, unit) {
  const least = unit === "°C" || unit === "people" ? 2 : unit === "kW" || low === high ? 1e-6 : 0;
  const pad = Math.max((high - low) * 0.08, least / 2, Math.abs(high) * 1e-3);
  return [low >= 0 && low - pad < 0 ? 0 : low - pad, high + pad];
}

/** Key of the scale of a unit: units are free texts, and `x` is the key of the time axis. */
const scaleOf = (unit) => `unit ${unit}`;

/** Create a chart of some series on an axis of times, or of steps; `series` have label, unit, color, values and optionally stepped, dash, lows, highs; `band` has a unit, and lists `low` and `high`. */
export function chart(root, { time, series, band = null, height = 260, onZoom = null, onReset = null, range = null, isTime = true, least = 60 }) {
  const units = [...new Set(series.map((each) => each.unit))];
  const grid = css("--grid"), text = css("--muted");
  const font = "12px system-ui, sans-serif";
  const axes = [
    { stroke: text, font, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid }, values: isTime ? timeLabels : (_, splits) => ticks(splits), space: 64, size: isTime ? 46 : 30 },
    ...units.slice(0, MAX_AXES).map((unit, place) => ({
      scale: scaleOf(unit), side: place === 0 ? 3 : 1, stroke: text, font, size: 58, ticks: { stroke: grid },
      grid: { show: place === 0, stroke: grid, width: 1 }, values: (_, splits) => ticks(splits),
      label: unit || undefined, labelFont: font, labelSize: 18, labelGap: 0,
    })),
  ];
  const around = isTime ? 1800 : 1, isSingle = (plot) => plot.data[0].length === 1;
  const scales = { x: { time: isTime, range: (plot, from, to) => range ?? (isSingle(plot) ? [plot.data[0][0] - around, plot.data[0][0] + around] : [from, to]) } };
  for (const unit of units) {
    scales[scaleOf(unit)] = { range: (_, least, most) => {
      if (least === null) return [0, 1];
      const limits = series.filter((each) => each.unit === unit && each.lows).flatMap((each) => [...each.lows, ...each.highs]).filter((value) => value !== null);
      return padded(limits.reduce((first, value) => Math.min(first, value), least), limits.reduce((first, value) => Math.max(first, value), most), unit);
    } };
  }
  const options = {
    width: Math.max(200, root.clientWidth), height, axes, scales,
    tzDate: (stamp) => uPlot.tzDate(new Date(stamp * 1000), "UTC"),
    legend: { show: false },
    padding: [10, units.length > 1 ? 4 : 32, 0, 0],  // on the right, half of a day's label
    cursor: { drag: { x: true, y: false, setScale: false }, points: { size: 6 }, focus: { prox: 24 } },
    focus: { alpha: 0.35 },
    series: [{}, ...series.map((each) => ({
      label: each.label, scale: scaleOf(each.unit), stroke: each.color, width: each.width ?? 1.6, dash: each.dash,
      points: { show: each.dots ?? isSingle, size: 5 }, spanGaps: each.gaps ?? false, paths: each.stepped ? uPlot.paths.stepped({ align: -1 }) : undefined,
      value: (_, value) => withUnit(value, each.unit),
    }))],
    hooks: {
      drawClear: [(plot) => band && drawBand(plot, band)],
      drawSeries: [(plot, place) => drawExtremes(plot, place, series)],
      setCursor: [(plot) => root.tip?.(plot, series)],
      setSelect: [(plot) => {
        if (plot.select.width < 4) return;
        const from = plot.posToVal(plot.select.left, "x"), to = plot.posToVal(plot.select.left + plot.select.width, "x");
        plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        if (to - from > least) onZoom?.(from, to);
      }],
    },
  };
  const plot = new uPlot(options, [time, ...series.map((each) => each.values)], root);
  plot.over.addEventListener("dblclick", () => onReset?.());
  return plot;
}

/** Shade the comfort band: the limits of each sample hold over the timestep that it ends. */
function drawBand(plot, { unit, low, high }) {
  const key = scaleOf(unit), scale = plot.scales[key], time = plot.data[0];
  if (!scale || scale.min === null || scale.min === undefined) return;
  const { ctx } = plot, { left, top, width, height } = plot.bbox;
  const clamp = (value) => Math.min(top + height, Math.max(top, plot.valToPos(value, key, true)));
  const end = (place) => (place < 0 ? left : place === time.length - 1 ? left + width : Math.round(plot.valToPos(time[place], "x", true)));
  ctx.save();
  ctx.fillStyle = css("--band");
  for (let first = 0, next; first < time.length; first = next) {
    next = first + 1;
    while (next < time.length && low[next] === low[first] && high[next] === high[first]) next += 1;
    if (low[first] === null || high[first] === null) continue;
    ctx.fillRect(end(first - 1), clamp(high[first]), end(next - 1) - end(first - 1), clamp(low[first]) - clamp(high[first]));
  }
  ctx.restore();
}

/** Shade the extremes between samples that are shown, so that no peak is lost. */
function drawExtremes(plot, place, series) {
  const each = series[place - 1];
  if (!each?.lows) return;
  const { ctx } = plot, scale = scaleOf(each.unit), time = plot.data[0];
  ctx.save();
  ctx.beginPath();
  ctx.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
  ctx.clip();
  ctx.globalAlpha = 0.28;
  ctx.fillStyle = each.color;
  ctx.beginPath();
  const at = (index, values) => ctx.lineTo(plot.valToPos(time[index], "x", true), plot.valToPos(values[index], scale, true));
  const known = time.map((_, index) => index).filter((index) => each.lows[index] !== null && each.highs[index] !== null);
  known.forEach((index) => at(index, each.highs));
  known.reverse().forEach((index) => at(index, each.lows));
  ctx.closePath();
  ctx.fill();
  ctx.restore();
}

/** Request the history of some points of a node: times in s, and values and extremes in the units that are shown. */
export async function loadHistory(node, points, settings) {
  const query = new URLSearchParams(points.map((point) => ["point", point.id]));
  for (const [name, value] of Object.entries(settings)) if (value !== null) query.set(name, value);
  const { time_ms: times, points: columns, ...more } = await get(`${nodePath(node, "history")}?${query}`);
  const scaled = (name) => columns.map((each, column) => each[name]?.map((value) => shown(points[column], value)));
  return { ...more, time: times.map((each) => each / 1000), values: scaled("values"), lows: scaled("lows"), highs: scaled("highs") };
}

export class Trends {
  constructor(root, node, description) {
    this.node = node;
    this.description = description;
    this.byName = new Map(description.points.map((point, place) => [point.id, { point, place }]));
    this.data = null;
    this.loading = false;
    this.plot = null;
    this.hasHistory = description.history_samples > 0;
    this.legend = h("ul", { class: "legend", "aria-label": "Lines" });
    this.when = h("span", { class: "muted when" });
    this.canvas = h("div", { class: "chart" });
    this.canvas.tip = (plot, series) => this.tip(plot, series);
    this.ranges = h("div", { class: "segments", role: "group", "aria-label": "Range of time" }, RANGES.map(([value, text]) =>
      h("button", { "data-range": value, onclick: () => change({ range: value, from: null, to: null }, { replace: true }) }, text)));
    this.live = h("button", { class: "chip warning", hidden: true, onclick: () => change({ from: null, to: null }, { replace: true }) }, "zoomed – follow again");
    this.presets = h("div", { class: "segments", role: "group", "aria-label": "What is drawn" }, this.presetList().map(([name, text]) =>
      h("button", { "data-preset": name, onclick: () => change({ trend: name === "zones" ? null : name }, { replace: true }) }, text)));
    fill(root, h("div", { class: "row wrap" }, this.presets, h("span", { class: "grow" }), this.live, this.ranges),
      h("div", { class: "row" }, this.when), this.canvas, this.legend);
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.canvas);
  }

  close() { this.observer.disconnect(); this.plot?.destroy(); this.isClosed = true; }

  presetList() {
    const presets = [];
    if (this.description.zones.length) presets.push(["zones", "Zones"]);
    if (this.description.facility || this.description.hvac) presets.push(["power", "Power"]);
    return presets;
  }

  /** Ids of the points that are drawn. */
  names() { return this.wanted().slice(0, MAX_LINES); }

  /** Ids of the points that the address asks for. */
  wanted() {
    const { trend } = view();
    const { zones, points } = this.description;
    const name = (place) => (place === null || place === undefined ? null : points[place].id);
    const known = (list) => [...new Set(list)].filter((each) => each && this.byName.has(each));
    if (this.chosen().length) return known(this.chosen());
    if (trend === "power") {
      const { facility, hvac, outdoor } = this.description;
      return known([name(facility?.point), name(hvac?.point), name(outdoor)]);
    }
    const selected = zones[this.selected()];
    if (selected) {
      return known([name(selected.temperature), name(selected.heating_actuator ?? selected.heating_setpoint),
        name(selected.cooling_actuator ?? selected.cooling_setpoint), name(selected.occupants), name(this.description.outdoor)]);
    }
    if (zones.length) return known(zones.map((each) => name(each.temperature)));
    return known(points.slice(0, 6).map((point) => point.id));
  }

  /** Add a point to the lines, or remove it from them. */
  toggle(name) {
    const chosen = this.chosen();
    const next = chosen.includes(name) ? chosen.filter((each) => each !== name) : [...chosen, name];
    change({ trend: next.join(",") || null }, { replace: true });
  }

  /** Ids of the points that somebody has chosen; none of a preset. */
  chosen() {
    const { trend } = view();
    return trend && trend !== "power" && trend !== "zones" ? trend.split(",") : [];
  }

  onView() {
    const { range = "24", from, to, trend } = view();
    for (const button of this.ranges.children) button.setAttribute("aria-pressed", String(!from && button.dataset.range === range));
    const preset = this.chosen().length ? "" : trend ?? "zones";
    for (const button of this.presets.children) button.setAttribute("aria-pressed", String(button.dataset.preset === preset));
    this.live.hidden = !(from && to);
    const wanted = this.hasHistory ? [range, from, to] : [];  // else what is kept is drawn
    const key = JSON.stringify([this.names(), ...wanted, view().zone, this.episode]);
    if (key !== this.key) { this.key = key; this.data = null; this.problem = ""; this.load(); } else this.draw();
  }

  update(state) {
    this.state = state;
    if (state.values === undefined) return;
    if (state.episode !== this.episode) { this.episode = state.episode; this.onView(); return; }
    const { data } = this;
    if (!this.hasHistory) { this.follow(state); return; }
    if (!data && this.problem) this.later();  // the node may be back
    if (!data || view().from) return;
    const newer = state.sample_step - data.last;
    if (newer <= 0) return;
    if (newer === 1 && data.stride === 1) {
      this.append(data, state);
      this.data = between(data, this.span());
      this.draw();
    } else this.later();
  }

  append(data, state) {
    data.last = state.sample_step;
    data.time.push(seconds(state.time));
    data.names.forEach((name, column) => {
      const { point, place } = this.byName.get(name);
      data.values[column].push(shown(point, state.values[place]));
    });
    const now = this.limits();
    data.band.low.push(now.low);
    data.band.high.push(now.high);
  }

  /** Add a sample of a node that keeps no history, such as a replay or a branch; the lines begin when they are chosen. */
  follow(state) {
    const names = this.names();
    this.data ??= { names, stride: 1, last: -1, time: [], values: names.map(() => []), band: { low: [], high: [] } };
    const { data } = this;
    if (!names.length || state.sample_step <= data.last) return;
    this.append(data, state);
    for (const list of [data.time, ...data.values, data.band.low, data.band.high]) if (list.length > MAX_SAMPLES) list.shift();
    this.draw();
  }

  /** Load again soon, but not more often than the page can draw. */
  later() {
    if (this.timer || this.loading) return;
    this.timer = setTimeout(() => { this.timer = null; this.load(); }, this.problem || this.data?.stride > 1 ? 2000 : 400);
  }

  span() {
    const { range = "24", from, to } = view();
    if (from && to) return [from, to];
    if (range === "all" || !this.state?.time) return [null, null];
    const hours = Number(range) > 0 ? Number(range) : 24;
    return [hoursBefore(this.state.time, hours, this.description.begin), null];
  }

  async load() {
    const names = this.names(), key = this.key;
    if (!names.length || !this.hasHistory || this.isClosed) { this.draw(); return; }
    if (!this.state) return;
    this.loading = true;
    const [from, to] = this.span();
    try {
      const points = names.map((name) => this.byName.get(name).point);
      const history = await loadHistory(this.node, points, { max: MAX_SAMPLES, band: this.selected() ?? "all", from, to });
      if (key !== this.key) return;
      this.data = { ...history, names, last: history.last_step };
      this.problem = "";
    } catch (error) { this.problem = error.message; } finally { this.loading = false; }
    if (!this.isClosed) this.draw();
  }

  series(data) {
    const { description } = this;
    const zoneOf = new Map(description.zones.map((zone) => [description.points[zone.temperature]?.id, zone]));
    const isZones = data.names.every((name) => zoneOf.has(name));
    return data.names.map((name, column) => {
      const { point } = this.byName.get(name);
      const isSetpoint = point.kind === "actuator" || / setpoint$/i.test(point.label);
      return { name, label: isZones ? zoneOf.get(name).name : point.label, unit: point.unit,
        color: isZones ? zoneOf.get(name).color : COLORS[column % COLORS.length],
        values: data.values[column], lows: data.lows?.[column], highs: data.highs?.[column],
        stepped: isSetpoint || point.unit === "people", dash: isSetpoint ? [6, 4] : undefined };
    });
  }

  /** Number of the zone that is chosen; null if none is. */
  selected() {
    const number = Number(view().zone);
    return this.description.zones[number] ? number : null;
  }

  /** Present limits of the comfort band of the chosen zone, or of all zones if they have the same. */
  limits() {
    const zones = this.state.zones ?? [], selected = zones[this.selected()], now = selected ?? zones[0];
    const isCommon = zones.every((each) => each.low === now.low && each.high === now.high);
    return now && (selected || isCommon) ? now : { low: null, high: null };
  }

  /** Why nothing is drawn. */
  emptyText() {
    if (!this.hasHistory) return this.data?.time.length ? "No sample of this time has come since the points were chosen." : "This node keeps no history; its next samples are drawn.";
    const missing = this.chosen().length ? "This node has none of the points that were chosen. " : "";
    return this.problem || (this.names().length ? "…" : `${missing}Choose points in the table to draw them.`);
  }

  draw() {
    const data = this.data && !this.hasHistory ? between(this.data, this.span()) : this.data;
    if (!data || !data.time.length || !this.canvas.clientWidth) {
      this.plot?.destroy();
      this.plot = null;
      const text = this.emptyText();
      fill(this.canvas, h("p", { class: "empty" }, text));
      refill(this.legend);
      return;
    }
    const next = this.series(data), left = this.wanted().length - next.length;
    const shape = JSON.stringify([left, this.canvas.clientWidth, css("--grid"), next.map((each) => [each.name, each.unit])]);
    if (this.plot && shape === this.shape) {
      next.forEach((each, column) => Object.assign(this.lines[column], each));
      Object.assign(this.band, data.band);
      this.plot.setData([data.time, ...next.map((each) => each.values)]);
      this.tip(this.plot, this.lines);
      return;
    }
    this.plot?.destroy();
    fill(this.canvas);
    this.shape = shape;
    const series = next;
    this.lines = series;
    this.band = { unit: "°C", ...data.band };
    this.plot = chart(this.canvas, { time: data.time, series, band: this.band, height: this.canvas.clientWidth < 500 ? 220 : 290,
      least: Math.max(1, this.description.step_s),
      onZoom: (from, to) => change({ from: iso(from), to: iso(to) }, { replace: true }),
      onReset: () => change({ from: null, to: null }, { replace: true }) });
    const removable = this.chosen().length > 0;
    refill(this.legend, left > 0 && h("li", { class: "muted" }, `the first ${MAX_LINES}; ${counted(left, "other")} not drawn`), series.map((each, column) => h("li", {},
      swatch(each), h("span", {}, each.label),
      h("span", { class: "number legend-value", "data-column": column }, withUnit(last(each.values), each.unit)),
      removable && h("button", { class: "quiet small", "aria-label": `Remove ${each.label}`, onclick: () => this.toggle(each.name) }, icon("close")))));
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Trends of ${series.slice(0, 4).map((each) => `${each.label}, now ${withUnit(last(each.values), each.unit)}`).join("; ")}`);
    this.when.textContent = "";
  }

  tip(plot, series) {
    const idx = plot.data[0][plot.cursor.idx] === undefined ? null : plot.cursor.idx;  // the data may have been cut
    for (const cell of this.legend.querySelectorAll(".legend-value")) {
      const each = series[cell.dataset.column];
      cell.textContent = withUnit(idx === null ? last(each.values) : each.values[idx], each.unit);
    }
    const date = idx === null ? null : new Date(plot.data[0][idx] * 1000);
    this.when.textContent = date === null ? "" : `${DAYS[date.getUTCDay()]} ${date.toISOString().slice(0, 10)} ${clock(date, this.description.step_s % 60 || 60)}`;
  }
}

/** The samples from one simulated time to another; null stands for no limit. */
function between(data, [from, to]) {
  const begin = from === null ? -Infinity : seconds(from), end = to === null ? Infinity : seconds(to);
  const isWithin = data.time.map((time) => time >= begin && time <= end);
  const cut = (list) => list && list.filter((_, place) => isWithin[place]);
  return { ...data, time: cut(data.time), values: data.values.map(cut), lows: data.lows?.map(cut), highs: data.highs?.map(cut),
    band: { low: cut(data.band.low), high: cut(data.band.high) } };
}

export function swatch(each) {
  const line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  line.setAttribute("viewBox", "0 0 18 8");
  line.setAttribute("class", "swatch");
  line.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", "M0 4H18");
  path.setAttribute("stroke", each.color);
  path.setAttribute("stroke-width", "3");
  if (each.dash) path.setAttribute("stroke-dasharray", "5 3");
  line.append(path);
  return line;
}

function last(values) {
  for (let place = values.length - 1; place >= 0; place -= 1) if (values[place] !== null) return values[place];
  return null;
}

function iso(time) {
  return new Date(Math.round(time) * 1000).toISOString().slice(0, 19);
}
