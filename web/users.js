// Users, for an admin: who is known, in which role; a new token is shown once.

import { get, post } from "./api.js";
import { askConfirmation } from "./ask.js";
import { errorLine, field, fill, h, headings, onSubmit, tableBox } from "./dom.js";
import { moment } from "./format.js";

const ROLES = {
  viewer: "viewer: looks, and stops a stage",
  operator: "operator: runs, imports, diagnoses, notes",
  releaser: "releaser: accepts effects, releases, voids",
  admin: "admin: keeps users and limits",
};

export async function usersView({ root, signal }) {
  const body = h("tbody");
  const told = h("div", { id: "told", role: "status" });
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
  const role = roleChoice("operator", { id: "user-role" });
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
    fill(body, users.map((user) => row(user, act)));
  }

  /** Does something to users, then shows them as they are, and a token that came of it. */
  async function act(path, sent) {
    const done = await post(`/api/users${path}`, sent);
    fill(told, done.token && tokenBox(done));
    await show();
  }

  onSubmit(form, add, error, async () => {
    await act("", { name: name.value.trim(), role: role.value });
    form.reset();
  });
  fill(
    root,
    h("h1", {}, "Users"),
    h("section", { class: "card" }, form, error.element, told),
    h(
      "section",
      { class: "card" },
      tableBox("Users", h("table", { id: "users-table" }, headings("Name", "Role", "Comes in", "Since", ""), body)),
    ),
  );
  await show();
}

function roleChoice(chosen, props) {
  return h(
    "select",
    props,
    Object.entries(ROLES).map(([value, text]) => h("option", { value, selected: value === chosen }, text)),
  );
}

function row(user, act) {
  const error = errorLine(`error-${user.name}`);
  const path = `/${encodeURIComponent(user.name)}`;
  const role = roleChoice(user.role, { "aria-label": `Role of ${user.name}` });
  role.addEventListener("change", async () => {
    try {
      await act(`${path}/role`, { role: role.value });
    } catch (problem) {
      role.value = user.role;
      error.say(problem);
    }
  });
  const ask = (title, text, action, verb) =>
    h(
      "button",
      {
        type: "button",
        class: "small",
        "aria-label": `${title} ${user.name}`,
        on: { click: () => askConfirmation({ title: `${title} ${user.name}?`, text, action }, () => act(`${path}/${verb}`)) },
      },
      title,
    );
  return h(
    "tr",
    { class: user.disabled_at && "voided" },
    h("th", { scope: "row" }, user.name),
    h("td", { class: "plain" }, user.disabled_at ? user.role : [role, error.element]),
    h("td", {}, wayIn(user)),
    h("td", {}, moment(user.created_at)),
    h(
      "td",
      { class: "plain" },
      !user.disabled_at && [
        ask("New token for", "The one before opens nothing any more, nor does a login begun with it.", "Make a token", "token"),
        " ",
        ask("Disable", "Token and login open nothing any more. What they did stays theirs.", "Disable", "disable"),
      ],
    ),
  );
}

function wayIn({ disabled_at: disabled, has_token: token }) {
  if (disabled) return "no more";
  return token ? "by token, or a trusted proxy" : "by a trusted proxy";
}

function tokenBox({ name, token }) {
  return [
    h("p", {}, `The token of ${name}, shown this once:`),
    h("p", {}, h("code", { id: "new-token" }, token)),
  ];
}
