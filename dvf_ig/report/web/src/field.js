// Forces of the fixtures at places of an image, for the arrows over it (Ren 2008, eqs 4–11). What acts on the tool is
// not computed here: it is told by the run.

import { bracket } from "./heart.js";

const FLAT = 0.2;
const STEEP = 0.4;

/** The fixture with a margin: a wall begins so much earlier, guidance's δ grows by it. */
function widened(fixture, margin) {
  if (!margin) return fixture;
  if ("delta" in fixture) return { ...fixture, delta: fixture.delta + margin };
  return { ...fixture, depth_mm: (fixture.depth_mm ?? 0) - margin };
}

/** Share of the cap at signed distance d, along −∇d; see dvf_ig.guidance.laws. */
function share(fixture, d) {
  const depth = fixture.depth_mm ?? 0;
  if ("delta" in fixture) {
    const s = d - depth;
    return Math.sign(s) * -Math.expm1(-(((s / fixture.delta) ** 2) ** fixture.m));
  }
  if (fixture.inside) return -0.5 * (1 + Math.tanh(0.5 * fixture.gamma * (-d - depth)));
  return 0.5 * (1 + Math.tanh(0.5 * fixture.gamma * (d - depth)));
}

/** Adds weight × the force at a sample (distance and gradient) to out. */
function add(fixture, sample, weight, out) {
  const size = Math.hypot(sample[1], sample[2], sample[3]);
  if (size < FLAT) return;
  const x = Math.min(1, (size - FLAT) / (STEEP - FLAT));
  const force = (-weight * fixture.cap_n * share(fixture, sample[0]) * x * x * (3 - 2 * x)) / size;
  for (let a = 0; a < 3; a++) out[a] += force * sample[1 + a];
}

/**
 * Force of all fixtures on the surface at (x, y, z) of the phase, the primary one with its margin; null where the
 * distance is not known. Paths are left out.
 */
export function forceAt(field, fixtures, cap_n, phi, x, y, z, margin = 0) {
  const [first, second, weight] = bracket(field.fractions, phi);
  const a = [0, 0, 0, 0];
  const b = [0, 0, 0, 0];
  if (!field.sample(first, x, y, z, a) || !field.sample(second, x, y, z, b)) return null;
  const out = [0, 0, 0];
  for (const [i, given] of fixtures.entries()) {
    if (given.law === "path") continue;
    const fixture = i ? given : widened(given, margin);
    if (fixture.blend === "force") {
      add(fixture, a, 1 - weight, out);
      add(fixture, b, weight, out);
    } else {
      add(fixture, a.map((one, i) => one + weight * (b[i] - one)), 1, out);
    }
  }
  const size = Math.hypot(...out);
  return size > cap_n ? out.map((one) => (one * cap_n) / size) : out;
}
