// Users and their roles, for an admin; a new token is shown once.

import { get, post } from "./api.js";
import { askConfirmation } from "./ask.js";
import { bullets, button, dataTable, errorLine, field, fill, h, keepingFocus, onSubmit, select, tableRow } from "./dom.js";
import { moment } from "./format.js";

const ROLES = {
  viewer: "views everything, and stops stages",
  operator: "runs, imports, diagnoses, adds notes, excludes poses",
  releaser: "accepts effects, releases calibrations, voids and moves runs",
  admin: "changes users, limits and stage maps",
};

const NAMES = ["Name", "Role", "Authentication", "Since", ""];

export async function usersView({ root, signal }) {
  const body = h("tbody");
  const shown = h("div", { id: "told", role: "status" });
  const error = errorLine("users-error");
  const name = h("input", {
    id: "user-name",
    required: true,
    maxlength: "64",
    pattern: "[\\p{L}\\p{N}_.@+\\-]+",
    title: "Letters, digits and . _ @ + -",
    autocomplete: "off",
    autocapitalize: "off",
  });
  const role = select({ id: "user-role" }, Object.keys(ROLES), "operator");
  const add = h("button", { id: "add-user", type: "submit", class: "primary" }, "Add");
  const form = h(
    "form",
    { class: "filters" },
    field("user-name", "Name", name),
    field("user-role", "Role", role),
    h("div", { class: "buttons end" }, add),
  );

  async function show() {
    const users = await get("/api/users", signal);
    keepingFocus(body, () => fill(body, users.map((user) => row(user, act))));
  }

  /** Changes users, then shows them, and a new token if there is one. */
  async function act(path, sent) {
    const done = await post(`/api/users${path}`, sent);
    fill(shown, done.token && tokenBox(done));
    await show();
  }

  onSubmit(form, add, error, async () => {
    await act("", { name: name.value.trim(), role: role.value });
    form.reset();
  });
  fill(
    root,
    h("h1", {}, "Users"),
    h("section", { class: "card" }, form, error.element, shown, explained()),
    h("section", { class: "card" }, dataTable("Users", NAMES, body, { id: "users-table" })),
  );
  await show();
}

/** What each role permits. */
function explained() {
  const lines = Object.entries(ROLES).map(([name, may]) => [h("strong", {}, name), `: ${may}`]);
  const summary = h("summary", {}, "Permissions (each role includes those above)");
  return h("details", {}, summary, bullets(lines));
}

function row(user, act) {
  const error = errorLine(`error-${user.name}`);
  const path = `/${encodeURIComponent(user.name)}`;
  const role = select({ id: `role-of-${user.name}`, "aria-label": `Role of ${user.name}` }, Object.keys(ROLES), user.role);
  role.addEventListener("change", async () => {
    try {
      await act(`${path}/role`, { role: role.value });
    } catch (problem) {
      role.value = user.role;
      error.say(problem);
    }
  });
  const ask = (name, title, text, action, verb) => {
    const question = { title: `${title} ${user.name}?`, text, action };
    const click = () => askConfirmation(question, () => act(`${path}/${verb}`));
    return button(name, click, { class: "small", "aria-label": `${title} ${user.name}` });
  };
  const renew = "The previous token and all logins made with it stop working.";
  const end = "Token and logins stop working. Past actions stay attributed to the user.";
  const actions = !user.disabled_at && [
    ask("New token", "New token for", renew, "Make a token", "token"),
    " ",
    ask("Disable", "Disable", end, "Disable", "disable"),
  ];
  return tableRow(
    user.name,
    [
      h("td", { class: "plain" }, user.disabled_at ? user.role : [role, error.element]),
      wayIn(user),
      moment(user.created_at),
      h("td", { class: "plain" }, actions),
    ],
    { class: user.disabled_at && "voided" },
  );
}

function wayIn({ disabled_at: disabled, has_token: token }) {
  if (disabled) return "disabled";
  return token ? "by token, or a trusted proxy" : "by a trusted proxy";
}

function tokenBox({ name, token }) {
  return [h("p", {}, `Token of ${name}, shown only once:`), h("p", {}, h("code", { id: "new-token" }, token))];
}
