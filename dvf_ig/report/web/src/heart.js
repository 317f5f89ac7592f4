// Surfaces and signed distance through the cycle: vertices and values between phases, cuts by a plane.

import { Labels } from "./labels.js";
import { unpacked, unpackedRaw } from "./payload.js";

/** Neighbouring phases of `phi` (cyclic) and the weight of the second. */
export function bracket(fractions, phi) {
  const n = fractions.length;
  const p = ((phi % 1) + 1) % 1;
  let after = fractions.findIndex((f) => f > p);
  if (after < 0) after = n;
  const first = (after - 1 + n) % n;
  const second = after % n;
  const width = (fractions[second] - fractions[first] + 1) % 1 || 1;
  return [first, second, ((p - fractions[first] + 1) % 1) / width];
}

const largest = (values, least) => values.reduce((most, one) => (Math.abs(one) > most ? Math.abs(one) : most), least);

/** One surface: `at(phi)` fills `positions` with its vertices. */
export class Surface {
  constructor(entry, vertices, triangles, fractions) {
    Object.assign(this, { name: entry.name, role: entry.role, label: entry.label, triangles, fractions });
    // of which there may be several, each with its own switch
    this.key = ["structure", "fixture"].includes(entry.role) ? `${entry.role} ${entry.name}` : entry.role;
    this.level_mm = entry.level_mm;
    this.fixture = entry.fixture;
    this.vertices = vertices;
    this.positions = new Float32Array(3 * entry.vertices.shape[1]);
    this.shown = NaN;
  }

  /** Largest known shift of a surface of the patient, at least 1 mm. */
  get largest_mm() {
    return largest(this.outward, 1);
  }

  /** Largest known standard deviation of such a shift. */
  get largest_sigma_mm() {
    return largest(this.sigma, 0);
  }

  at(phi) {
    if (phi === this.shown) return this.positions;
    const [first, second, weight] = bracket(this.fractions, phi);
    const n = this.positions.length;
    const a = this.vertices.subarray(first * n, first * n + n);
    const b = this.vertices.subarray(second * n, second * n + n);
    for (let i = 0; i < n; i++) this.positions[i] = a[i] + weight * (b[i] - a[i]);
    this.shown = phi;
    return this.positions;
  }
}

export class Heart {
  static async of(scene) {
    const heart = new Heart();
    const { surfaces, fractions, center_mm } = scene.heart;
    heart.fractions = fractions;
    heart.center = center_mm;
    heart.surfaces = await Promise.all(
      surfaces.map(async (entry) => {
        const vertices = await unpacked(entry.vertices, Float32Array);
        const surface = new Surface(entry, vertices, await unpackedRaw(entry.triangles), fractions);
        if (entry.outward_mm) {
          surface.outward = await unpacked(entry.outward_mm, Float32Array);
          surface.sigma = await unpacked(entry.sigma_mm, Float32Array);
        }
        return surface;
      }),
    );
    heart.labels = scene.labels && (await Labels.of(scene.labels, fractions));
    heart.distance = scene.distance && (await DistanceField.of(scene.distance, fractions));
    return heart;
  }
}

/** Signed distance on a grid in every phase, between which it is linear. */
export class DistanceField {
  static async of(entry, fractions) {
    const field = new DistanceField();
    field.values = await unpackedRaw(entry.values);
    [, field.nx, field.ny, field.nz] = entry.values.shape;
    Object.assign(field, { origin: entry.origin_mm, spacing: entry.spacing_mm, scale: entry.values.scale });
    field.fractions = fractions;
    return field;
  }

  /** Fills out[0..3] with distance and gradient in one phase at (x, y, z); false where it is not known. */
  sample(phase, x, y, z, out) {
    const { nx, ny, nz, values, spacing, scale } = this;
    const u = (x - this.origin[0]) / spacing;
    const v = (y - this.origin[1]) / spacing;
    const w = (z - this.origin[2]) / spacing;
    const i = Math.floor(u);
    const j = Math.floor(v);
    const k = Math.floor(w);
    if (i < 0 || j < 0 || k < 0 || i >= nx - 1 || j >= ny - 1 || k >= nz - 1) return false;
    const at = ((phase * nx + i) * ny + j) * nz + k;
    const dx = ny * nz;
    const c = [
      values[at], values[at + 1], values[at + nz], values[at + nz + 1],
      values[at + dx], values[at + dx + 1], values[at + dx + nz], values[at + dx + nz + 1],
    ];
    if (c.includes(-128)) return false;
    const [fu, fv, fw] = [u - i, v - j, w - k];
    const mix = (a, b, f) => a + f * (b - a);
    const c00 = mix(c[0], c[1], fw), c01 = mix(c[2], c[3], fw);
    const c10 = mix(c[4], c[5], fw), c11 = mix(c[6], c[7], fw);
    const low = mix(c00, c01, fv), high = mix(c10, c11, fv);
    out[0] = scale * mix(low, high, fu);
    out[1] = (scale * (high - low)) / spacing;
    out[2] = (scale * mix(c01 - c00, c11 - c10, fu)) / spacing;
    const d0 = mix(c[1] - c[0], c[3] - c[2], fv), d1 = mix(c[5] - c[4], c[7] - c[6], fv);
    out[3] = (scale * mix(d0, d1, fu)) / spacing;
    return true;
  }
}

/** Where a plane cuts a surface: pairs of points (a, b) in the plane's own coordinates (column, row), flat. */
export function cut(positions, triangles, plane) {
  const { origin, right, down, normal } = plane;
  const count = positions.length / 3;
  const height = new Float32Array(count);
  for (let i = 0; i < count; i++)
    height[i] =
      (positions[3 * i] - origin[0]) * normal[0] +
      (positions[3 * i + 1] - origin[1]) * normal[1] +
      (positions[3 * i + 2] - origin[2]) * normal[2];
  const rr = right[0] ** 2 + right[1] ** 2 + right[2] ** 2;
  const dd = down[0] ** 2 + down[1] ** 2 + down[2] ** 2;
  const out = [];
  for (let t = 0; t < triangles.length; t += 3) {
    const corners = [triangles[t], triangles[t + 1], triangles[t + 2]];
    const above = corners.map((c) => height[c] >= 0);
    if (above[0] === above[1] && above[1] === above[2]) continue;
    for (let k = 0; k < 3; k++) {
      const a = corners[k];
      const b = corners[(k + 1) % 3];
      if (above[k] === above[(k + 1) % 3]) continue;
      const share = height[a] / (height[a] - height[b]);
      const p = [0, 1, 2].map(
        (axis) => positions[3 * a + axis] + share * (positions[3 * b + axis] - positions[3 * a + axis]) - origin[axis],
      );
      out.push(
        (p[0] * right[0] + p[1] * right[1] + p[2] * right[2]) / rr,
        (p[0] * down[0] + p[1] * down[1] + p[2] * down[2]) / dd,
      );
    }
  }
  return out;
}

/** Plane of a frame: mm of its pixel (0, 0), of a step right and down, and its unit normal. */
export function planeOf(m) {
  const right = [m[0], m[3], m[6]];
  const down = [m[1], m[4], m[7]];
  const origin = [m[2], m[5], m[8]];
  const cross = [
    right[1] * down[2] - right[2] * down[1],
    right[2] * down[0] - right[0] * down[2],
    right[0] * down[1] - right[1] * down[0],
  ];
  const size = Math.hypot(...cross);
  return { origin, right, down, normal: cross.map((one) => one / size) };
}

/** Letters of the sides of the patient towards which a direction goes, the longest part first (LPS). */
export function letters(direction) {
  const size = Math.hypot(...direction);
  return direction
    .map((part, axis) => [part / size, ["RL", "AP", "IS"][axis]])
    .filter(([part]) => Math.abs(part) >= 0.5)
    .sort((a, b) => Math.abs(b[0]) - Math.abs(a[0]))
    .map(([part, names]) => names[part > 0 ? 1 : 0])
    .join("");
}
