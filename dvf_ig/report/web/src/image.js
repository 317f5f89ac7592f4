// The B-mode image with the model's contour and the fixtures' force field over it (Ren 2008, Fig. 16).

import { COLORS } from "./colors.js";
import { forceAt } from "./field.js";
import { cut, letters } from "./heart.js";
import { litRows } from "./pictures.js";

const CASING = "rgba(0, 0, 0, 0.75)";
const FIELD_STEP_MM = 6;
const LEAST_SHARE = 0.03;
const TIP_NEAR_MM = 20;
const SCALE_MM = 20;
const SQUARE_MM = 14;

export class ImagePanel {
  constructor(canvas, scene, heart) {
    Object.assign(this, { canvas, scene, heart, shape: scene.image });
    this.context = canvas.getContext("2d");
    const path = new Path2D();
    (this.shape?.fan_px ?? []).forEach(([c, r], i) => (i ? path.lineTo(c, r) : path.moveTo(c, r)));
    path.closePath();
    this.fan = this.shape?.fan_px ? path : null;
    this.shown = { organ: true, patient: true, blood: true, field: true, labels: false };
  }

  resize() {
    const ratio = Math.min(2, window.devicePixelRatio);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    const { columns, rows, pixel_mm, fan_px } = this.shape;
    const corners = fan_px ?? [[0, 0], [columns - 1, rows - 1]];
    const [left, top, right, bottom] = [
      ...[0, 1].map((a) => Math.max(-0.5, Math.min(...corners.map((one) => one[a])) - 1)),
      ...[0, 1].map((a) => Math.min((a ? rows : columns) - 0.5, Math.max(...corners.map((one) => one[a])) + 1)),
    ];
    const zoom = Math.min((width - 56) / ((right - left) * pixel_mm[0]), (height - 48) / ((bottom - top) * pixel_mm[1]));
    this.pixels_per_mm = zoom;
    this.scale = [zoom * pixel_mm[0], zoom * pixel_mm[1]];
    this.offset = [width / 2, height / 2 - 2].map(
      (middle, a) => middle - (([left, top][a] + [right, bottom][a]) / 2 + 0.5) * this.scale[a],
    );
    this.ratio = ratio;
  }

  /** CSS pixel of an image's (column, row). */
  at(column, row) {
    return [this.offset[0] + (column + 0.5) * this.scale[0], this.offset[1] + (row + 0.5) * this.scale[1]];
  }

  /** Draws a frame; `moment` has bitmap, plane, phase, tip and force, null for what is not known. */
  draw({ bitmap, plane, phase, tip, force, margin = 0, other = null }) {
    const draw = this.context;
    draw.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    draw.fillStyle = "#000";
    draw.fillRect(0, 0, this.canvas.width, this.canvas.height);
    if (bitmap) {
      const { columns, rows } = this.shape;
      draw.imageSmoothingQuality = "high";
      draw.drawImage(bitmap, ...this.offset, columns * this.scale[0], rows * this.scale[1]);
      if (other && this.mix && this.mix.mode !== "us") this.squares(other, bitmap);
    }
    this.contours = [];
    if (plane && phase !== null) {
      if (this.shown.field && this.heart.distance && this.scene.fixtures.length) this.field(plane, phase, margin);
      if (this.heart.labels && this.shown.labels) this.labels(plane, phase);
      for (const role of ["fixture", "structure", "blood", "unseen", "organ", "patient"]) this.outlines(role, plane, phase);
    }
    if (plane) {
      if (tip) this.tip(plane, tip, force);
      if (this.shown.targets !== false) this.targets(plane);
      this.edges(plane);
    }
    this.ruler();
  }

  /** The other picture whole, or in every second square. */
  squares(other, bitmap) {
    const draw = this.context;
    const { columns, rows } = this.shape;
    const [width, height] = [columns * this.scale[0], rows * this.scale[1]];
    draw.save();
    if (this.mix.mode === "board") {
      const side = SQUARE_MM * this.pixels_per_mm;
      const path = new Path2D();
      for (let j = -1; j * side < height; j++)
        for (let i = -3; i * side < width; i++)
          if ((i + j) % 2 === 0) path.rect(this.offset[0] + (i + this.mix.shift) * side, this.offset[1] + j * side, side, side);
      draw.clip(this.insonified(bitmap));
      draw.clip(path);
    }
    draw.drawImage(other, ...this.offset, width, height);
    draw.restore();
  }

  /** Outline of what a picture shows. */
  insonified(bitmap) {
    const { columns, rows } = this.shape;
    if (this.litBitmap !== bitmap) {
      const canvas = new OffscreenCanvas(columns, rows);
      const context = canvas.getContext("2d");
      context.drawImage(bitmap, 0, 0, columns, rows);
      this.lit = litRows(context.getImageData(0, 0, columns, rows));
      this.litBitmap = bitmap;
    }
    const path = new Path2D();
    this.lit.forEach(([first, last], r) => {
      if (last < first) return;
      const [x, y] = this.at(first - 0.5, r - 0.5);
      path.rect(x, y, (last + 1 - first) * this.scale[0], this.scale[1] + 0.5);
    });
    return path;
  }

  /** Where the balls of the targets' bound meet the plane. */
  targets(plane) {
    const bound = this.scene.bound_mm ?? 3;
    for (const { name, xyz_mm } of this.scene.targets) {
      const away = xyz_mm.map((one, a) => one - plane.origin[a]);
      const off = dot(away, plane.normal);
      if (Math.abs(off) > bound) continue;
      const [x, y] = this.at(dot(away, plane.right) / dot(plane.right, plane.right), dot(away, plane.down) / dot(plane.down, plane.down));
      this.context.beginPath();
      this.context.arc(x, y, Math.sqrt(bound ** 2 - off ** 2) * this.pixels_per_mm, 0, 7);
      this.stroke2(CASING, 3.5);
      this.stroke2(COLORS.force, 1.6);
      this.label(name.replaceAll("_", " "), x, y - bound * this.pixels_per_mm - 9);
    }
  }

  /** Contours of the model's labels. */
  labels(plane, phase) {
    for (const { kind, segments } of this.heart.labels.cut(plane, phase, this.shape)) {
      this.contours.push({ name: kind.name, role: "label", segments });
      this.lines(segments, [[CASING, 2.6], [kind.color, 1.4]]);
    }
  }

  outlines(role, plane, phase) {
    for (const surface of this.heart.surfaces) {
      if (surface.role !== role || this.shown[surface.key] === false) continue;
      const segments = cut(surface.at(phase), surface.triangles, plane);
      this.contours.push({ name: surface.name, role, segments });
      if (role === "blood" && this.shown.labels) continue; // the labels have their own line there
      const casing = [CASING, role === "organ" ? 4 : 3.2];
      const line = [COLORS[role], role === "organ" ? 2 : 1.5];
      this.lines(segments, role === "fixture" ? [line] : [casing, line], { fixture: [1, 4], unseen: [5, 4] }[role]);
    }
  }

  /** Draws segments once in each colour and width. */
  lines(segments, strokes, dash = []) {
    const draw = this.context;
    const path = new Path2D();
    for (let i = 0; i < segments.length; i += 4) {
      path.moveTo(...this.at(segments[i], segments[i + 1]));
      path.lineTo(...this.at(segments[i + 2], segments[i + 3]));
    }
    draw.save();
    this.clip();
    draw.lineCap = "round";
    draw.setLineDash(dash);
    for (const [color, width] of strokes) {
      draw.strokeStyle = color;
      draw.lineWidth = width;
      draw.stroke(path);
    }
    draw.restore();
  }

  clip() {
    if (!this.shape.fan_px) return;
    const path = new Path2D();
    this.shape.fan_px.forEach(([c, r], i) => (i ? path.lineTo(...this.at(c, r)) : path.moveTo(...this.at(c, r))));
    path.closePath();
    this.context.clip(path);
  }

  /** Arrows of the force that a tool would feel there, by what lies in the plane. */
  field(plane, phase, margin) {
    const draw = this.context;
    const { columns, rows, pixel_mm } = this.shape;
    const { distance } = this.heart;
    const cap = this.scene.fixtures_cap_n;
    const step = [FIELD_STEP_MM / pixel_mm[0], FIELD_STEP_MM / pixel_mm[1]];
    const right = unit(plane.right);
    const down = unit(plane.down);
    const longest = 0.85 * FIELD_STEP_MM * this.pixels_per_mm;
    draw.save();
    this.clip();
    draw.strokeStyle = draw.fillStyle = COLORS.force;
    draw.globalAlpha = 0.8;
    draw.lineWidth = 1.1;
    for (let r = step[1] / 2; r < rows; r += step[1]) {
      for (let c = step[0] / 2; c < columns; c += step[0]) {
        if (this.fan && !draw.isPointInPath(this.fanAt(), ...this.at(c, r).map((one) => one * this.ratio))) continue;
        const p = [0, 1, 2].map((a) => plane.origin[a] + c * plane.right[a] + r * plane.down[a]);
        const force = forceAt(distance, this.scene.fixtures, cap, phase, ...p, margin);
        if (!force || Math.hypot(...force) < LEAST_SHARE * cap) continue;
        const [x, y] = this.at(c, r);
        this.arrow(x, y, (dot(force, right) / cap) * longest, (dot(force, down) / cap) * longest);
      }
    }
    draw.restore();
  }

  fanAt() {
    const key = `${this.offset} ${this.scale}`;
    if (this.fanKey !== key) {
      this.fanKey = key;
      this.fanPath = new Path2D();
      this.shape.fan_px.forEach(([c, r], i) => (i ? this.fanPath.lineTo(...this.at(c, r)) : this.fanPath.moveTo(...this.at(c, r))));
      this.fanPath.closePath();
    }
    return this.fanPath;
  }

  arrow(x, y, dx, dy, head = 2.6) {
    const draw = this.context;
    const size = Math.hypot(dx, dy);
    draw.beginPath();
    draw.moveTo(x, y);
    draw.lineTo(x + dx, y + dy);
    draw.stroke();
    if (size < 1.2 * head) return;
    const [ux, uy] = [dx / size, dy / size];
    draw.beginPath();
    draw.moveTo(x + dx + ux * head, y + dy + uy * head);
    draw.lineTo(x + dx - uy * head * 0.8 - ux * head * 0.6, y + dy + ux * head * 0.8 - uy * head * 0.6);
    draw.lineTo(x + dx + uy * head * 0.8 - ux * head * 0.6, y + dy - ux * head * 0.8 - uy * head * 0.6);
    draw.fill();
  }

  /** The tip where it is nearest to the plane, with its distance from it; the force by what lies in the plane. */
  tip(plane, tip, force) {
    const away = tip.map((one, a) => one - plane.origin[a]);
    const off = dot(away, plane.normal);
    if (Math.abs(off) > TIP_NEAR_MM) return;
    const column = dot(away, plane.right) / dot(plane.right, plane.right);
    const row = dot(away, plane.down) / dot(plane.down, plane.down);
    const [x, y] = this.at(column, row);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (x < 0 || y < 0 || x > width || y > height) return;
    const draw = this.context;
    draw.save();
    if (force && Math.hypot(...force) > 0.005) {
      const mm = 70 * this.pixels_per_mm;
      const [dx, dy] = [dot(force, unit(plane.right)) * mm, dot(force, unit(plane.down)) * mm];
      draw.lineCap = "round";
      for (const [color, line, head] of [[CASING, 6, 8], [COLORS.force, 3, 6.5]]) {
        draw.strokeStyle = draw.fillStyle = color;
        draw.lineWidth = line;
        this.arrow(x, y, dx, dy, head);
      }
    }
    draw.beginPath();
    draw.arc(x, y, 5, 0, 7);
    this.stroke2(CASING, 4);
    this.stroke2(COLORS.tool, 2);
    const text = `tip ${Math.abs(off).toFixed(0)} mm off the plane`;
    this.label(text, x + (x > width - 150 ? -10 : 10), y - 12, x > width - 150 ? "right" : "left");
    draw.restore();
  }

  stroke2(color, width) {
    this.context.strokeStyle = color;
    this.context.lineWidth = width;
    this.context.stroke();
  }

  label(text, x, y, align = "center") {
    const draw = this.context;
    draw.font = "500 12px system-ui, sans-serif";
    draw.textAlign = align;
    draw.textBaseline = "middle";
    draw.lineJoin = "round";
    draw.lineWidth = 3.5;
    draw.strokeStyle = "rgba(0, 0, 0, 0.85)";
    draw.strokeText(text, x, y);
    draw.fillStyle = "#fff";
    draw.fillText(text, x, y);
  }

  /** Sides of the patient at the edges. */
  edges(plane) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const negative = (v) => v.map((one) => -one);
    this.label(letters(negative(plane.right)), 14, height / 2);
    this.label(letters(plane.right), width - 14, height / 2);
    this.label(letters(negative(plane.down)), width / 2, 12);
    this.label(letters(plane.down), width / 2, height - 12);
  }

  ruler() {
    const draw = this.context;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const length = SCALE_MM * this.pixels_per_mm;
    const [x, y] = [width - 16 - length, height - 14];
    draw.fillStyle = "#fff";
    draw.fillRect(x, y, length, 2);
    draw.fillRect(x, y - 4, 1.5, 8);
    draw.fillRect(x + length - 1.5, y - 4, 1.5, 8);
    this.label(`${SCALE_MM} mm`, x + length / 2, y - 11);
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function unit(v) {
  const size = Math.hypot(...v);
  return v.map((one) => one / size);
}
