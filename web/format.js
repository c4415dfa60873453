// Numbers and times as text: value ± standard error to two digits of the error, always with the unit.

export const NOT_KNOWN = "not known";
const MINUS = "−";

export function isKnown(value) {
  return value !== null && value !== undefined;
}

function withUnit(text, unit) {
  if (!unit) return text;
  return unit === "°" ? `${text}°` : `${text}\u00a0${unit}`;
}

/** A number with so many decimals and a true minus sign; never "−0.00". */
export function fixed(value, decimals, unit = "") {
  if (!isKnown(value)) return NOT_KNOWN;
  const digits = Math.abs(value).toFixed(decimals);
  const negative = value < 0 && Number(digits) !== 0;
  return withUnit((negative ? MINUS : "") + digits, unit);
}

/** A number to so many significant digits, without an exponent where it stays readable. */
export function significant(value, digits = 3, unit = "") {
  if (!isKnown(value)) return NOT_KNOWN;
  if (value === 0) return withUnit("0", unit);
  const size = Math.abs(value);
  if (size < 1e-6 || size >= 1e7) return withUnit(value.toExponential(digits - 1).replace("-", MINUS), unit);
  return fixed(value, decimalsFor(size, digits), unit);
}

function decimalsFor(size, digits) {
  return Math.min(12, Math.max(0, digits - 1 - Math.floor(Math.log10(size))));
}

/** A standard error below it is rounding, and would be printed as twelve zeros. */
const LEAST_STD = 1e-11;

/** "0.812 ± 0.013°": both to the second digit of the standard error. */
export function plusMinus(value, std, unit = "") {
  if (!isKnown(value)) return NOT_KNOWN;
  if (!isKnown(std) || std < LEAST_STD) return significant(value, 4, unit);
  const decimals = decimalsFor(std, 2);
  return withUnit(`${fixed(value, decimals)} ± ${fixed(std, decimals)}`, unit);
}

export function range(low, high, decimals, unit) {
  if (!isKnown(low) || !isKnown(high)) return NOT_KNOWN;
  const [from, to] = [fixed(low, decimals), fixed(high, decimals)];
  return from === to ? withUnit(from, unit) : withUnit(`${from} to ${to}`, unit);
}

export function duration(seconds) {
  if (!isKnown(seconds)) return NOT_KNOWN;
  const whole = Math.max(0, Math.round(seconds));
  const [hours, minutes, rest] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  if (hours) return `${hours}\u00a0h ${String(minutes).padStart(2, "0")}\u00a0min`;
  if (minutes) return `${minutes}\u00a0min ${String(rest).padStart(2, "0")}\u00a0s`;
  return `${rest}\u00a0s`;
}

const MOMENT = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "short" });

const DAY = new Intl.DateTimeFormat(undefined, { dateStyle: "medium" });

/** The day of a moment, where the hour does not matter; otherwise as `moment`. */
export const day = (iso) => moment(iso, DAY);

/** A moment in the reader's own time zone; the exact UTC stays in `datetime` and the tooltip. */
export function moment(iso, format = MOMENT) {
  if (!iso) return document.createTextNode("–");
  const element = document.createElement("time");
  element.dateTime = iso;
  element.title = iso;
  element.textContent = format.format(new Date(iso));
  return element;
}

/** The moment at which a day such as "2026-11-22" begins in the reader's own time zone, in UTC. */
export function dayStart(day, days = 0) {
  const [year, month, date] = day.split("-").map(Number);
  return new Date(year, month - 1, date + days).toISOString();
}

/** The moment at which the day ends. */
export const dayEnd = (day) => dayStart(day, 1);

/** The local time zone, used for every time on the page. */
export function timeZone() {
  const format = new Intl.DateTimeFormat(undefined, { timeZoneName: "shortOffset" });
  const offset = format.formatToParts(new Date()).find(({ type }) => type === "timeZoneName").value;
  return `${format.resolvedOptions().timeZone} (${offset})`;
}

/** A moment as a chart takes it: its digits in the reader's own time zone, without one. */
export function localDigits(iso) {
  const at = new Date(iso);
  return new Date(at.getTime() - 60_000 * at.getTimezoneOffset()).toISOString().slice(0, -1);
}

export function plural(count, one, many = `${one}s`) {
  return `${count.toLocaleString()} ${count === 1 ? one : many}`;
}
