// Elements from texts and functions; texts are never HTML.

const SVG = "http://www.w3.org/2000/svg";

/** Children of all lists, without those that are nothing. */
const shown = (children) => children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false);

function build(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "value" || name === "checked" || name === "selected") element[name] = value;
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...shown(children));
  return element;
}

/** Create an HTML element: `h("button", {onclick: stop}, "Stop")`. */
export function h(tag, attributes, ...children) {
  return build(document.createElement(tag), attributes, children);
}

/** Create an SVG element. */
export function s(tag, attributes, ...children) {
  return build(document.createElementNS(SVG, tag), attributes, children);
}

/** Replace an element's children. */
export function fill(element, ...children) {
  element.replaceChildren(...shown(children));
  return element;
}

const labelOf = (control) => control.getAttribute("aria-label") ?? control.textContent;

/**
 * Replace an element's children by elements. Those that it has already stay in place, so that a press on them is a click;
 * the focus stays on its control, or that of the same label, or else on the element.
 */
export function refill(element, ...children) {
  const focused = document.activeElement, hadFocus = element.contains(focused) && element !== focused;
  const next = shown(children);
  for (const child of [...element.childNodes]) if (!next.includes(child)) child.remove();
  next.forEach((child, place) => {
    if (child !== element.childNodes[place]) element.insertBefore(child, element.childNodes[place] ?? null);
  });
  if (!hadFocus || document.activeElement === focused) return;
  const controls = [...element.querySelectorAll("a, button, input, select, summary")];
  const control = controls.find((each) => each === focused) ?? controls.find((each) => labelOf(each) === labelOf(focused));
  if (!control) { element.tabIndex = -1; element.dataset.kept = ""; }
  (control ?? element).focus();
}

/** Set an element's text, if it has changed. */
export function setText(element, text) {
  const next = String(text ?? "");
  if (element.textContent !== next) element.textContent = next;
}

/** Set or remove an attribute, if it has changed. */
export function setAttribute(element, name, value) {
  if (value === null || value === undefined || value === false) {
    if (element.hasAttribute(name)) element.removeAttribute(name);
  } else if (element.getAttribute(name) !== String(value)) element.setAttribute(name, String(value));
}

/** A drawing for a button, from paths in a box of 24 by 24. */
export function icon(name) {
  const paths = {
    pause: "M8 5v14M16 5v14",
    play: "M7 4.5v15l12-7.5z",
    step: "M5 5v14l9-7zM18 5v14",
    reset: "M4 4v6h6M4.6 10a8 8 0 1 1-.4 4.5",
    record: "M12 7a5 5 0 1 0 0 10a5 5 0 0 0 0-10z",
    close: "M6 6l12 12M18 6L6 18",
    chart: "M4 19h16M5 15l5-5 4 3 5-7",
    back: "M15 5l-7 7 7 7",
    moon: "M19 14.5A7.5 7.5 0 0 1 9.5 5a7.5 7.5 0 1 0 9.5 9.5z",
    user: "M12 12a4 4 0 1 0 0-8a4 4 0 0 0 0 8zM4.5 20a7.5 7.5 0 0 1 15 0",
  };
  return s("svg", { viewBox: "0 0 24 24", class: "icon", "aria-hidden": "true" }, s("path", { d: paths[name] }));
}

/** A panel with a heading; its content is filled by the caller. */
export function panel(title, attributes, ...children) {
  const id = `panel-${title.toLowerCase().replace(/[^a-z]+/g, "-")}`;
  return h("section", { class: "panel", "aria-labelledby": id, ...attributes },
    h("h2", { id }, title), ...children);
}

/** Open a dialog: content between a heading and *Cancel*; the button `action` closes it and calls `submit`. */
export function openDialog({ title, action = title, label = title, submit }, ...content) {
  const dialog = h("dialog", { "aria-label": label });
  const accept = (event) => { event.preventDefault(); dialog.close(); submit(); };
  fill(dialog, h("form", { class: "stack", onsubmit: accept }, h("h2", {}, title), content,
    h("div", { class: "row end" }, h("button", { type: "button", onclick: () => dialog.close() }, "Cancel"), h("button", { class: "primary" }, action))));
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
  return dialog;
}
