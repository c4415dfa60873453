// Uploads a form with a file and reports the progress, which `fetch` does not.

/** The Response to a POST of the form, as of `fetch`; `onProgress(share)` follows it, 1 once all of it is sent. */
export function upload(path, form, signal, onProgress) {
  return new Promise((resolve, reject) => {
    signal.throwIfAborted(); // given up while this file was on its way
    const request = new XMLHttpRequest();
    request.open("POST", path);
    request.upload.addEventListener("progress", ({ loaded, total }) => onProgress(loaded / total));
    request.addEventListener("load", () => resolve(responseOf(request)));
    request.addEventListener("error", () => reject(new TypeError("no answer came")));
    request.addEventListener("abort", () => reject(new DOMException("given up", "AbortError")));
    signal.addEventListener("abort", () => request.abort());
    request.send(form);
  });
}

function responseOf(request) {
  const lines = request.getAllResponseHeaders().trim().split("\r\n");
  const headers = lines.map((line) => [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 1).trim()]);
  return new Response(request.responseText, { status: request.status, headers });
}
