// Everything over time: columns of ticks, signals, frames, marks; whole from a file, or growing with a session.

import { unpacked } from "./payload.js";

export const AXES = ["x", "y", "z"];
const KEPT_S = 60;
const FELT_N = 0.05;
const WORDS = ["status", "supervisor", "hazards"];

/** Index of the last entry of `times` that is not after `t`; -1 before the first. */
export function lastBefore(times, t) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

export class Series {
  constructor(words) {
    this.words = words;
    this.columns = {};
    this.ecg = null;
    this.breathing = null;
    this.peaks = [];
    this.frames = { event_s: [], model_phase: [], mr_from_pixel: [], images: [], mime: "image/jpeg" };
    this.marks = [];
    this.live = false;
  }

  get t() {
    return this.columns.t_s ?? [];
  }

  get begin() {
    return this.t[0] ?? 0;
  }

  get end() {
    return this.t[this.t.length - 1] ?? 0;
  }

  /** Time at which the page opens: of the first force, else of the first pose, else the begin. */
  get firstContact() {
    if (!this.columns.force_tracker_x_n) return this.begin;
    const felt = this.t.findIndex((_, i) => this.force(i) > FELT_N);
    const placed = this.columns.tip_mr_x_mm.findIndex((x) => !Number.isNaN(x));
    return this.t[felt] ?? this.t[placed] ?? this.begin;
  }

  /** Registration in use at `t`, with the bound that it states; none before the first. */
  registration(t) {
    return this.marks.findLast((one) => one.kind === "registration" && one.t_s <= t);
  }

  /** Index of the tick at `t`: the nearest one. */
  index(t) {
    const before = Math.max(0, lastBefore(this.t, t));
    const after = Math.min(before + 1, this.t.length - 1);
    return Math.abs(this.t[after] - t) < Math.abs(this.t[before] - t) ? after : before;
  }

  /** All values of a tick; words for states, null where a value is not known. */
  at(t) {
    if (!this.t.length) return null;
    const i = this.index(t);
    const out = {};
    for (const [name, column] of Object.entries(this.columns))
      out[name] = Number.isNaN(column[i]) ? null : column[i];
    out.status = this.words.status[out.status];
    out.supervisor = this.words.supervisor[out.supervisor];
    out.hazards = this.words.hazards.filter((_, bit) => (out.hazards >> bit) & 1).map((one) => one.name);
    out.force_n = Math.hypot(...AXES.map((axis) => out[`force_tracker_${axis}_n`] ?? NaN));
    if (Number.isNaN(out.force_n)) out.force_n = null;
    out.index = i;
    return out;
  }

  /** (x, y, z) of columns `tip_mr_…_mm`, …; null where it is not known. */
  vector(values, before, after) {
    const out = AXES.map((axis) => values[`${before}_${axis}${after}`]);
    return out.some((one) => one === null || one === undefined) ? null : out;
  }

  /** Size of the force at tick i. */
  force(i) {
    const c = this.columns;
    return Math.hypot(c.force_tracker_x_n[i], c.force_tracker_y_n[i], c.force_tracker_z_n[i]);
  }

  /** Index of the ultrasound frame that is shown at `t`; -1 before the first. */
  frame(t) {
    return lastBefore(this.frames.event_s, t);
  }

  /** R peak before (-1) or after (+1) `t`. */
  beat(t, direction) {
    const slack = 0.0005;
    if (direction > 0) return this.peaks.find((peak) => peak > t + slack) ?? this.end;
    return this.peaks.findLast((peak) => peak < t - slack) ?? this.begin;
  }

  /** One live event. */
  push(event) {
    const bits = (event.hazards ?? "").split("|");
    const codes = {
      status: this.words.status.indexOf(event.status),
      supervisor: this.words.supervisor.indexOf(event.supervisor),
      hazards: this.words.hazards.reduce((sum, one, bit) => sum + (bits.includes(one.name) ? 1 << bit : 0), 0),
    };
    for (const name of COLUMNS) {
      this.columns[name] ??= [];
      const value = WORDS.includes(name) ? codes[name] : event[name];
      this.columns[name].push(value ?? NaN);
    }
    for (const name of ["ecg", "breathing"]) {
      if (!event[name]) continue;
      this[name] ??= { t: [], values: [] };
      this[name].t.push(...event[name].t_s);
      this[name].values.push(...event[name].values.map((value) => value ?? NaN));
    }
    this.reasons = event.reasons;
    this.pellets = event.pellets;
    this.rows = event.rows;
    this.peaks.push(...(event.r_peaks_s ?? []));
    this.marks.push(...(event.marks ?? []));
    if (event.frame) {
      const { event_s, model_phase, mr_from_pixel, image, mime } = event.frame;
      this.frames.event_s.push(event_s);
      this.frames.model_phase.push(model_phase);
      this.frames.mr_from_pixel.push(mr_from_pixel?.flat() ?? null);
      this.frames.images.push(image);
      this.frames.mime = mime;
    }
    this.forget();
  }

  /** What is older than a minute goes. */
  forget() {
    const from = this.end - KEPT_S;
    const drop = (times, ...others) => {
      const gone = lastBefore(times, from) + 1;
      if (gone < 200 && times.length < 4 * KEPT_S * 250) return;
      for (const list of [times, ...others]) list.splice(0, gone);
    };
    const { t_s, ...others } = this.columns;
    drop(t_s, ...Object.values(others));
    if (this.ecg) drop(this.ecg.t, this.ecg.values);
    if (this.breathing) drop(this.breathing.t, this.breathing.values);
    const f = this.frames;
    drop(f.event_s, f.model_phase, f.mr_from_pixel, f.images);
  }
}

export const COLUMNS = [
  "t_s",
  "phi",
  "phase_valid",
  "model_phase",
  "rr_s",
  ...["tip_mr", "shaft_mr", "force_tracker", "force_mr"].flatMap((name) =>
    AXES.map((axis) => `${name}_${axis}${name === "tip_mr" ? "_mm" : name === "shaft_mr" ? "" : "_n"}`),
  ),
  "distance_mm",
  ...WORDS,
  "pose_age_s",
  "pose_bound_mm",
  "margin_mm",
];

/** The series of a file. */
export async function seriesOf(scene) {
  const series = new Series(scene.words);
  const given = scene.series;
  if (!given) {
    series.live = scene.kind === "live";
    return series;
  }
  const names = Object.keys(given.ticks);
  const arrays = await Promise.all(names.map((name) => unpacked(given.ticks[name])));
  names.forEach((name, i) => (series.columns[name] = arrays[i]));
  for (const name of ["ecg", "breathing"])
    if (given[name])
      series[name] = { t: await unpacked(given[name].t_s), values: await unpacked(given[name].values) };
  series.peaks = given.r_peaks_s;
  series.marks = given.marks;
  if (given.frames) {
    const placed = await unpacked(given.frames.mr_from_pixel);
    const rows = given.frames.event_s.map((_, i) => {
      const one = placed.subarray(9 * i, 9 * i + 9);
      return Number.isNaN(one[0]) ? null : one;
    });
    series.frames = { ...given.frames, mr_from_pixel: rows };
  }
  return series;
}
