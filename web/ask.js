// Dialogs before a lasting change: with a reason, or with a confirmation alone. The event "calrig:done" follows the
// change, so that views read it.

import { button, errorLine, h, held, markWrong } from "./dom.js";

/**
 * Asks for a reason in a dialog and calls `act(reason)`; an error of `act` is shown there and the dialog
 * stays open. Resolves to whether it was done.
 */
export function askReason(question, act) {
  const reason = h("textarea", { id: "reason", required: true, maxlength: "1000", rows: "3" });
  const fields = [question.before, h("label", { for: "reason" }, "Reason"), reason];
  return ask({ kind: "danger", ...question, fields }, () => act(reason.value));
}

/** As `askReason`, without a reason. `question.before` are further fields. */
export function askConfirmation(question, act) {
  return ask({ ...question, fields: [question.before], kind: "primary" }, act);
}

/** A button that asks for confirmation, then calls `act`; `done()` follows its success. */
export function confirmButton(text, question, act, done, props = {}) {
  return button(text, async () => (await askConfirmation(question, act)) && done(), props);
}

function ask({ title, text, action, fields, kind }, act) {
  const confirm = h("button", { type: "submit", class: kind, "data-testid": "confirm" }, action);
  const cancel = h("button", { type: "button" }, "Cancel");
  const error = errorLine("ask-error");
  const form = h(
    "form",
    {},
    h("h2", { id: "ask-title" }, title),
    h("p", {}, text),
    fields,
    error.element,
    h("div", { class: "buttons end" }, cancel, confirm),
  );
  const dialog = h("dialog", { "aria-labelledby": "ask-title" }, form);
  const view = document.getElementById("view");
  const had = document.activeElement;
  document.body.append(dialog);
  return new Promise((resolve) => {
    let done = false;
    cancel.addEventListener("click", () => dialog.close());
    dialog.addEventListener("close", () => {
      dialog.remove();
      view.inert = false;
      if (document.activeElement === document.body) (had.isConnected ? had : view).focus({ preventScroll: true });
      resolve(done);
    });
    dialog.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      event.stopPropagation(); // on a live page the key alone stops the stage
      dialog.close();
    });
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const release = held(confirm);
      error.say(null);
      try {
        await act();
        done = true;
        window.dispatchEvent(new Event("calrig:done"));
        dialog.close();
      } catch (problem) {
        error.say(problem);
        markWrong(form, problem.fields)?.focus();
      } finally {
        release();
      }
    });
    window.addEventListener("hashchange", () => dialog.close(), { once: true }); // leaving the view closes it
    const { bottom } = document.querySelector(".frame").getBoundingClientRect();
    dialog.style.setProperty("--above", `${bottom}px`);
    view.inert = true; // not a modal dialog: the stop buttons above it must take a click at any time
    dialog.show();
  });
}
