// Users, for an admin: who is known, in which role; a new token is shown once.

import { get, post } from "./api.js";
import { askConfirmation } from "./ask.js";
import { errorLine, field, fill, h, headings, onSubmit, tableBox } from "./dom.js";
import { moment } from "./format.js";

const ROLES = {
  viewer: "looks, and stops a stage",
  operator: "runs, imports, diagnoses, notes, leaves poses out",
  releaser: "accepts effects, releases calibrations, voids and moves runs",
  admin: "keeps users, limits and check units",
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
    h("section", { class: "card" }, form, error.element, told, explained()),
    h(
      "section",
      { class: "card" },
      tableBox("Users", h("table", { id: "users-table" }, headings("Name", "Role", "Authentication", "Since", ""), body)),
    ),
  );
  await show();
}

/** Each role may what those above it may, and more. */
function explained() {
  const lines = Object.entries(ROLES).map(([name, may]) => h("li", {}, h("strong", {}, name), `: ${may}`));
  const summary = h("summary", {}, "What each role may, beside what those above it may");
  return h("details", {}, summary, h("ul", {}, lines));
}

function roleChoice(chosen, props) {
  return h(
    "select",
    props,
    Object.keys(ROLES).map((name) => h("option", { selected: name === chosen }, name)),
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
  const ask = (name, title, text, action, verb) => {
    const question = { title: `${title} ${user.name}?`, text, action };
    const click = () => askConfirmation(question, () => act(`${path}/${verb}`));
    const label = `${title} ${user.name}`;
    return h("button", { type: "button", class: "small", "aria-label": label, on: { click } }, name);
  };
  const renew = "The one before opens nothing any more, nor does a login begun with it.";
  const end = "Token and login open nothing any more. What they did stays theirs.";
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
        ask("New token", "New token for", renew, "Make a token", "token"),
        " ",
        ask("Disable", "Disable", end, "Disable", "disable"),
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
