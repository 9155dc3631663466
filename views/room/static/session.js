// The user of the page, and whether this user may change anything on it.

import { h } from "./dom.js";

let name = null;
let role = null;
let isReplay = false;

/** Keep who has signed in: a name, and `operator` or `monitor`. */
export function signedIn(user) { ({ operator: name, role } = user); }

/** Keep whether the page is that of a replay. */
export function showsReplay(value) { isReplay = value; }

/** Whether the user may change nodes and files; the server refuses the changes of all others. */
export const isOperator = () => role !== "monitor";

/** Whether the user may change the node of the page: a replay takes no requests. */
export const mayChange = () => isOperator() && !isReplay;

/** Why the user may not change anything; null if it is permitted. */
export const refusal = () => {
  if (!isOperator()) return `${name} may only read; changes need an operator.`;
  return isReplay ? "This is the replay of a recording, which takes no requests." : null;
};

/** Attributes of a control that changes something: disabled with the reason where it is refused, else these. */
export const forOperators = (attributes = {}) => (mayChange() ? attributes : { ...attributes, disabled: true, title: refusal(), "aria-description": refusal() });

/** A sentence in place of a form whose changes the server would refuse. */
export const refusalNote = () => h("p", { class: "muted" }, refusal());
