// Who is at the page, as the service knows them, and what they may.

const ROLES = ["viewer", "operator", "releaser", "admin"];
let role = "viewer";

/** What the service answered of the login. */
export function iAm(login) {
  role = login.role ?? "viewer";
}

/** Whether it is worth offering what takes this role; the service refuses it to anybody else all the same. */
export function may(needed) {
  return ROLES.indexOf(role) >= ROLES.indexOf(needed);
}
