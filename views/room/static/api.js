// Requests to the server, and the stream of changes.

import { h } from "./dom.js";

export class Failure extends Error {
  constructor(status, content) {
    super(content?.message ?? `the server answered with ${status}`);
    this.status = status;
    this.kind = content?.error ?? "";
  }
}

async function request(path, options) {
  let response;
  try {
    response = await fetch(path, { credentials: "same-origin", cache: "no-store", ...options });
  } catch {
    throw new Failure(0, { message: "the server of the control room does not answer" });
  }
  const content = await response.json().catch(() => null);
  if (!response.ok) throw new Failure(response.status, content);
  return content;
}

export const get = (path) => request(path);

export const post = (path, content = {}) =>
  request(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(content) });

export const remove = (path) => request(path, { method: "DELETE" });

export const nodePath = (node, part = "") => `/api/nodes/${encodeURIComponent(node)}${part && `/${part}`}`;

/** Show a short message; errors stay longer. */
export function toast(text, isError = false) {
  const message = h("div", { class: isError ? "toast error" : "toast", role: isError ? "alert" : null }, text);
  const box = document.getElementById("toasts");
  box.append(message);
  while (box.childElementCount > 4) box.firstElementChild.remove();
  setTimeout(() => message.remove(), isError ? 12000 : 5000);
}

/** Copy an element's text; where the browser does not permit that, select it. */
export async function copyText(element) {
  try {
    await navigator.clipboard.writeText(element.textContent);
    toast("copied");
  } catch { getSelection().selectAllChildren(element); toast("Press Ctrl-C to copy the selection."); }
}

/** Request a change of a node, and show the answer; returns whether it was accepted. */
export async function operate(node, operation, content = {}) {
  try {
    const answer = await post(nodePath(node, operation), content);
    toast(answer.text);
    return true;
  } catch (error) {
    toast(error.message, true);
    return false;
  }
}

/**
 * Follow the list of nodes and one node, or what a page shows; returns a function that ends it. A page that is hidden
 * does not follow, since a browser has few connections to a server; when it is shown, it begins with the latest state.
 */
export function follow(shown, handlers, onConnection) {
  let source = null;
  const show = () => {
    source?.close();
    source = document.hidden ? null : stream(shown, handlers, onConnection);
  };
  document.addEventListener("visibilitychange", show);
  show();
  return () => { document.removeEventListener("visibilitychange", show); source?.close(); };
}

function stream(shown, handlers, onConnection) {
  const query = new URLSearchParams(Object.entries(shown).filter(([, value]) => value));
  const source = new EventSource(`/api/stream?${query}`);
  for (const [kind, handle] of Object.entries(handlers)) {
    source.addEventListener(kind, (event) => handle(JSON.parse(event.data)));
  }
  source.addEventListener("open", () => onConnection(true));
  source.addEventListener("error", () => {
    onConnection(false);
    if (source.readyState === EventSource.CLOSED) {
      // The session has ended, or the server is gone for good; a new page finds out.
      setTimeout(() => get("/api/session").then((me) => !me.operator && location.reload()).catch(() => {}), 2000);
    }
  });
  return source;
}
