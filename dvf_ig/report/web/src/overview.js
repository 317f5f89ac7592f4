// The whole recording in one bar, on which a drag seeks.

import { STATES, themeColor } from "./colors.js";

/** Force, states of the supervisor and marks over time, with the cursor. */
export class Overview {
  constructor(canvas, series, cap) {
    Object.assign(this, { canvas, series, cap });
    this.context = canvas.getContext("2d");
  }

  resize() {
    const ratio = Math.min(2, window.devicePixelRatio);
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.max(1, Math.round(this.width * ratio));
    this.canvas.height = Math.max(1, Math.round(this.height * ratio));
    this.ratio = ratio;
    this.back = null;
  }

  x(t) {
    const { begin, end } = this.series;
    return ((t - begin) / Math.max(end - begin, 1e-6)) * this.width;
  }

  timeAt(x) {
    const { begin, end } = this.series;
    return begin + Math.min(1, Math.max(0, x / this.width)) * (end - begin);
  }

  draw(t) {
    const draw = this.context;
    if (!this.back || this.series.live) this.background();
    draw.setTransform(1, 0, 0, 1, 0, 0);
    draw.clearRect(0, 0, this.canvas.width, this.canvas.height);
    draw.drawImage(this.back, 0, 0);
    draw.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    draw.fillStyle = themeColor("cursor");
    draw.fillRect(this.x(t) - 1, 0, 2, this.height);
    draw.beginPath();
    draw.arc(this.x(t), this.height - 5, 5, 0, 7);
    draw.fill();
  }

  background() {
    this.back = document.createElement("canvas");
    [this.back.width, this.back.height] = [this.canvas.width, this.canvas.height];
    const draw = this.back.getContext("2d");
    draw.scale(this.ratio, this.ratio);
    const { t, columns, words, marks } = this.series;
    if (!t.length) return;
    draw.fillStyle = themeColor("strip");
    draw.fillRect(0, 0, this.width, this.height);
    const band = 10;
    const room = this.height - band - 2;
    const most = new Float64Array(Math.ceil(this.width) + 1);
    const state = new Int8Array(most.length).fill(-1);
    for (let i = 0; i < t.length; i++) {
      const p = Math.floor(this.x(t[i]));
      most[p] = Math.max(most[p], this.series.force(i) || 0);
      state[p] = Math.max(state[p], columns.supervisor[i]);
    }
    for (let p = 0; p < most.length; p++) {
      const height = (room * Math.min(most[p], this.cap)) / this.cap;
      draw.fillStyle = themeColor("force");
      draw.fillRect(p, room - height, 1, height);
      draw.fillStyle = STATES[words.supervisor[state[p]]] ?? "transparent";
      draw.fillRect(p, this.height - band, 1, band);
    }
    for (const mark of marks) {
      draw.fillStyle = mark.kind === "registration" ? themeColor("blue") : STATES.latched;
      const x = this.x(mark.t_s);
      if (mark.until_s) draw.fillRect(x, 0, this.x(mark.until_s) - x, 3);
      draw.beginPath();
      draw.moveTo(x - 5, 0);
      draw.lineTo(x + 5, 0);
      draw.lineTo(x, 8);
      draw.fill();
    }
  }
}
