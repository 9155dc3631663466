// The audit log: who has changed what.

import { fill, h } from "./dom.js";
import { words } from "./format.js";
import { address, link } from "./view.js";

/** The content of a request in words; its text if it is not JSON. */
function requestText(text) {
  try {
    return Object.entries(JSON.parse(text)).map(([name, value]) => `${words(name)} ${JSON.stringify(value)}`).join(", ");
  } catch { return text; }
}

const KINDS = new Map([[true, null], [false, "worse"], [null, "warm"]]);

export class AuditPage {
  constructor(root) {
    this.rows = h("tbody");
    this.empty = h("p", { class: "empty" }, "Nothing has been changed since the control room was started.");
    fill(root, h("section", { class: "panel", "aria-labelledby": "audit-heading" }, h("h2", { id: "audit-heading" }, "Audit log"), this.empty,
      h("div", { class: "scroll audit", tabindex: 0, role: "region", "aria-label": "Changes, the latest first" }, h("table", {},
        h("thead", {}, h("tr", {}, ["Time", "Who", "Change", "Of", "Outcome"].map((head) => h("th", { scope: "col" }, head)))), this.rows))));
    this.handlers = { overview: () => {}, audit: (content) => this.show(content.entries) };
  }

  close() {}
  onView() {}

  show(entries) {
    this.empty.hidden = entries.length > 0;
    fill(this.rows, [...entries].reverse().map((entry) => h("tr", {},
      h("td", {}, h("time", { datetime: entry.time }, `${entry.time.slice(0, 19).replace("T", " ")} UTC`)), h("td", {}, entry.operator), h("td", {}, words(entry.operation), entry.request && h("p", { class: "muted" }, requestText(entry.request))),
      h("td", {}, ["invite", "save scenario", "make report"].includes(entry.operation) || !entry.target ? entry.target : h("a", { href: address({ node: entry.target }, false), onclick: (event) => link(event, { node: entry.target }) }, entry.target)),
      h("td", { class: KINDS.get(entry.accepted) }, entry.outcome === "requested" ? "requested; not answered yet" : entry.outcome))));
  }
}
