// Signals over time on one cursor: ECG, breathing, phase, force, distance, error bound and supervisor.

import { COLORS, STATES, themeColor } from "./colors.js";
import { lastBefore } from "./series.js";

const LEFT = 132;
const NAMES = 30;
const RIGHT = 96;
const BOTTOM = 20;
const GAP = 6;

/** A number with so many digits and its unit; a dash where it is not known. */
export function united(value, digits, unit = "") {
  if (value === null || value === undefined) return "–";
  const text = value.toFixed(digits).replace(/^-(?=[0.]*$)/, ""); // no "−0.00"
  return `${text.replace("-", "−")} ${unit}`.trim();
}

export class Strips {
  constructor(canvas, scene, series) {
    Object.assign(this, { canvas, scene, series });
    this.context = canvas.getContext("2d");
    this.span = 8;
    this.rows = this.describe();
  }

  describe() {
    const { signals, fixtures_cap_n: cap } = this.scene;
    const column = (name) => (i) => this.series.columns[name][i];
    const rows = [];
    for (const name of ["ecg", "breathing"])
      if (signals[name])
        rows.push({ name: signals[name].label, unit: signals[name].unit, weight: 1.3, signal: name, color: "ink" });
    rows.push(
      { name: "phase", unit: "% of the beat", weight: 0.9, value: column("phi"), range: [0, 1], percent: true, jump: 0.5, color: "blue",
        shown: (v) => (v.phase_valid ? united(100 * v.phi, 0, "%") : "not locked"), faint: (i) => !this.series.columns.phase_valid[i] },
      { name: "force", unit: "N", weight: 1.3, value: (i) => this.series.force(i), range: [0, 1.06 * cap], line: cap, color: "force",
        shown: (v) => united(v.force_n, 2, "N") },
      { name: "distance", unit: "mm, inside > 0", weight: 1.3, value: column("distance_mm"), range: [-12, 4], line: 0, color: "organ",
        shown: (v) => united(v.distance_mm, 1, "mm") },
      { name: "pose error", unit: "mm RMS, 95 % bound", weight: 0.9, value: column("pose_bound_mm"), range: [0, 4], fit: "pose_bound_mm", color: "plane",
        shown: (v) => (v.pose_bound_mm === null ? "–" : `< ${united(v.pose_bound_mm, 1, "mm")}`) },
      { name: "supervisor", unit: "", weight: 0.6, states: true, shown: (v) => v.supervisor },
    );
    return rows;
  }

  resize() {
    const ratio = Math.min(2, window.devicePixelRatio);
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.max(1, Math.round(this.width * ratio));
    this.canvas.height = Math.max(1, Math.round(this.height * ratio));
    this.ratio = ratio;
    const room = this.height - BOTTOM - GAP * this.rows.length;
    const weights = this.rows.reduce((sum, row) => sum + row.weight, 0);
    let y = 2;
    for (const row of this.rows) {
      if (row.fit) row.range = [0, this.upTo(row.fit, row.range[1])];
      row.height = (room * row.weight) / weights;
      row.top = y;
      y += row.height + GAP;
    }
  }

  /** A round number above all values of a column. */
  upTo(name, least) {
    let most = least;
    for (const value of this.series.columns[name] ?? []) if (value > most) most = value;
    return 2 * Math.ceil(most / 2);
  }

  /** Times shown: around the cursor, within the recording; of a live session those before the newest. */
  window(t) {
    const { begin, end, live } = this.series;
    const span = Math.min(this.span, Math.max(end - begin, 1));
    const first = live ? end - span : Math.max(begin, Math.min(t - span / 2, end - span));
    return [first, first + span];
  }

  timeAt(x, t) {
    const [first, last] = this.window(t);
    const share = (x - LEFT) / (this.width - LEFT - RIGHT);
    return first + Math.min(1, Math.max(0, share)) * (last - first);
  }

  draw(t, values) {
    const draw = this.context;
    draw.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    draw.clearRect(0, 0, this.width, this.height);
    const [first, last] = this.window(t);
    const x = (time) => LEFT + ((time - first) / (last - first)) * (this.width - LEFT - RIGHT);
    this.axis(first, last, x);
    for (const row of this.rows) this.row(row, first, last, x, values);
    draw.strokeStyle = themeColor("cursor");
    draw.lineWidth = 1.5;
    draw.beginPath();
    draw.moveTo(x(t), 0);
    draw.lineTo(x(t), this.height - BOTTOM + 4);
    draw.stroke();
  }

  axis(first, last, x) {
    const draw = this.context;
    const pixels = this.width - LEFT - RIGHT;
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120].find((one) => ((last - first) / one) * 64 < pixels) ?? 300;
    draw.font = "11px system-ui, sans-serif";
    draw.textAlign = "center";
    draw.textBaseline = "alphabetic";
    for (let time = Math.ceil(first / step) * step; time <= last; time += step) {
      draw.fillStyle = themeColor("grid");
      draw.fillRect(Math.round(x(time)), 0, 1, this.height - BOTTOM);
      draw.fillStyle = themeColor("faint");
      draw.fillText(time.toFixed(step < 1 ? 1 : 0), x(time), this.height - 5);
    }
    draw.textAlign = "right";
    draw.fillText("time, s", LEFT - NAMES, this.height - 5);
  }

  row(row, first, last, x, values) {
    const draw = this.context;
    const middle = row.top + row.height / 2;
    draw.fillStyle = themeColor("strip");
    draw.globalCompositeOperation = "destination-over";
    draw.fillRect(LEFT, row.top, this.width - LEFT - RIGHT, row.height);
    draw.globalCompositeOperation = "source-over";
    draw.textAlign = "right";
    draw.textBaseline = "middle";
    draw.fillStyle = themeColor("ink");
    draw.font = "600 12px system-ui, sans-serif";
    const two = row.unit && row.height > 27;
    draw.fillText(two || !row.unit ? row.name : `${row.name}, ${row.unit.split(/[ ,]/)[0]}`, LEFT - NAMES, middle - (two ? 7 : 0), LEFT - NAMES - 4);
    draw.font = "11px system-ui, sans-serif";
    draw.fillStyle = themeColor("faint");
    if (two) draw.fillText(row.unit, LEFT - NAMES, middle + 8, LEFT - NAMES - 4);
    if (row.range) this.ends(row);
    draw.save();
    draw.beginPath();
    draw.rect(LEFT, row.top, this.width - LEFT - RIGHT, row.height);
    draw.clip();
    if (row.states) this.states(row, first, last, x);
    else if (row.signal) this.signal(row, first, last, x);
    else this.curve(row, first, last, x);
    draw.restore();
    draw.textAlign = "left";
    draw.fillStyle = themeColor("ink");
    draw.font = "600 13px ui-monospace, monospace";
    const text = row.signal ? this.signalText(row, values) : values ? row.shown(values) : "–";
    draw.fillText(text, this.width - RIGHT + 10, middle, RIGHT - 12);
  }

  signalText(row, values) {
    const signal = this.series[row.signal];
    if (!signal || !values) return "–";
    const value = signal.values[Math.max(0, lastBefore(signal.t, values.t_s))];
    return united(Number.isNaN(value) ? null : value, 2, row.unit);
  }

  /** A curve as its least and greatest value in each pixel column. */
  curve(row, first, last, x) {
    const times = this.series.t;
    const from = Math.max(0, lastBefore(times, first));
    const to = Math.min(times.length - 1, lastBefore(times, last) + 1);
    const [low, high] = row.range;
    const y = (value) => row.top + row.height * (1 - (Math.min(high, Math.max(low, value)) - low) / (high - low));
    this.guide(row, y);
    this.trace(row, from, to, (i) => times[i], row.value, x, y);
  }

  /** The range of the strip, where there is room. */
  ends(row) {
    if (row.height < 26) return;
    const draw = this.context;
    draw.font = "10px system-ui, sans-serif";
    draw.textAlign = "right";
    draw.fillStyle = themeColor("faint");
    const [low, high] = row.range;
    const line = row.line > low && row.line < 0.9 * high ? (row.height * (high - row.line)) / (high - low) : NaN;
    draw.textBaseline = "top";
    if (!(line < 14)) draw.fillText(row.percent ? "100" : String(+row.range[1].toFixed(1)).replace("-", "−"), LEFT - 4, row.top + 1);
    draw.textBaseline = "bottom";
    draw.fillText(String(row.range[0]).replace("-", "−"), LEFT - 4, row.top + row.height);
    draw.textBaseline = "middle";
    if (!Number.isNaN(line)) draw.fillText(String(row.line), LEFT - 4, row.top + line);
  }

  guide(row, y) {
    if (row.line === undefined) return;
    const draw = this.context;
    draw.strokeStyle = themeColor("faint");
    draw.setLineDash([4, 4]);
    draw.lineWidth = 1;
    draw.beginPath();
    draw.moveTo(LEFT, Math.round(y(row.line)) + 0.5);
    draw.lineTo(this.width - RIGHT, Math.round(y(row.line)) + 0.5);
    draw.stroke();
    draw.setLineDash([]);
  }

  trace(row, from, to, time, value, x, y) {
    const draw = this.context;
    draw.strokeStyle = themeColor(row.color);
    draw.lineWidth = 1.4;
    draw.lineJoin = "round";
    draw.beginPath();
    let pen = false;
    let column = NaN;
    let before = NaN;
    let least = 0;
    let most = 0;
    const flush = () => {
      if (!Number.isNaN(column) && most !== least) {
        draw.moveTo(column, y(least));
        draw.lineTo(column, y(most));
        draw.moveTo(column, y(before));
      }
    };
    for (let i = from; i <= to; i++) {
      const one = value(i);
      if (Number.isNaN(one) || row.faint?.(i)) {
        flush();
        pen = false;
        column = NaN;
        continue;
      }
      const place = Math.round(x(time(i)) * 2) / 2;
      if (row.jump && Math.abs(one - before) > row.jump) pen = false;
      if (place === column && pen) {
        least = Math.min(least, one);
        most = Math.max(most, one);
      } else {
        flush();
        if (pen) draw.lineTo(place, y(one));
        else draw.moveTo(place, y(one));
        [column, least, most, pen] = [place, one, one, true];
      }
      before = one;
    }
    flush();
    draw.stroke();
  }

  signal(row, first, last, x) {
    const signal = this.series[row.signal];
    if (!signal) return;
    const from = Math.max(0, lastBefore(signal.t, first));
    const to = Math.min(signal.t.length - 1, lastBefore(signal.t, last) + 1);
    if (!row.scaled || Math.abs(signal.values.length - row.counted) > 250) {
      row.scaled = robustRange(signal.values);
      row.counted = signal.values.length;
    }
    const [low, high] = row.scaled;
    const y = (value) => row.top + row.height * (0.94 - (0.88 * (value - low)) / (high - low));
    this.trace(row, from, to, (i) => signal.t[i], (i) => signal.values[i], x, y);
    if (row.signal !== "ecg") return;
    this.context.fillStyle = themeColor("blue");
    for (const peak of this.series.peaks) {
      if (peak < first || peak > last) continue;
      this.context.beginPath();
      this.context.moveTo(x(peak) - 4, row.top);
      this.context.lineTo(x(peak) + 4, row.top);
      this.context.lineTo(x(peak), row.top + 6);
      this.context.fill();
    }
  }

  states(row, first, last, x) {
    const draw = this.context;
    const { t, columns, words } = this.series;
    const from = Math.max(0, lastBefore(t, first));
    const to = Math.min(t.length - 1, lastBefore(t, last) + 1);
    for (let i = from; i < to; ) {
      let j = i + 1;
      while (j < to && columns.supervisor[j] === columns.supervisor[i]) j++;
      const name = words.supervisor[columns.supervisor[i]];
      draw.fillStyle = STATES[name];
      const [a, b] = [Math.max(x(t[i]), LEFT), Math.min(x(t[j]), this.width - RIGHT)];
      draw.fillRect(a, row.top, Math.max(b - a, 1), row.height);
      draw.font = "600 11px system-ui, sans-serif";
      if (b - a > draw.measureText(name).width + 12 && row.height > 11) {
        draw.fillStyle = name === "degraded" || name === "fade" ? "#000" : "#fff";
        draw.textAlign = "left";
        draw.textBaseline = "middle";
        draw.fillText(name, a + 6, row.top + row.height / 2 + 0.5);
      }
      i = j;
    }
  }
}

/** Range that all but the extreme half per cent of values keep to. */
function robustRange(values) {
  const known = Array.from(values).filter((one) => !Number.isNaN(one)).sort((a, b) => a - b);
  if (!known.length) return [0, 1];
  const low = known[Math.floor(0.001 * (known.length - 1))];
  const high = known[Math.ceil(0.999 * (known.length - 1))];
  return low === high ? [low - 1, high + 1] : [low, high];
}
