// The service's HTTP API: JSON in and out, errors as one readable line.

export class ApiError extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

/** Thrown where no answer came at all; the banner says the rest. */
class Unreachable extends ApiError {
  constructor() {
    super("The service does not answer. Nothing was changed from here; try again once it is back.", 0);
  }
}

export async function get(path, signal) {
  return request(path, { signal });
}

export async function post(path, body = {}, signal) {
  return request(path, {
    signal,
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  });
}

/** Resolves once it is done; there is nothing to be told. */
export async function remove(path) {
  await request(path, { method: "DELETE" });
}

export async function postForm(path, form) {
  return request(path, { method: "POST", body: form });
}

async function request(path, options) {
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    window.dispatchEvent(new Event("calrig:lost"));
    throw new Unreachable();
  }
  if (response.ok) return response.status === 204 ? null : response.json();
  if (response.status === 401 && path !== "/api/login") window.dispatchEvent(new Event("calrig:login"));
  throw await refusal(response);
}

async function refusal(response) {
  const text = await response.text();
  let detail;
  try {
    detail = JSON.parse(text).detail;
  } catch {
    detail = undefined; // a proxy's or the server's own page, not the API's JSON
  }
  if (typeof detail === "string") return new ApiError(detail, response.status);
  if (Array.isArray(detail)) return new ApiError(detail.map(problem).join("; "), response.status);
  return new ApiError(
    `The service answered ${response.status} ${response.statusText}`.trim(),
    response.status,
  );
}

function problem({ loc = [], msg = "is not valid" }) {
  const place = loc.filter((part) => part !== "body").join(".");
  return place ? `${place}: ${msg}` : msg;
}
