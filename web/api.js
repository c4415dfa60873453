// The service's HTTP API: JSON in and out, errors as one readable line.

export class ApiError extends Error {
  /** `fields` are the places in what was sent that are wrong, such as "plan.sweeps". */
  constructor(message, status, fields = []) {
    super(message);
    this.status = status;
    this.fields = fields;
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

export async function put(path, body) {
  return request(path, {
    method: "PUT",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  });
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
  if (response.ok) return response.json();
  if (response.status === 401 && path !== "/api/login") window.dispatchEvent(new Event("calrig:login"));
  throw await refusal(response);
}

async function refusal(response) {
  const text = await response.text();
  let detail;
  let fields;
  try {
    ({ detail, fields } = JSON.parse(text));
  } catch {
    detail = undefined; // a proxy's or the server's own page, not the API's JSON
  }
  if (typeof detail === "string") return new ApiError(detail, response.status, fields);
  return new ApiError(
    `The service answered ${response.status} ${response.statusText}`.trim(),
    response.status,
  );
}