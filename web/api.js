// The service's HTTP API: JSON in and out, errors as one readable line.

export class ApiError extends Error {
  /** `fields` are the places in what was sent that are wrong, such as "plan.sweeps". */
  constructor(message, status, fields = []) {
    super(message);
    this.status = status;
    this.fields = fields;
  }
}

/** Thrown if no answer came at all; the banner reports the lost connection. */
class Unreachable extends ApiError {
  constructor() {
    super("The service does not answer. Try again when it is reachable.", 0);
  }
}

/**
 * What the service refused or could not answer, for an error line; null once `signal` aborts. Any other error is a
 * fault of this page and is thrown.
 */
export function serviceError(error, signal) {
  if (signal?.aborted) return null;
  if (!(error instanceof ApiError)) throw error;
  return error;
}

export async function get(path, signal) {
  return request(path, { signal });
}

const read = new Map();

/** As `get`, read once for all who ask; after a failure it is requested again. */
export function getOnce(path) {
  if (!read.has(path)) {
    const answer = get(path);
    answer.catch(() => read.delete(path));
    read.set(path, answer);
  }
  return read.get(path);
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
  return request(path, { signal, ...sending("POST", body) });
}

export async function put(path, body) {
  return request(path, sending("PUT", body));
}

function sending(method, body) {
  return { method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
}

export async function remove(path) {
  const response = await sent(path, { method: "DELETE" });
  return response.status === 204 ? null : response.json();
}

/** As `post` for work that may take long: `{ answer }`, or `{ job }`, the path of the job that the service continues. */
export async function begin(path, body, signal) {
  return begun(await sent(`${path}?wait=false`, { signal, ...sending("POST", body) }));
}

/** As `begin`, of what a GET computes. */
export async function beginGet(path, signal) {
  return begun(await sent(`${path}?wait=false`, { signal }));
}

/** As `begin`, of a form with a file; `onProgress(share)` follows the upload. */
export async function beginUpload(path, form, signal, onProgress) {
  const { upload } = await import("./upload.js");
  return begun(await answered(path, () => upload(`${path}?wait=false`, form, signal, onProgress)));
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
  return new ApiError(`The service answered ${response.status} ${response.statusText}`.trim(), response.status);
}