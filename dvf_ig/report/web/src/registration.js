// One registration: its planes as "frames" that are stepped through, and ultrasound beside the anatomy.

import { escaped } from "./layout.js";
import { COLUMNS } from "./series.js";
import { Pictures } from "./pictures.js";

/** Turns the planes into a series of one tick a plane. */
export function planesAsSeries(scene, series) {
  const { planes } = scene;
  const numbers = planes.map((_, i) => i);
  for (const name of COLUMNS) series.columns[name] = planes.map(() => NaN);
  series.columns.t_s = numbers;
  series.columns.model_phase = planes.map((one) => one.model_phase ?? 0);
  series.columns.status = series.columns.supervisor = series.columns.hazards = planes.map(() => 0);
  series.peaks = numbers;
  series.frames = {
    event_s: numbers,
    model_phase: series.columns.model_phase,
    mr_from_pixel: planes.map((one) => one.mr_from_pixel.flat()),
    images: planes.map((one) => one.image),
    mime: scene.mime,
  };
}

/** The anatomy's picture of each plane. */
export function anatomyPictures(scene) {
  const images = scene.planes.map((one) => one.anatomy);
  return new Pictures({ event_s: images.map((_, i) => i), images, mime: scene.mime });
}

/** Outcome, and the targets with their bound, as HTML. */
export function outcomeRows(scene) {
  const place = ([x, y, z]) =>
    [[x, "RL"], [y, "AP"], [z, "IS"]].map(([v, [minus, plus]]) => `${v < 0 ? minus : plus} ${Math.abs(v).toFixed(1)}`).join("  ");
  const bound = scene.bound_mm === null ? "no bound stated" : `< ${scene.bound_mm.toFixed(1)} mm at 95 %`;
  const rows = scene.rows.map(([name, value]) => `<div class="wide"><dt>${escaped(name)}</dt><dd>${escaped(value)}</dd></div>`);
  const targets = scene.targets.map(
    (one) => `<div class="wide"><dt>${escaped(one.name.replaceAll("_", " "))}, ${place(one.xyz_mm)} mm</dt><dd>${bound}</dd></div>`,
  );
  const state = scene.usable ? "ok" : "latched";
  return `<div class="state ${state}"><b>${scene.usable ? "may be used" : "refused"}</b><span>${escaped(scene.reason)}</span></div>
    <dl>${rows.join("")}</dl>${targets.length ? `<h3>targets</h3><dl class="targets">${targets.join("")}</dl>` : ""}`;
}

/** Choice of ultrasound, checkerboard or anatomy, and where the squares lie. */
export function mixControls(viewer) {
  const { scene, image } = viewer;
  const box = document.createElement("div");
  box.id = "mix";
  box.innerHTML = `<select aria-label="What is shown"><option value="board">checkerboard</option><option value="us">ultrasound</option>
    <option value="other"></option></select><input type="range" min="0" max="2" step="0.01" value="0" aria-label="Squares" />`;
  const [select, range] = box.children;
  select.options[2].textContent = scene.anatomy;
  image.mix = { mode: "board", shift: 0 };
  const change = () => {
    image.mix = { mode: select.value, shift: Number(range.value) };
    range.disabled = select.value !== "board";
    viewer.changed = true;
  };
  select.onchange = range.oninput = change;
  viewer.$("frame").before(box);
}
