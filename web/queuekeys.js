// Input of a bar-code reader, which types like a keyboard wherever the focus is.

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
