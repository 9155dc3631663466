// The list of all nodes.

import { fill, h, refill } from "./dom.js";
import { counted, dateTime, rate, withUnit, words } from "./format.js";
import { address, link } from "./view.js";

/** State of a node in a word, with a class for its color. */
export function nodeState(entry) {
  if (!entry.online) return entry.has_ended ? ["ended", "muted"] : ["offline", "alarm"];
  if (entry.state === "failed") return ["failed", "alarm"];
  if (entry.state === "ended" || entry.state === "stopped" || entry.state === "starting") return [entry.state, "muted"];
  if (entry.paused) return ["paused", "warning"];
  return entry.state === "waiting" && entry.mode === "lockstep" && !entry.rate ? ["waiting", "muted"] : ["running", "good"];
}

/** Mode and speed of a node. */
export function pace(entry) {
  const measured = entry.rate ? rate(entry.rate) : "";
  if (entry.mode === "paced") return `paced, ${rate(entry.speed)}`;
  return measured && !entry.paused ? `${entry.mode}, ${measured}` : entry.mode;
}

export class Overview {
  constructor(root) {
    this.cards = new Map();
    this.list = h("div", { class: "cards" });
    this.empty = h("p", { class: "empty" }, "No node is on this bus yet. Start one: ", h("code", {}, "zenostat node --building office-medium --weather USA_CO_Denver --name office"));
    fill(root, h("h2", { class: "visually-hidden" }, "Nodes"), this.empty, this.list);
    this.handlers = { overview: (content) => this.update(content.nodes) };
  }

  close() {}
  onView() {}

  update(nodes) {
    this.empty.hidden = nodes.length > 0;
    const names = new Set(nodes.map((entry) => entry.node));
    for (const name of this.cards.keys()) if (!names.has(name)) this.cards.delete(name);
    refill(this.list, nodes.map((entry) => this.card(entry)));
  }

  /** The card of a node, of which only what differs is made anew: a press on its link is a click. */
  card(entry) {
    const { node } = entry, text = JSON.stringify(entry);
    if (!this.cards.has(node)) {
      const name = h("a", { class: "name", href: address({ node }, false), onclick: (event) => link(event, { node }) }, node);
      this.cards.set(node, { element: h("article", { class: "panel card" }), head: h("div", { class: "row" }), name });
    }
    const card = this.cards.get(node);
    if (card.text !== text) this.show(card, entry);
    card.text = text;
    return card.element;
  }

  show({ element, head, name }, entry) {
    const [state, kind] = nodeState(entry);
    const open = entry.alarms?.open ?? 0;
    const share = entry.online ? entry.step / Math.max(1, entry.steps) : 0;
    const fact = (term, value) => value && [h("dt", {}, term), h("dd", {}, value)];
    refill(head, name, h("span", { class: "grow" }), open > 0 && h("span", { class: "chip alarm" }, counted(open, "alarm")), h("span", { class: `chip ${kind}` }, state));
    refill(element, head,
      h("p", { class: "muted" }, entry.branch_of ? `branch of ${entry.branch_of}` : [entry.building, entry.location || entry.weather].filter(Boolean).join(" · ")),
      entry.online ? [
        h("p", { class: "time" }, dateTime(entry.time)),
        h("progress", { max: 1, value: share, "aria-label": `Step ${entry.step} of ${entry.steps}` }),
        h("dl", { class: "facts" },
          fact("Pace", pace(entry)),
          fact("Power", entry.power_kw !== null && entry.power_kw !== undefined && withUnit(entry.power_kw, "kW")),
          fact(entry.outdoor_label, entry.outdoor !== null && entry.outdoor !== undefined && withUnit(entry.outdoor, "°C")),
          fact("In the band", entry.zones ? `${entry.comfortable} of ${counted(entry.zones, "zone")}` : null),
          fact("Controllers", entry.controllers.map((each) => each.state === "connected" ? each.controller : `${each.controller} (${words(each.state)})`).join(", ")),
          fact("Set by", entry.sources && (entry.sources.join(", ") || "baseline control")),
          fact("Faults", entry.faults.join(", ")),
          fact("Recording", entry.recording && words(entry.recording.state)),
          fact("Failure", entry.failure)),
      ] : h("p", { class: "problem" }, entry.problem));
  }
}
