// Prepares the surface that is shaded at each pixel of a shot.

const FILLED = 4; // pixels by which labels may fall short of alpha

/**
 * Albedo with alpha, and normals, of each pixel, (4 H W) each.
 *
 * Both are means over the pixel, premultiplied by alpha. In datasets of format 1 they had one sample,
 * through the pixel's centre: at a silhouette or between strands it may miss what alpha says is
 * there. A pixel without a normal takes the mean of its neighbours.
 */
export function surface(albedo, normal, alpha, format) {
  const [height, width] = albedo.shape;
  const count = height * width;
  const base = new Float32Array(4 * count);
  const directions = new Float32Array(4 * count);
  const scale = alpha.type === "uint8" ? 1 / 255 : 1;
  let missed = [];
  for (let i = 0; i < count; i++) {
    const covered = format === 1 ? 1 : Math.max(alpha.data[i] * scale, 1e-3);
    for (let c = 0; c < 3; c++) {
      base[4 * i + c] = Math.min(albedo.data[3 * i + c] / covered, 1);
      directions[4 * i + c] = normal.data[3 * i + c];
    }
    base[4 * i + 3] = alpha.data[i] * scale;
    const [x, y, z] = directions.subarray(4 * i, 4 * i + 3);
    directions[4 * i + 3] = x || y || z ? 1 : 0;
    if (!directions[4 * i + 3] && base[4 * i + 3] > 0) missed.push(i);
  }
  for (let ring = 0; ring < FILLED && missed.length; ring++) {
    const found = missed.map((i) => neighbours(base, directions, i, width, height));
    missed = missed.filter((i, k) => {
      if (!found[k]) return true;
      base.set(found[k].albedo, 4 * i);
      directions.set([...found[k].normal, 1], 4 * i);
      return false;
    });
  }
  return { base, directions };
}

/** Mean albedo and normal of up to eight neighbours that have one; null if none has. */
function neighbours(base, directions, i, width, height) {
  const [x, y] = [i % width, Math.floor(i / width)];
  const albedo = [0, 0, 0];
  const normal = [0, 0, 0];
  let count = 0;
  for (let v = Math.max(0, y - 1); v <= Math.min(height - 1, y + 1); v++) {
    for (let u = Math.max(0, x - 1); u <= Math.min(width - 1, x + 1); u++) {
      const at = 4 * (v * width + u);
      if (!directions[at + 3]) continue;
      count++;
      for (let c = 0; c < 3; c++) {
        albedo[c] += base[at + c];
        normal[c] += directions[at + c];
      }
    }
  }
  const length = Math.hypot(...normal);
  if (length < 1e-3) return null;
  return { albedo: albedo.map((v) => v / count), normal: normal.map((v) => v / length) };
}
