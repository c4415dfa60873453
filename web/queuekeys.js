// Input of a bar-code reader, which types like a keyboard wherever the focus is.

export const SCANNER_MS = 400; // an Enter so soon after a serial number is the line feed of the scanner
export const CALM_MS = 700; // an Enter that was meant for the previous instruction starts nothing

const TAKES_LETTERS = "input:not([type=checkbox], [type=radio], [type=file]), textarea, select, dialog";
const TAKES_ENTER = "input, textarea, select, dialog, button, a, summary";

const SYMBOLOGY = /^\][A-Za-z][0-9A-Za-z]/; // ISO/IEC 15424: "]C1" before a GS1-128, if the reader is set to send it

/** The serial number in what a reader has typed. */
export function asRead(line) {
  return line.trim().replace(SYMBOLOGY, "");
}

/** Directs keys that no other control takes to the end of `input`: letters also while a button has the focus. */
export function readerTypesInto(input, signal) {
  const heard = ({ key, ctrlKey, altKey, metaKey }) => {
    const isLetter = key.length === 1 && key !== " " && !ctrlKey && !altKey && !metaKey;
    const taken = isLetter ? TAKES_LETTERS : key === "Enter" && TAKES_ENTER;
    if (!taken || document.activeElement?.closest(taken)) return;
    input.focus({ preventScroll: true }); // without scrolling
    input.setSelectionRange(input.value.length, input.value.length);
  };
  document.addEventListener("keydown", heard, { signal });
}

let typedAt = -Infinity;
const typed = ({ key }) => {
  if (key.length === 1 && key !== " ") typedAt = performance.now();
};
document.addEventListener("keydown", typed, { capture: true });

/**
 * Keeps the Enter of a reader, and one that was meant for what was there before, from pressing a button or link: then
 * `refuse()` is called. The function returned begins the pause anew.
 */
export function guarded(control, refuse) {
  let calmFrom = performance.now();
  const isKept = ({ detail }) => {
    const now = performance.now();
    return detail === 0 && (now - calmFrom < CALM_MS || now - typedAt < SCANNER_MS); // detail 0: by keyboard
  };
  const keep = (event) => {
    if (!isKept(event)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    refuse();
  };
  control.addEventListener("click", keep, { capture: true });
  control.addEventListener("keydown", (event) => event.repeat && event.key === "Enter" && event.preventDefault());
  return () => (calmFrom = performance.now());
}
