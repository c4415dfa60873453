// Login where the service requires a token, and logout.

import { get, post } from "./api.js";
import { errorLine, field, fill, h, onSubmit } from "./dom.js";

/** Whether the service requires a token, and whether there is a session. */
export function loginState(signal) {
  return get("/api/login", signal);
}

/** The login form in place of the view; `done()` is called once the service has accepted the token. */
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
      "This service requires a token: your own, which an admin gives you, or the one it was started with. ",
      "Runs continue whether or not anybody is logged in.",
    ),
    h("input", { type: "text", autocomplete: "username", value: "calrig", hidden: true }), // for password managers
    field("token", "Token", token),
    error.element,
    h("div", { class: "buttons" }, enter),
  );
  onSubmit(form, enter, error, async () => {
    try {
      await post("/api/login", { token: token.value.trim() });
      done();
    } catch (problem) {
      token.select();
      throw problem.status === 401 ? new Error("The service does not know this token.") : problem;
    }
  });
  fill(root, form);
  token.focus({ preventScroll: true });
}

/** Ends the session. */
export async function logOut() {
  try {
    await post("/api/logout");
  } catch (problem) {
    if (problem.status !== 401) throw problem; // 401: it had ended already
  }
}
