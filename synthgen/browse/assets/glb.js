// Reads binary glTF 2.0 as the generator writes it: triangle meshes with colours, Y up.

const MAGIC = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;
const ARRAYS = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };

/**
 * The meshes of a .glb in world axes (metres, Z up): [{name, positions (3N), colours (4N, bytes),
 * indices}]. Throws an error of one line if the file is something else.
 *
 * @param {ArrayBuffer} buffer
 */
export function readGlb(buffer) {
  const view = new DataView(buffer);
  if (
    buffer.byteLength < 20 ||
    view.getUint32(0, true) !== MAGIC ||
    view.getUint32(16, true) !== JSON_CHUNK
  ) {
    throw new Error("The subject's mesh is not a binary glTF file.");
  }
  const length = view.getUint32(12, true);
  const gltf = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const start = 20 + length + 8;
  const meshes = [];
  const visit = (index, parent) => {
    const node = gltf.nodes[index];
    const matrix = multiply(parent, node.matrix ?? IDENTITY);
    if (node.mesh !== undefined) {
      for (const primitive of gltf.meshes[node.mesh].primitives) {
        meshes.push({
          name: node.name ?? gltf.meshes[node.mesh].name ?? "",
          ...read(gltf, buffer, start, primitive, matrix),
        });
      }
    }
    for (const child of node.children ?? []) visit(child, matrix);
  };
  for (const root of gltf.scenes[gltf.scene ?? 0].nodes) visit(root, IDENTITY);
  return meshes;
}

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

function read(gltf, buffer, start, { attributes, indices }, m) {
  const raw = accessor(gltf, buffer, start, attributes.POSITION);
  const positions = new Float32Array(raw.length);
  for (let i = 0; i < raw.length; i += 3) {
    const [x, y, z] = [0, 1, 2].map(
      (k) => m[k] * raw[i] + m[4 + k] * raw[i + 1] + m[8 + k] * raw[i + 2] + m[12 + k],
    );
    positions.set([x, -z, y], i); // Y up to Z up
  }
  const count = raw.length / 3;
  let colours = new Uint8Array(4 * count).fill(200);
  if (attributes.COLOR_0 !== undefined) {
    const found = accessor(gltf, buffer, start, attributes.COLOR_0);
    if (found instanceof Uint8Array && found.length === 4 * count) colours = found;
  }
  const order =
    indices === undefined
      ? Uint32Array.from({ length: count }, (_, i) => i)
      : Uint32Array.from(accessor(gltf, buffer, start, indices));
  return { positions, colours, indices: order };
}

function accessor(gltf, buffer, start, index) {
  const { componentType, count, type, bufferView, byteOffset = 0 } = gltf.accessors[index];
  const view = gltf.bufferViews[bufferView];
  const Kind = ARRAYS[componentType];
  if (!Kind || view.byteStride) throw new Error("The subject's mesh has an unknown layout.");
  const from = start + (view.byteOffset ?? 0) + byteOffset;
  const size = count * WIDTHS[type] * Kind.BYTES_PER_ELEMENT;
  return new Kind(buffer.slice(from, from + size));
}

/** The product a b of 4×4 matrices in column-major order. */
function multiply(a, b) {
  return IDENTITY.map((_, i) => {
    const [row, column] = [i % 4, 4 * Math.floor(i / 4)];
    return [0, 1, 2, 3].reduce((sum, k) => sum + a[row + 4 * k] * b[column + k], 0);
  });
}
