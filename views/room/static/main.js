// The page: sign-in, and the list of nodes or one node, by the address.

import { follow, get, post, remove, toast } from "./api.js";
import { AuditPage } from "./audit.js";
import { BuilderPage } from "./builder.js";
import { fill, h, icon } from "./dom.js";
import { NodePage } from "./node.js";
import { Overview } from "./overview.js";
import { isOperator, refusalNote, signedIn } from "./session.js";
import { TrainingsPage } from "./trainings.js";
import { address, change, link, onView, view } from "./view.js";

const PAGES = { builder: [BuilderPage, "Scenario builder"], trainings: [TrainingsPage, "Trainings"], audit: [AuditPage, "Audit log"] };

const main = document.getElementById("main");
const header = document.getElementById("header");
let page = null;
let stop = null;
let shown = null;
let operator = null;
let connection;

function theme(next) {
  if (next) {
    document.documentElement.dataset.theme = next;
    try { localStorage.setItem("theme", next); } catch { /* private windows */ }
  }
  return document.documentElement.dataset.theme
    ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
}

async function signIn() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token) {
    history.replaceState(null, "", location.pathname + location.search);
    try {
      return (await post("/api/session", { token })).operator;
    } catch (error) {  // a link that was used, maybe by this browser
      const { operator: user } = await get("/api/session");
      if (!user) throw error;
      return user;
    }
  }
  const { operator: user, denial } = await get("/api/session");
  if (denial) throw new Error(denial);  // of a certificate that has expired, or a name without a role
  return user;
}

/** Pages that this server has. */
async function choosePages() {
  const user = await get("/api/session");
  if (!user.trainings) delete PAGES.trainings;
  signedIn(user);
  if (!isOperator()) { delete PAGES.builder; delete PAGES.audit; }
}

function showSignIn(message) {
  fill(header, h("h1", {}, "Control room"));
  const input = h("input", { id: "link", required: true, autocomplete: "off", spellcheck: "false" });
  const submit = async (event) => {
    event.preventDefault();
    const token = input.value.trim().replace(/^.*#token=/, "");
    try {
      await post("/api/session", { token });
      location.reload();
    } catch (error) { toast(error.message, true); }
  };
  fill(main, h("form", { class: "panel sign-in", onsubmit: submit },
    h("h2", {}, "Sign in"),
    message && h("p", { role: "alert", class: "problem" }, message),
    h("p", {}, "Open the link that ", h("code", {}, "zenostat room"), " printed, or paste it here. Each link signs one browser in."),
    h("label", { for: "link" }, "Link"), input, h("button", { class: "primary" }, "Sign in")));
}

async function invite() {
  const dialog = h("dialog", { "aria-label": "Session" });
  const name = h("input", { id: "invited", required: true, maxlength: 64, value: operator });
  const output = h("output", { class: "link" });
  const submit = async (event) => {
    event.preventDefault();
    try {
      output.textContent = (await post("/api/invitation", { operator: name.value })).link;
    } catch (error) { toast(error.message, true); }
  };
  fill(dialog, h("form", { class: "stack", onsubmit: submit },
    h("h2", {}, isOperator() ? "Another browser" : "Session"),
    isOperator() ? [h("p", {}, "A link signs one browser in, once. Changes are recorded under the name."),
      h("label", { for: "invited" }, "Name"), name, output] : refusalNote(),
    h("div", { class: "row end" },
      h("button", { type: "button", onclick: async () => { await remove("/api/session"); location.assign("/"); } }, "Sign out"),
      h("button", { type: "button", onclick: () => dialog.close() }, "Close"),
      isOperator() && h("button", { class: "primary" }, "Create link"))));
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}

function showHeader() {
  connection = h("span", { class: "chip warning", hidden: true, role: "status" }, "no connection");
  fill(header,
    h("a", { class: "home", href: "/", onclick: (event) => link(event, {}) },
      h("img", { src: "/static/icon.svg", alt: "", width: 26, height: 26 }), h("h1", {}, "Control room")),
    h("nav", { id: "pages", "aria-label": "Pages" }),
    h("span", { id: "crumbs" }),
    h("span", { class: "grow" }), connection,
    h("button", { class: "quiet", "aria-label": "Light or dark", title: "Light or dark",
      onclick: () => { theme(theme() === "dark" ? "light" : "dark"); page?.redraw?.(); } }, icon("moon")),
    h("button", { class: "quiet", onclick: invite, title: "Session" }, icon("user"), h("span", { class: "wide" }, operator), !isOperator() && h("span", { class: "chip muted" }, "reads only")));
}

function showPages(name, node) {
  const entries = [["", "Nodes"], ...Object.entries(PAGES).map(([each, [, text]]) => [each, text])];
  fill(document.getElementById("pages"), entries.map(([each, text]) => h("a", {
    href: address({ page: each }, false), "aria-current": each === name && !node ? "page" : null, onclick: (event) => link(event, { page: each }) }, text)));
  fill(document.getElementById("crumbs"), node && [h("span", { "aria-hidden": "true" }, "›"), h("span", { class: "crumb", title: node }, node)]);
}

function show() {
  const node = view().node ?? null;
  const name = !node && Object.hasOwn(PAGES, view().page ?? "") ? view().page : "";
  const key = node ? `node ${node}` : `page ${name}`;
  if (page && key === shown) { page.onView(); return; }
  shown = key;
  stop?.();
  page?.close();
  fill(document.getElementById("drawer"));
  page = node ? new NodePage(main, node, operator) : name ? new PAGES[name][0](main) : new Overview(main);
  showPages(name, node);
  const title = node ?? PAGES[name]?.[1];
  document.title = title ? `${title} – Control room` : "Control room";
  stop = follow({ node, page: name }, page.handlers, (isConnected) => { connection.hidden = isConnected; document.body.classList.toggle("unconnected", !isConnected); });
}

async function start() {
  try { const kept = localStorage.getItem("theme"); if (kept === "dark" || kept === "light") theme(kept); } catch { /* private windows */ }
  try {
    operator = await signIn();
  } catch (error) {
    showSignIn(error.message);
    return;
  }
  if (!operator) { showSignIn(""); return; }
  await choosePages();
  showHeader();
  onView(show);
  show();
}

addEventListener("keydown", (event) => {
  const isTyping = event.target.closest?.("input, select, textarea, dialog");
  if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "/") {
    const search = document.querySelector("input[type=search]");
    if (!search) return;
    event.preventDefault();
    if (search.closest("[hidden]")) change({ table: "points" }, { replace: true });
    search.focus();
  } else if (event.key === "Escape" && view().point) change({ point: null });
  else page?.onKey?.(event);
});

start();
