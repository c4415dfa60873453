// The service's HTTP API: JSON in and out, errors as one readable line.

const JSON_BODY = { "Content-Type": "application/json" };

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

/** A page of runs, with the time of the oldest run that was looked at for it. */
export async function getRuns(query, signal) {
  const response = await sent(`/api/runs?${query}`, { signal });
  return { ...(await response.json()), backTo: response.headers.get("Calrig-Back-To") };
}

export async function getText(path) {
  return (await sent(path, {})).text();
}

/** What is new since the answer of `tag`: `{ tag, answer }`, or null where nothing is. */
export async function getNews(path, tag, signal) {
  const response = await sent(path, { signal, headers: tag ? { "If-None-Match": tag } : {} });
  if (response.status === 304) return null;
  return { tag: response.headers.get("ETag"), answer: await response.json() };
}

export async function post(path, body = {}, signal) {
  return request(path, {
    signal,
    method: "POST",
    headers: JSON_BODY,
    body: JSON.stringify(body),
  });
}

export async function put(path, body) {
  return request(path, {
    method: "PUT",
    headers: JSON_BODY,
    body: JSON.stringify(body),
  });
}

export async function remove(path) {
  const response = await sent(path, { method: "DELETE" });
  return response.status === 204 ? null : response.json();
}

/** As `post` for what may take long: `{ answer }`, or `{ job }` where the service goes on with it by that path. */
export async function begin(path, body, signal) {
  const options = { signal, method: "POST", headers: JSON_BODY, body: JSON.stringify(body) };
  return begun(await sent(`${path}?wait=false`, options));
}

/** The same of what a GET computes. */
export async function beginGet(path, signal) {
  return begun(await sent(`${path}?wait=false`, { signal }));
}

/** The same of a form with a file; `told(share)` as it goes. */
export async function beginUpload(path, form, signal, told) {
  const { upload } = await import("./upload.js");
  return begun(await answered(path, () => upload(`${path}?wait=false`, form, signal, told)));
}

async function begun(response) {
  if (response.status === 202) return { job: response.headers.get("Location") };
  return { answer: await response.json() };
}

/** A file, as it is. */
export async function getBlob(path) {
  return (await sent(path, {})).blob();
}

async function request(path, options) {
  return (await sent(path, options)).json();
}

function sent(path, options) {
  return answered(path, () => fetch(path, options));
}

async function answered(path, ask) {
  let response;
  try {
    response = await ask();
  } catch (error) {
    if (error.name === "AbortError") throw error;
    window.dispatchEvent(new Event("calrig:lost"));
    throw new Unreachable();
  }
  if (response.ok || response.status === 304) return response;
  if (response.status === 401 && path !== "/api/login") window.dispatchEvent(new Event("calrig:login"));
  throw await refusal(response);
}

async function refusal(response) {
  const text = await response.text();
  const named = response.headers.get("Calrig-Fields");
  const fields = named ? named.split(" ").map(decodeURIComponent) : [];
  let detail;
  try {
    ({ detail } = JSON.parse(text));
  } catch {
    detail = undefined; // a proxy's or the server's own page, not the API's JSON
  }
  if (typeof detail === "string") return new ApiError(detail, response.status, fields);
  return new ApiError(
    `The service answered ${response.status} ${response.statusText}`.trim(),
    response.status,
  );
}