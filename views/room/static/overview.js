// The list of all nodes.

import { fill, h } from "./dom.js";
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
    for (const [name, card] of this.cards) if (!names.has(name)) { card.remove(); this.cards.delete(name); }
    nodes.forEach((entry) => {
      const previous = this.cards.get(entry.node);
      const text = JSON.stringify(entry);
      if (previous?.dataset.content === text) return;
      const card = this.card(entry);
      card.dataset.content = text;
      const hasFocus = previous?.contains(document.activeElement);
      if (previous) previous.replaceWith(card); else this.list.append(card);
      if (hasFocus) card.querySelector("a").focus();
      this.cards.set(entry.node, card);
    });
    nodes.forEach((entry, place) => {  // only those out of place: a card that moves loses the focus
      const card = this.cards.get(entry.node), at = this.list.children[place];
      if (card !== at) this.list.insertBefore(card, at ?? null);
    });
  }

  card(entry) {
    const [state, kind] = nodeState(entry);
    const open = entry.alarms?.open ?? 0;
    const share = entry.online ? entry.step / Math.max(1, entry.steps) : 0;
    const fact = (name, value) => value && [h("dt", {}, name), h("dd", {}, value)];
    return h("article", { class: "panel card" },
      h("div", { class: "row" },
        h("a", { class: "name", href: address({ node: entry.node }, false), onclick: (event) => link(event, { node: entry.node }) }, entry.node),
        h("span", { class: "grow" }),
        open > 0 && h("span", { class: "chip alarm" }, counted(open, "alarm")),
        h("span", { class: `chip ${kind}` }, state)),
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
