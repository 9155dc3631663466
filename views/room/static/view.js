// What the page shows, as its address: whoever opens the address sees the same.

const listeners = new Set();

/** Parameters of the address, with all their values as texts. */
export function view() {
  return Object.fromEntries(new URLSearchParams(location.search));
}

/** The address of this page with other parameters; null removes one. */
export function address(changes, keep = true) {
  const parameters = new URLSearchParams(keep ? location.search : "");
  for (const [name, value] of Object.entries(changes)) {
    if (value === null || value === undefined || value === "") parameters.delete(name);
    else parameters.set(name, value);
  }
  const text = parameters.toString().replaceAll("%2C", ",");
  return text ? `/?${text}` : "/";
}

/** Change parameters of the address; `replace` keeps the way back as it is. */
export function change(changes, { replace = false, keep = true } = {}) {
  const next = address(changes, keep);
  if (next === location.pathname + location.search) return;
  history[replace ? "replaceState" : "pushState"](null, "", next);
  for (const listener of [...listeners]) listener();
}

/** Call a function when the address has changed. */
export function onView(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

addEventListener("popstate", () => { for (const listener of [...listeners]) listener(); });

/** Follow a link within the page without loading it again. */
export function link(event, changes, keep = false) {
  if (event.ctrlKey || event.metaKey || event.shiftKey || event.button) return;
  event.preventDefault();
  change(changes, { keep });
}
