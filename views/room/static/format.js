// Numbers, units, times and durations as texts.

const THIN = "\u202f";

/** Digits after the point, by unit. */
function digits(unit, size) {
  if (unit === "people") return size < 10 && size % 1 ? 1 : 0;
  if (unit === "°C" || unit === "K" || unit === "%") return 1;
  if (size >= 1000) return 0;
  if (size >= 100) return 0;
  if (size >= 1) return size >= 10 ? 1 : 2;
  return 3;
}

/** A number with digits that suit its unit; an en dash where there is none. */
export function num(value, unit = "") {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if ((size === 0 && unit !== "°C") || (unit === "kW" && size < 5e-7)) return "0";
  if (size !== 0 && (size < 5e-4 || size >= 1e7)) return value.toExponential(2).replace("-", "\u2212");
  const text = value.toFixed(digits(unit, size));
  const plain = unit === "°C" || unit === "kW" || !text.includes(".") ? text : text.replace(/0+$/, "").replace(/\.$/, "");
  return plain.replace("-", "\u2212").replace(/\B(?=(\d{3})+(?!\d))(?<!\.\d*)/g, THIN);
}

/** Numbers of an axis, with as many digits as their distance needs; with an exponent if they are very large or small. */
export function ticks(values) {
  const step = Math.abs((values[1] ?? 1) - (values[0] ?? 0)) || 1;
  const largest = Math.max(step, ...values.map(Math.abs));
  const exponent = Math.floor(Math.log10(step) + 1e-9), multiple = step / 10 ** exponent;
  const last = Math.abs(multiple - Math.round(multiple)) > 1e-6 ? exponent - 1 : exponent;  // of 2.5 it is that of 0.5
  const places = Math.max(0, -last);
  return values.map((value) => {
    if (largest >= 1e6 || places > 6) {
      if (value === 0) return "0";
      const digits = Math.floor(Math.log10(Math.abs(value)) + 1e-9) - last;
      return value.toExponential(Math.min(12, Math.max(0, digits))).replaceAll("-", "\u2212");
    }
    return value.toFixed(places).replace("-", "\u2212").replace(/\B(?=(\d{3})+(?!\d))(?<!\.\d*)/g, THIN);
  });
}

/** A number with its unit; a power below 0.1 kW is in W. */
export function withUnit(value, unit) {
  if (unit === "kW" && Math.abs(value) >= 5e-7 && Math.abs(value) < 0.1) return withUnit(value * 1e3, "W");
  const text = num(value, unit);
  return text === "–" || !unit ? text : `${text}\u00a0${unit}`;
}

/** A number that somebody has chosen, with six significant digits and its unit; an en dash where there is none. */
export function exact(value, unit) {
  if (value === null || value === undefined) return "–";
  const text = String(Number(value.toPrecision(6))).replaceAll("-", "\u2212");
  return unit ? `${text}\u00a0${unit}` : text;
}

/** A point's value in the unit that is shown; null where EnergyPlus has none. */
export function shown(point, value) {
  return value === null || value === undefined || value === point.unset ? null : value * (point.factor ?? 1);
}

export const DAYS = ["Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"];
const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/** Seconds since 1970 of a simulated time, as if it were UTC. */
export function seconds(time) {
  return Date.parse(`${time}Z`) / 1000;
}

/** `Sun 2 Jul 2017, 18:15`. */
export function dateTime(time) {
  const date = new Date(`${time}Z`);
  if (Number.isNaN(date.getTime())) return time ?? "";
  return `${DAYS[date.getUTCDay()]} ${date.getUTCDate()} ${MONTHS[date.getUTCMonth()]} ${date.getUTCFullYear()}, ${clock(date)}`;
}

/** `2 Jul 18:15`. */
export function shortTime(time) {
  const date = new Date(`${time}Z`);
  if (Number.isNaN(date.getTime())) return time ?? "";
  return `${date.getUTCDate()} ${MONTHS[date.getUTCMonth()]} ${clock(date)}`;
}

/** `18:15`, and with a distance below a minute or a second between times `18:15:01` or `18:15:01.250`. */
export function clock(date, step_s = 60) {
  return date.toISOString().slice(11, step_s >= 60 ? 16 : step_s >= 1 ? 19 : 23);
}

/** The begin of the hours until a simulated time, such as `2017-07-02T18:15:00`; null if that is before the earliest time. */
export function hoursBefore(time, hours, earliest) {
  const begin = new Date((seconds(time) - hours * 3600) * 1000).toISOString().slice(0, 19);
  return begin < earliest ? null : begin;
}

/** Simulated seconds per second as `15 min/s`, `1 h/s` or `60×`. */
export function rate(speed) {
  if (speed === null || speed === undefined) return "";
  if (speed < 60) return `${num(speed)}×`;
  if (speed < 3600) return `${num(Math.round(speed / 6) / 10)} min/s`;
  if (speed < 86400) return `${num(Math.round(speed / 360) / 10)} h/s`;
  return `${num(Math.round(speed / 8640) / 10)} d/s`;
}

/** A duration in seconds as `2 h` or `15 min`. */
export function duration(time) {
  if (time < 120) return `${num(time)} s`;
  if (time < 7200) return `${num(time / 60)} min`;
  if (time < 172800) return `${num(time / 3600)} h`;
  return `${num(time / 86400)} d`;
}

/** Bytes as `1.2 MB`. */
export function bytes(count) {
  if (count < 1e3) return `${count} B`;
  if (count < 1e6) return `${num(count / 1e3)} kB`;
  return count < 1e9 ? `${num(count / 1e6)} MB` : `${num(count / 1e9)} GB`;
}

/** A number with its noun: `1 zone`, `2 zones`. */
export const counted = (count, noun) => `${num(count, "people")} ${noun}${count === 1 ? "" : "s"}`;

/** `out_of_service` as `out of service`. */
export function words(text) {
  return String(text).replaceAll("_", " ");
}
