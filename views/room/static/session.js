// The user of the page, and whether this user may change anything.

import { h } from "./dom.js";

let name = null;
let role = null;

/** Keep who has signed in: a name, and `operator` or `monitor`. */
export function signedIn(user) { ({ operator: name, role } = user); }

/** Whether the user may change nodes and files; the server refuses the changes of all others. */
export const mayChange = () => role !== "monitor";

/** Why the user may not change anything; null for an operator. */
export const refusal = () => (mayChange() ? null : `${name} is a monitor, who changes nothing; an operator may.`);

/** Attributes of a control that changes something: disabled with the reason for a monitor, else these. */
export const forOperators = (attributes = {}) => (mayChange() ? attributes : { ...attributes, disabled: true, title: refusal(), "aria-description": refusal() });

/** A sentence in place of a form whose changes the server would refuse. */
export const refusalNote = () => h("p", { class: "muted" }, refusal());
