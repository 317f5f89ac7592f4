// Labels of the model's tissue in a plane at a phase of the cycle: see dvf_ig.core.Tissue.

import { bracket } from "./heart.js";
import { unpacked, unpackedRaw } from "./payload.js";

const STEP_PX = 2;
const LEVEL = 0.62; // a little inside, so that both of two neighbours' lines are seen

/** Pull-backs: cubic splines on a cube of knots, one or one for each phase, beyond which they are as at its border. */
class PullBack {
  static async of(entry) {
    const one = new PullBack();
    one.values = await unpacked(entry.coefficients_mm, Float32Array);
    [one.phases, one.count] = entry.coefficients_mm.shape;
    return Object.assign(one, { origin: entry.origin_mm, knot: entry.knot_mm, now: new Float32Array(3 * one.count ** 3), cell: [0, 0, 0], weights: [[], [], []] });
  }

  /** Takes the mean of two phases. */
  set(first, second, weight) {
    const size = this.now.length;
    for (let i = 0; i < size; i++) this.now[i] = (1 - weight) * this.values[first * size + i] + weight * this.values[second * size + i];
    return this;
  }

  /** Moves a place, in place. */
  move(p) {
    const { count, now, cell, weights } = this;
    for (let a = 0; a < 3; a++) {
      const at = Math.min(count - 3, Math.max(0, (p[a] - this.origin[a]) / this.knot));
      cell[a] = Math.min(count - 4, Math.floor(at));
      basis(at - cell[a], weights[a]);
    }
    let x = 0;
    let y = 0;
    let z = 0;
    for (let i = 0; i < 4; i++)
      for (let j = 0; j < 4; j++) {
        const weight = weights[0][i] * weights[1][j];
        let n = 3 * (((cell[0] + i) * count + cell[1] + j) * count + cell[2]);
        for (let k = 0; k < 4; k++, n += 3) {
          const w = weight * weights[2][k];
          x += w * now[n];
          y += w * now[n + 1];
          z += w * now[n + 2];
        }
      }
    p[0] -= x;
    p[1] -= y;
    p[2] -= z;
  }
}

/** Fills in the uniform cubic B-splines at t in a cell. */
function basis(t, out) {
  const s = 1 - t;
  out[0] = (s * s * s) / 6;
  out[1] = (t * t * (3 * t - 6) + 4) / 6;
  out[3] = (t * t * t) / 6;
  out[2] = 1 - out[0] - out[1] - out[3];
}

export class Labels {
  static async of(entry, fractions) {
    const labels = new Labels();
    labels.values = await unpackedRaw(entry.values);
    Object.assign(labels, { kinds: entry.kinds, origin: entry.origin_mm, spacing: entry.spacing_mm, shape: entry.values.shape, fractions });
    labels.motion = await PullBack.of(entry.motion);
    labels.change = entry.change && (await PullBack.of(entry.change)).set(0, 0, 0);
    return labels;
  }

  /** Sets the phase of what is looked up from now on. */
  phase(phi) {
    this.motion.set(...bracket(this.fractions, phi));
  }

  /** Label at a place, which is moved to its material at end-diastole; 0 where there is none. */
  at(p) {
    this.change?.move(p);
    this.motion.move(p);
    const { origin, spacing, shape: [nx, ny, nz] } = this;
    const i = Math.round((p[0] - origin[0]) / spacing);
    const j = Math.round((p[1] - origin[1]) / spacing);
    const k = Math.round((p[2] - origin[2]) / spacing);
    if (i < 0 || j < 0 || k < 0 || i >= nx || j >= ny || k >= nz) return 0;
    return this.values[(i * ny + j) * nz + k];
  }

  /** Contours in a plane: of each kind that lies in it, pairs of points (column, row), flat. */
  cut(plane, phase, { columns, rows }) {
    const key = [phase, ...plane.origin, ...plane.right, ...plane.down].join();
    if (this.key === key) return this.shown;
    this.key = key;
    this.phase(phase);
    const width = Math.ceil(columns / STEP_PX) + 2;
    const height = Math.ceil(rows / STEP_PX) + 2;
    const seen = new Uint8Array(width * height);
    const { origin, right, down } = plane;
    const p = [0, 0, 0];
    for (let r = 1; r < height - 1; r++)
      for (let c = 1; c < width - 1; c++) {
        for (let a = 0; a < 3; a++) p[a] = origin[a] + STEP_PX * ((c - 1) * right[a] + (r - 1) * down[a]);
        seen[r * width + c] = this.at(p);
      }
    const there = this.kinds.filter((kind) => seen.includes(kind.value));
    return (this.shown = there.map((kind) => ({ kind, segments: outline(smooth(seen, kind.value, width, height), width, height) })));
  }
}

/** Share of a label among the nine pixels about each; none at the border. */
function smooth(seen, value, width, height) {
  const out = new Float32Array(seen.length);
  for (let r = 1; r < height - 1; r++)
    for (let c = 1; c < width - 1; c++) {
      let count = 0;
      for (let n = (r - 1) * width + c; n <= (r + 1) * width + c; n += width)
        count += (seen[n - 1] === value) + (seen[n] === value) + (seen[n + 1] === value);
      out[r * width + c] = count / 9;
    }
  return out;
}

/** Where a grid of values has LEVEL, by the two triangles of each cell. */
function outline(values, width, height) {
  const out = [];
  const crossing = (a, b) => {
    const share = (LEVEL - values[a]) / (values[b] - values[a]);
    const [ca, ra, cb, rb] = [a % width, Math.floor(a / width), b % width, Math.floor(b / width)];
    out.push((ca + share * (cb - ca) - 1) * STEP_PX, (ra + share * (rb - ra) - 1) * STEP_PX);
  };
  for (let r = 0; r < height - 1; r++)
    for (let c = 0; c < width - 1; c++) {
      const n = r * width + c;
      for (const corners of [[n, n + 1, n + width], [n + 1, n + width + 1, n + width]]) {
        const above = corners.map((one) => values[one] > LEVEL);
        if (above[0] === above[1] && above[1] === above[2]) continue;
        for (let k = 0; k < 3; k++) if (above[k] !== above[(k + 1) % 3]) crossing(corners[k], corners[(k + 1) % 3]);
      }
    }
  return out;
}
