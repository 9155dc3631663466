// Requests to the server, and the stream of changes.

import { h } from "./dom.js";

export class Failure extends Error {
  constructor(status, content) {
    super(content?.message ?? `the server answered with ${status}`);
    this.status = status;
    this.kind = content?.error ?? "";
  }
}

const SILENT_MS = 20_000;  // the server sends an event at least every 5 s
const ANSWER_MS = 70_000;  // the server waits for a node for 30 s, twice for faults

let isConnected = true;
let latest = null;  // id of the latest event
let waiting = new AbortController();  // ends all requests that wait

const NO_ANSWER = "the server of the control room does not answer";

async function request(path, { limit_ms = null, ...options } = {}) {
  const isRead = !options.method;
  if (!isRead && !isConnected) throw new Failure(0, { message: "no connection to the control room: nothing was sent" });
  let response, content;
  try {
    const { signal } = waiting, ends = limit_ms === null ? signal : AbortSignal.any([signal, AbortSignal.timeout(limit_ms)]);
    // The server refuses a change that a lost connection delivers late.
    const headers = { ...options.headers, ...(!isRead && latest && { "last-event-id": latest }) };
    response = await fetch(path, { credentials: "same-origin", cache: "no-store", ...options, headers, signal: ends });
    content = await response.json().catch((error) => { if (error instanceof SyntaxError) return null; throw error; });
  } catch {
    throw new Failure(0, { message: isRead ? NO_ANSWER : `${NO_ANSWER}; what was sent may be carried out all the same: see the audit log` });
  }
  if (!response.ok) throw new Failure(response.status, content);
  return content;
}

export const get = (path) => request(path);

export const post = (path, content = {}, settings = {}) =>
  request(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(content), ...settings });

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

/** Request a change of a node, and return the answer. */
export const changeNode = (node, operation, content = {}) => post(nodePath(node, operation), content, { limit_ms: ANSWER_MS });

/** Request a change of a node, and show the answer; returns whether it was accepted. */
export async function operate(node, operation, content = {}) {
  try {
    const answer = await changeNode(node, operation, content);
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
  let end = null;
  const show = () => {
    end?.();
    end = document.hidden ? null : stream(shown, handlers, (value) => { isConnected = value; onConnection(value); });
  };
  document.addEventListener("visibilitychange", show);
  show();
  return () => { document.removeEventListener("visibilitychange", show); end?.(); };
}

/** Receive events; when none has come for a while, give up what is waiting, and connect anew. */
function stream(shown, handlers, onConnection) {
  let source, timer;
  const lose = () => {
    onConnection(false);
    waiting.abort();
    waiting = new AbortController();
    source.close();
    connect();
  };
  const watch = () => { clearTimeout(timer); timer = setTimeout(lose, SILENT_MS); };
  const onEvent = () => { onConnection(true); watch(); };
  const connect = () => { source = openStream(shown, { alive: () => {}, ...handlers }, onEvent, () => onConnection(false)); watch(); };
  connect();
  return () => { clearTimeout(timer); source.close(); };
}

function openStream(shown, handlers, onEvent, onError) {
  const query = new URLSearchParams(Object.entries(shown).filter(([, value]) => value));
  const source = new EventSource(`/api/stream?${query}`);
  for (const [kind, handle] of Object.entries(handlers)) {
    source.addEventListener(kind, (event) => {
      latest = event.lastEventId;
      onEvent();
      handle(JSON.parse(event.data));
    });
  }
  source.addEventListener("error", () => {
    onError();
    if (source.readyState === EventSource.CLOSED) {
      // The session has ended, or the server is gone for good; a new page finds out.
      setTimeout(() => get("/api/session").then((me) => !me.operator && location.reload()).catch(() => {}), 2000);
    }
  });
  return source;
}
