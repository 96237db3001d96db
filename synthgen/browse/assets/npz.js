// Reads NumPy's .npz: a zip of .npy arrays, stored or deflated.

const KINDS = {
  "<f4": Float32Array,
  "<f8": Float64Array,
  "|u1": Uint8Array,
  "|b1": Uint8Array,
  "<i4": Int32Array,
  "<u4": Uint32Array,
  "<i8": BigInt64Array,
};

/**
 * The named arrays, {name: {data, shape}}; names that the file lacks are skipped.
 *
 * @param {ArrayBuffer} buffer  @param {string[]} names
 */
export async function readNpz(buffer, names) {
  const found = {};
  for (const entry of entries(new DataView(buffer))) {
    const name = entry.name.replace(/\.npy$/, "");
    if (names.includes(name)) found[name] = readNpy(await content(buffer, entry));
  }
  return found;
}

/** The entries of the zip's central directory. */
function* entries(view) {
  let end = view.byteLength - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end--;
  if (end < 0) throw new Error("geometry.npz is not a zip file");
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    const nameLength = view.getUint16(at + 28, true);
    const raw = new Uint8Array(view.buffer, at + 46, nameLength);
    yield {
      name: new TextDecoder().decode(raw),
      method: view.getUint16(at + 10, true),
      size: view.getUint32(at + 20, true),
      place: view.getUint32(at + 42, true),
    };
    at += 46 + nameLength + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
  }
}

async function content(buffer, { place, size, method }) {
  const view = new DataView(buffer);
  const start = place + 30 + view.getUint16(place + 26, true) + view.getUint16(place + 28, true);
  const raw = buffer.slice(start, start + size);
  if (method === 0) return raw;
  const plain = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(plain).arrayBuffer();
}

function readNpy(buffer) {
  const view = new DataView(buffer);
  const wide = view.getUint8(6) > 1;
  const length = wide ? view.getUint32(8, true) : view.getUint16(8, true);
  const start = wide ? 12 : 10;
  const header = new TextDecoder().decode(new Uint8Array(buffer, start, length));
  const kind = header.match(/'descr':\s*'([^']+)'/)?.[1];
  const shape =
    (header.match(/'shape':\s*\(([^)]*)\)/)?.[1] ?? "").match(/\d+/g)?.map(Number) ?? [];
  if (!(kind in KINDS) || /'fortran_order':\s*True/.test(header)) {
    throw new Error(`cannot read an array of type ${kind}`);
  }
  return { data: new KINDS[kind](buffer.slice(start + length)), shape };
}
