// The page's elements, and the numbers that it shows.

import { COLORS } from "./colors.js";
import { united } from "./strips.js";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
export const VIEWS = [
  ["front", "Front"], ["left", "Left"], ["above", "Above"], ["back", "Back"], ["plane", "Ultrasound"], ["tool", "Tool"],
];

const KEYS = [
  ["Space", "play, pause"],
  ["← →", "0.1 s back, on; with Shift 1 s"],
  ["↑ ↓", "heartbeat before, after"],
  [", .", "ultrasound frame before, after"],
  ["Home End", "begin, end"],
  ["− +", "slower, faster"],
  ["1 … 6", "views"],
  ["C", "heart cut open at the ultrasound plane, or whole"],
  ["U", "a heart that has changed its shape: coloured by its shift, or by how well that is known"],
  ["L", "labels of tissue in the ultrasound image"],
  ["T", "dark, light"],
  ["? H", "this help"],
];

const PAGE = `
<header>
  <h1 id="title"></h1><span id="patient"></span>
  <span class="grow"></span>
  <span id="connection" hidden></span>
  <button id="theme" title="Dark or light (T)">Light</button>
  <button id="help" title="Keyboard (?)">Keys</button>
</header>
<main>
  <section id="space" aria-label="Scene in space">
    <div class="over top"><div id="views" role="group" aria-label="Views"></div><button id="cut" title="Cut the heart open at the ultrasound plane (C)">Cut</button><button id="sigma" title="Colour the patient's surface by how well it is known (U)">±</button></div>
    <p class="over" id="unknown" hidden></p>
    <div class="over" id="scale"><span></span><i></i></div>
    <span class="over" id="newton" hidden></span>
  </section>
  <div id="legend"></div>
  <aside>
    <section id="image"><canvas aria-label="Ultrasound with the model's contour"></canvas><ul id="tissue" aria-label="Labels in the image" hidden></ul><p id="frame"></p></section>
    <section id="numbers" aria-live="off"></section>
  </aside>
</main>
<section id="strips"><canvas aria-label="Signals over time"></canvas></section>
<footer>
  <canvas id="overview" role="slider" tabindex="0" aria-label="Time"></canvas>
  <div id="transport">
    <button id="beat-back" title="Heartbeat before (↑)">‹ beat</button>
    <button id="play" title="Play, pause (Space)">▶</button>
    <button id="beat-on" title="Heartbeat after (↓)">beat ›</button>
    <output id="time"></output>
    <label>speed <select id="speed"></select></label>
    <label>strips <select id="span"><option value="4">4 s</option><option value="8" selected>8 s</option>
      <option value="20">20 s</option><option value="1e9">all</option></select></label>
    <span class="grow"></span>
    <output id="event"></output>
  </div>
</footer>
<dialog id="keys"></dialog>`;

export function layOut(scene) {
  document.getElementById("app").innerHTML = PAGE;
  const $ = (id) => document.getElementById(id);
  document.title = scene.title;
  $("title").textContent = scene.title;
  $("patient").textContent = `patient ${scene.patient_id} · dvf_ig ${scene.version} · research software, not a medical device`;
  $("views").innerHTML = VIEWS.map(([name, label], i) => `<button data-view="${name}" title="${i + 1}">${label}</button>`).join("");
  $("speed").innerHTML = SPEEDS.map((one) => `<option value="${one}"${one === 1 ? " selected" : ""}>${one} ×</option>`).join("");
  const rows = KEYS.map(([key, what]) => `<tr><th>${key}</th><td>${what}</td></tr>`).join("");
  $("keys").innerHTML = `<h2>Keyboard</h2><table>${rows}</table><p>In the scene: drag turns, right drag or two fingers move, wheel
    zooms. On the strips and the bar below: drag seeks.</p><form method="dialog"><button>Close</button></form>`;
  $("image").hidden = !scene.image;
  for (const button of $("views").querySelectorAll('[data-view="tool"]')) button.hidden = Boolean(scene.planes) || scene.kind === "model";
  for (const button of $("views").querySelectorAll('[data-view="plane"]')) button.hidden = scene.kind === "model";
  return $;
}

/** What is shown, in its colour, with a switch for each. */
export function legendRows(scene, series, { surfaces }, bySigma) {
  const has = (role) => surfaces.find((one) => one.role === role);
  const cap = scene.fixtures_cap_n;
  const paths = scene.fixtures.filter((one) => one.path_mm).slice(0, 1);
  const all = (role) => surfaces.filter((one) => one.role === role);
  const widened = (series.columns.margin_mm ?? []).some((one) => one > 0);
  return [
    has("organ") && ["organ", COLORS.organ, `${words(has("organ").name)} surface${has("patient") ? " in the MR" : ""}`],
    has("patient") && ["patient", COLORS.patient, patientWords(has("patient"), bySigma)],
    has("unseen") && ["unseen", COLORS.unseen, "not seen by any MR slice: closed, no force"],
    has("blood") && ["blood", COLORS.blood, "blood in all chambers (blue for contrast)"],
    ...all("structure").map((one) => [one.key, COLORS.structure, words(one.name)]),
    scene.image && ["plane", COLORS.plane, "ultrasound plane"],
    ...all("fixture").map((one) => [one.key, COLORS.fixture, `${one.name}, ${one.label}${widened ? " without margin" : ""}`]),
    ...paths.map((one) => ["path", COLORS.fixture, `${one.name || "path"}, line to follow`]),
    !scene.planes && scene.kind !== "model" && ["field", COLORS.force, `force (field: longest ${cap} N)`],
    scene.image && scene.labels && ["labels", `linear-gradient(135deg, ${scene.labels.kinds.slice(0, 3).map((one) => one.color).join(", ")})`, "labels of tissue, in the image (L)"],
    scene.targets.length > 0 && ["targets", COLORS.force, scene.bound_mm ? `targets, error < ${scene.bound_mm.toFixed(1)} mm` : "targets"],
  ].filter(Boolean);
}

/** Labels, pale those that do not lie in the image, with the stiffness that their tissue is given; all properties as a tip. */
export function tissueRows(kinds, contours) {
  return kinds
    .map((kind) => {
      const away = contours.every((one) => one.role !== "label" || one.name !== kind.name);
      const all = kind.properties.map(([what, value, source]) => `${what} ${value} (${source})`);
      const [, stiffness, source] = kind.properties[0] ?? [];
      const said = stiffness ? `${stiffness}, ${source.split(":")[0]}` : "";
      const tip = escaped([kind.tissue, ...all].filter(Boolean).join("\n")).replaceAll('"', "&quot;");
      return `<li class="${away ? "away" : ""}" title="${tip}"><i style="background:${kind.color}"></i>${escaped(words(kind.name))}<span>${escaped(said)}</span></li>`;
    })
    .join("");
}

const patientWords = (surface, bySigma) =>
  bySigma
    ? `now: the darker, the less certain, up to ± ${(1.96 * surface.largest_sigma_mm).toFixed(1)} mm (95 %); grey: too uncertain for a force`
    : `now: red further out, blue further in, up to ${surface.largest_mm.toFixed(1)} mm; grey: not known`;

export const words = (name) => name.toLowerCase().replaceAll("_", " ");

const sided = (value, [minus, plus]) => `${value < 0 ? minus : plus} ${Math.abs(value).toFixed(1)}`;

export const escaped = (text) => text.replace(/[&<>]/g, (one) => `&#${one.charCodeAt(0)};`);

/** Names and values as HTML rows. */
export const namedRows = (rows) =>
  `<dl>${rows.map(([name, value]) => `<div class="wide"><dt>${escaped(name)}</dt><dd>${escaped(value)}</dd></div>`).join("")}</dl>`;

const bounded = (mm) => (mm === null || mm === undefined ? "–" : `< ${united(mm, 1, "mm")}`);

/** The numbers of one moment, as HTML rows. */
export function numberRows(values, scene, registration, reasons) {
  if (!values) return "";
  const tip = ["x", "y", "z"].map((axis) => values[`tip_mr_${axis}_mm`]);
  const place = tip.some((one) => one === null) ? "–" : tip.map((one, a) => sided(one, ["RL", "AP", "IS"][a])).join("  ");
  const rate = values.rr_s ? `${(60 / values.rr_s).toFixed(0)} /min` : "–";
  const rows = [
    ["force", united(values.force_n, 2, "N"), "big"],
    ["distance", united(values.distance_mm, 1, "mm"), "big"],
    ["phase of the beat", values.phase_valid ? united(100 * values.phi, 0, "%") : "not locked", ""],
    ["of the model", values.model_phase === null ? "–" : united(100 * values.model_phase, 0, "%"), ""],
    ["heart rate", rate, ""],
    ["pose error, RMS, 95 %", bounded(values.pose_bound_mm), ""],
    ["largest, at registration", bounded(registration?.bound_mm), ""],
    ["pose age", values.pose_age_s === null ? "–" : united(values.pose_age_s, 1, "s"), ""],
    ["margin", united(values.margin_mm, 1, "mm"), ""],
    ["tip, mm", place, "wide"],
  ];
  const told = scene.words.hazards.filter((one) => values.hazards.includes(one.name)).map((one) => one.sentence);
  if (values.supervisor === "latched" && !reasons) told.unshift("nothing is sent until an operator re-arms");
  const because = reasons?.length ? escaped(reasons.join("; ")) : told.length ? told.join("; ") : values.status === "ok" ? "" : words(values.status);
  return `<div class="state ${values.supervisor}"><b>${values.supervisor}</b><span>${because}</span></div><dl>${rows
    .map(([name, value, kind]) => `<div class="${kind}"><dt>${name}</dt><dd>${value}</dd></div>`)
    .join("")}</dl>`;
}
