// Logging in where the service asks for its token, and out again.

import { get, post } from "./api.js";
import { errorLine, field, fill, h } from "./dom.js";

/** Whether the page has to ask for the token, and whether there is a session to end. */
export function loginState(signal) {
  return get("/api/login", signal);
}

/** Asks for the token in place of the view; `done()` once the service has taken it. */
export function loginView(root, done) {
  const token = h("input", {
    id: "token",
    type: "password",
    required: true,
    maxlength: "1000",
    autocomplete: "current-password",
    autocapitalize: "off",
    spellcheck: "false",
  });
  const error = errorLine("login-error");
  const enter = h("button", { id: "log-in", type: "submit", class: "primary" }, "Log in");
  const form = h(
    "form",
    { class: "card login" },
    h("h1", {}, "Log in"),
    h(
      "p",
      { class: "muted" },
      "This service asks who you are: by a token of your own, which an admin gives you, or by the one that it was ",
      "started with. ",
      "A run goes on whether anybody is logged in or not.",
    ),
    h("input", { type: "text", autocomplete: "username", value: "calrig", hidden: true }), // whose it is
    field("token", "Token", token),
    error.element,
    h("div", { class: "buttons" }, enter),
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    enter.disabled = true;
    error.say(null);
    try {
      await post("/api/login", { token: token.value.trim() });
      done();
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      error.say(problem.status === 401 ? new Error("Nobody here has this token.") : problem);
      token.select();
    } finally {
      enter.disabled = false;
    }
  });
  fill(root, form);
  token.focus({ preventScroll: true });
}

/** Ends the session, and with it everything that this page shows. */
export async function logOut() {
  try {
    await post("/api/logout");
  } catch (problem) {
    if (problem.status !== 401) throw problem; // 401: it had ended already
  }
}
