// Floor plans: each zone in the color of its deviation from the band; a zone is a button.

import { fill, h, s, setAttribute, setText } from "./dom.js";
import { counted, num, withUnit } from "./format.js";

const SCALE = [["#16469e", "4 K below"], ["#3e80d6", "2 K"], ["#e2e5e0", "in the band"], ["#f08a24", "2 K"], ["#a82a08", "4 K above"]];

/** Black or white, whichever is easier to read on a color. */
function ink(color) {
  const part = (at) => { const c = parseInt(color.slice(at, at + 2), 16) / 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; };
  const light = 0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5);
  return light > 0.18 ? "#10161c" : "#ffffff";
}

export class Plans {
  /** `select` is called with the number of a zone, or null. */
  constructor(root, description, select) {
    this.description = description;
    this.zones = new Map();
    const storeys = [...description.storeys].reverse();
    const all = storeys.flatMap((each) => each.zones.flatMap((zone) => zone.outlines.flat()));
    const xs = all.map(([x]) => x), ys = all.map(([, y]) => y);
    this.bounds = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const figures = storeys.map((storey, place) => this.storey(storey, storeys.length - place, select));
    const legend = h("ul", { class: "scale", "aria-label": "Colors" }, SCALE.map(([color, text]) =>
      h("li", {}, s("svg", { viewBox: "0 0 12 12", "aria-hidden": "true" }, s("rect", { width: 12, height: 12, rx: 3, fill: color })), text)));
    fill(root, h("div", { class: `plans count-${Math.min(storeys.length, 6)}` }, figures), legend);
  }

  storey(storey, number, select) {
    const [left, right, bottom, top] = this.bounds;
    const margin = 0.02 * Math.max(right - left, top - bottom);
    const [width, height] = [right - left + 2 * margin, top - bottom + 2 * margin];
    const unit = Math.max(width, height * 1.6) / 100;
    const drawing = s("svg", { viewBox: `${left - margin} ${-top - margin} ${width} ${height}`, role: "group", "aria-label": `Storey ${number}` });
    const labels = s("g", { class: "labels", "aria-hidden": "true" });
    for (const zone of storey.zones) {
      const path = zone.outlines.map((outline) => `M${outline.map(([x, y]) => `${x} ${-y}`).join("L")}Z`).join("");
      const shape = s("path", { d: path, class: zone.zone === null ? "zone other" : "zone", "stroke-width": 0.35 * unit });
      drawing.append(shape);
      if (zone.zone === null) { shape.append(s("title", {}, `${zone.name}: no temperature`)); continue; }
      const title = s("title", {});
      shape.append(title);
      setAttribute(shape, "tabindex", "0");
      setAttribute(shape, "role", "button");
      const choose = () => select(this.selected === zone.zone ? null : zone.zone);
      shape.addEventListener("click", choose);
      shape.addEventListener("keydown", (event) => {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(); }
      });
      const [x, y, room] = zone.label;
      const size = Math.min(5 * unit, 0.8 * room); // four characters are as wide as the room
      const text = size > 1.6 * unit ? s("text", { x, y: -y + 0.35 * size, "font-size": size, "text-anchor": "middle" }) : null;
      if (text) labels.append(text);
      const entries = this.zones.get(zone.zone) ?? [];
      entries.push({ shape, title, text });
      this.zones.set(zone.zone, entries);
    }
    drawing.append(labels);
    const heading = this.description.storeys.length > 1 ? `Storey ${number} · ${num(storey.height_m)} m` : counted(storey.zones.length, "zone");
    return h("figure", {}, h("figcaption", {}, heading), drawing);
  }

  update(state) {
    this.description.zones.forEach((zone, number) => {
      const now = state.zones?.[number];
      const value = state.values?.[zone.temperature];
      for (const { shape, title, text } of this.zones.get(number) ?? []) {
        const color = now?.color ?? "#808080";
        setAttribute(shape, "fill", color);
        const deviation = now?.deviation ? `, ${num(Math.abs(now.deviation), "K")} K ${now.deviation > 0 ? "above" : "below"} the band` : ", in the band";
        const label = `${zone.name}: ${withUnit(value, "°C")}${now?.deviation === null || !now ? "" : deviation}${now?.occupied ? ", occupied" : ""}`;
        setAttribute(shape, "aria-label", label);
        setText(title, label);
        if (text) { setText(text, num(value, "°C")); setAttribute(text, "fill", ink(color)); }
      }
    });
  }

  mark(selected) {
    this.selected = selected;
    for (const [number, entries] of this.zones) for (const { shape } of entries) {
      shape.classList.toggle("selected", number === selected);
      setAttribute(shape, "aria-pressed", String(number === selected));
      if (number === selected) shape.parentNode.insertBefore(shape, shape.parentNode.lastElementChild);
    }
  }
}
