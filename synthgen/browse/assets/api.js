// Requests to the server, with its errors as one line.

/** A request that failed; `message` is one line for the user. */
export class ApiError extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

/** Fetches a path; throws `ApiError` unless it succeeds. An abort stays an `AbortError`. */
export async function ask(path, options = {}) {
  let response;
  try {
    response = await fetch(path, { credentials: "same-origin", ...options });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError("The server does not respond. Is synthgen browse still running?", 0);
  }
  if (response.ok) return response;
  let message = `${response.status} ${response.statusText}`;
  try {
    message = (await response.json()).error || message;
  } catch {
    // Not JSON: the status line will do.
  }
  throw new ApiError(message, response.status);
}

/** The JSON at a path. */
export async function askJson(path, options) {
  return (await ask(path, options)).json();
}

/**
 * An array as the server sends it: {data, shape, type}, little-endian, as every machine with a
 * browser is. X-Type is float32 or uint8.
 */
export async function askArray(path, options) {
  const response = await ask(path, options);
  const shape = (response.headers.get("X-Shape") || "").match(/\d+/g)?.map(Number) ?? [];
  const type = response.headers.get("X-Type") || "float32";
  const kinds = { float32: Float32Array, uint8: Uint8Array, float16: Uint16Array };
  if (!(type in kinds)) throw new ApiError(`${path}: cannot read an array of type ${type}`, 0);
  const data = new kinds[type](await response.arrayBuffer());
  const count = shape.reduce((product, size) => product * size, 1);
  if (data.length !== count) {
    throw new ApiError(`${path}: ${data.length} values for the shape ${shape.join(" × ")}`, 0);
  }
  return { data, shape, type };
}

/** A path made of names, each escaped: `path("pass", subset, shot)` is /pass/…/…. */
export function path(...names) {
  return "/" + names.map((name) => encodeURIComponent(name)).join("/");
}

/** A query string of the values that are not null. */
export function query(values) {
  const kept = Object.entries(values).filter(([, value]) => value !== null && value !== undefined);
  return "?" + new URLSearchParams(kept).toString();
}
