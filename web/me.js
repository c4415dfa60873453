// The role of the user who is logged in.

const ROLES = ["viewer", "operator", "releaser", "admin"];
let role = "viewer";

/** Stores the service's answer about the login. */
export function iAm(login) {
  role = login.role ?? "viewer";
}

/** Whether the page offers what requires this role; the service checks it independently. */
export function may(needed) {
  return ROLES.indexOf(role) >= ROLES.indexOf(needed);
}
