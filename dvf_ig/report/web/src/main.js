// The viewer: one moment of a run, a session or a registration, in space, in the image and on the strips.

import "./style.css";
import { loadScene } from "./payload.js";
import { forceAt } from "./field.js";
import { Heart, planeOf } from "./heart.js";
import { seriesOf } from "./series.js";
import { Space } from "./space.js";
import { ImagePanel } from "./image.js";
import { Pictures } from "./pictures.js";
import { anatomyPictures, mixControls, outcomeRows, planesAsSeries } from "./registration.js";
import { Strips } from "./strips.js";
import { Overview } from "./overview.js";
import { connectControls, connectKeys, legend } from "./controls.js";
import { layOut, namedRows, numberRows, SPEEDS, tissueRows } from "./layout.js";
import { listen } from "./live.js";
import { localTheme, rememberTheme } from "./theme.js";

class Viewer {
  constructor(scene, heart, series) {
    Object.assign(this, { scene, heart, series, t: series.firstContact, playing: false, speed: 1 });
    this.$ = layOut(scene);
    this.applyTheme(localTheme());
    this.space = new Space(this.$("space"), scene, heart);
    this.pictures = new Pictures(series.frames);
    this.image = scene.image && new ImagePanel(this.$("image").querySelector("canvas"), scene, heart);
    this.strips = new Strips(this.$("strips").querySelector("canvas"), scene, series);
    this.overview = new Overview(this.$("overview"), series, scene.fixtures_cap_n);
    this.registration = scene.kind === "registration";
    document.body.classList.toggle("model", scene.kind === "model");
    document.body.classList.toggle("training", Boolean(scene.training));
    if (this.registration) this.asRegistration();
    legend(this);
    connectControls(this);
    connectKeys(this);
    addEventListener("resize", () => this.resize());
    const watch = new ResizeObserver(() => this.resize());
    for (const one of [this.$("space"), this.image?.canvas, this.strips.canvas]) if (one) watch.observe(one);
    this.resize();
    if (scene.training) this.space.train(scene.training);
    else this.space.preset("front");
    requestAnimationFrame((now) => this.tick(now));
  }

  asRegistration() {
    document.body.classList.add("registration");
    this.anatomy = anatomyPictures(this.scene);
    mixControls(this);
    this.$("beat-back").textContent = "‹ plane";
    this.$("beat-on").textContent = "plane ›";
    this.$("beat-back").title = "Plane before (↑)";
    this.$("beat-on").title = "Plane after (↓)";
  }

  get frame() {
    return this.series.frame(this.t);
  }

  seek(t) {
    this.t = Math.min(this.series.end, Math.max(this.series.begin, this.registration ? Math.round(t) : t));
    this.changed = true;
    return this.t;
  }

  /** What is shown: the tick's values, its frame, and what lies in the image. */
  state() {
    const values = this.series.at(this.t);
    const frame = this.shownFrame ?? -1;
    return {
      ...values,
      cursor_s: this.t,
      frame,
      frame_event_s: frame < 0 ? null : this.series.frames.event_s[frame],
      contours: (this.image?.contours ?? []).map(({ name, role, segments }) => ({ name, role, segments: Array.from(segments) })),
      playing: this.playing,
    };
  }

  tick(now) {
    const passed = Math.min(0.1, (now - (this.last ?? now)) / 1000);
    this.last = now;
    if (this.series.live) {
      if (this.series.end !== this.t) this.seek(this.series.end);
    } else if (this.playing) {
      this.seek(this.t + passed * this.speed);
      if (this.t >= this.series.end) this.play(false);
    }
    if (this.changed) this.show();
    if (this.space.render()) this.overlays();
    requestAnimationFrame((next) => this.tick(next));
  }

  /** Puts one moment everywhere. */
  show() {
    this.changed = false;
    const { series } = this;
    const values = series.at(this.t);
    if (!values) return;
    const frame = this.decoded(this.frame);
    this.shownFrame = frame;
    const matrix = frame < 0 ? null : series.frames.mr_from_pixel[frame];
    const plane = matrix ? planeOf(matrix) : null;
    const tip = series.vector(values, "tip_mr", "_mm");
    const force = series.vector(values, "force_mr", "_n");
    const shaft = series.vector(values, "shaft_mr", "");
    this.values = values;
    this.space.show({ phase: values.model_phase, plane, tip, shaft, force, pellets: series.pellets });
    if (this.registration) {
      this.planeTexts(frame);
    } else if (this.scene.training) {
      const why = (series.reasons ?? []).map((one) => ["no force", one]);
      this.$("numbers").innerHTML = namedRows([...(series.rows ?? []), ...why]);
    } else {
      this.strips.draw(this.t, values);
      this.overview.draw(this.t);
      this.$("numbers").innerHTML = this.scene.kind === "model" ? namedRows(this.scene.rows) : numberRows(values, this.scene, series.registration(this.t), series.reasons);
      this.texts(values, frame, plane);
    }
    if (this.image) this.picture(frame, { plane, tip, force, margin: values.margin_mm ?? 0, phase: frame < 0 ? null : series.frames.model_phase[frame] });
  }

  /** The frame to show: the wanted one, or, until its picture is decoded, the last one, with its own contour. */
  decoded(wanted) {
    if (wanted < 0) return -1;
    const { event_s } = this.series.frames;
    if (this.pictures.ready(wanted)) {
      this.shownEvent = event_s[wanted];
      return wanted;
    }
    const event = event_s[wanted];
    this.pictures.get(wanted).then(() => {
      // by now another frame may be wanted: the decoded one nearest to it is shown meanwhile
      const now = event_s[this.frame];
      if (this.shownEvent === undefined || Math.abs(event - now) < Math.abs(this.shownEvent - now)) this.shownEvent = event;
      this.changed = true;
    });
    const before = this.shownEvent === undefined ? -1 : event_s.indexOf(this.shownEvent);
    return before >= 0 && this.pictures.ready(before) ? before : -1;
  }

  /** Seeks, and gives what is shown once the frame of that time is decoded. */
  async seekShown(t) {
    this.seek(t);
    if (this.frame >= 0) await this.pictures.get(this.frame);
    this.show();
    return this.state();
  }

  picture(frame, moment) {
    const bitmap = frame < 0 ? null : this.pictures.ready(frame);
    const other = frame < 0 ? null : (this.anatomy?.ready(frame) ?? null);
    if (this.anatomy && frame >= 0 && !other) this.anatomy.get(frame).then(() => (this.changed = true));
    this.image.draw({ ...moment, other, bitmap });
    const { kinds } = this.heart.labels ?? {};
    this.$("tissue").hidden = !kinds || !this.image.shown.labels;
    if (!this.$("tissue").hidden) this.$("tissue").innerHTML = tissueRows(kinds, this.image.contours);
    if (moment.plane) this.space.contours(this.image.contours, moment.plane);
    if (bitmap && this.lastBitmap !== bitmap) this.space.picture(bitmap);
    this.lastBitmap = bitmap;
    for (let next = frame + 1; this.playing && next < Math.min(frame + 6, this.series.frames.images.length); next++)
      this.pictures.get(next);
  }

  planeTexts(frame) {
    const plane = this.scene.planes[frame];
    if (!plane) return;
    this.$("time").textContent = `plane ${frame + 1} of ${this.scene.planes.length}`;
    this.$("frame").textContent = [plane.name, plane.place, plane.moment].filter(Boolean).join(" · ");
    if (!this.told) this.$("numbers").innerHTML = outcomeRows(this.scene);
    this.told = true;
  }

  texts(values, frame, plane) {
    const { $, series } = this;
    $("time").textContent = series.live ? `${this.t.toFixed(1)} s` : `${this.t.toFixed(2)} s of ${series.end.toFixed(1)} s`;
    $("overview").setAttribute("aria-valuenow", this.t.toFixed(3));
    $("overview").setAttribute("aria-valuetext", `${this.t.toFixed(1)} s`);
    $("overview").setAttribute("aria-valuemin", series.begin.toFixed(3));
    $("overview").setAttribute("aria-valuemax", series.end.toFixed(3));
    const phase = frame < 0 ? null : series.frames.model_phase[frame];
    const seen = frame < 0 ? "no ultrasound yet" : `frame seen at ${series.frames.event_s[frame].toFixed(2)} s`;
    const cycle = phase === null ? "" : `, ${(100 * phase).toFixed(0)} % of the cycle`;
    $("frame").textContent = `${seen}${cycle}${plane || frame < 0 ? "" : " · no pose: the model is not placed"}`;
    const mark = series.marks.findLast((one) => one.t_s <= this.t && this.t < (one.until_s ?? one.t_s + 4));
    $("event").textContent = mark ? `${mark.t_s.toFixed(1)} s: ${mark.text}` : series.live ? "" : this.scene.kind === "model" ? `${(100 * values.model_phase).toFixed(0)} % of the cycle` : "bar above: force, ▾ registrations, state of the supervisor";
    const why = [];
    if (values.tip_mr_x_mm === null && this.scene.kind !== "model") why.push("No pose in use: tool and ultrasound are not placed.");
    if (values.model_phase === null) why.push("Phase not locked: the heart stands still.");
    $("unknown").hidden = !why.length;
    $("unknown").textContent = why.join(" ");
  }

  /** What stands over the scene and follows the camera. */
  overlays() {
    const { $, space } = this;
    const mm = space.mmPerPixel;
    const length = [1, 2, 5, 10, 20, 50, 100].find((one) => one / mm > 70) ?? 200;
    $("scale").querySelector("span").textContent = `${length} mm`;
    $("scale").querySelector("i").style.width = `${length / mm}px`;
    const { tip, force } = space.moment ?? {};
    const size = tip && force ? Math.hypot(...force) : 0;
    $("newton").hidden = size < 0.005;
    if (size < 0.005) return;
    const [x, y] = space.pixelOf(tip.map((one, a) => one + 70 * force[a]));
    const { clientWidth, clientHeight } = $("space");
    $("newton").textContent = `${size.toFixed(2)} N`;
    $("newton").style.left = `${Math.min(clientWidth - 70, Math.max(8, x + 10))}px`;
    $("newton").style.top = `${Math.min(clientHeight - 60, Math.max(46, y - 12))}px`;
  }

  view(name) {
    if (name === "tool") this.cut(false);
    if (name === "plane" && this.scene.image) this.cut(true);
    this.space.preset(name);
  }

  /** The heart cut open at the ultrasound plane, or whole. */
  cut(open) {
    this.space.open = open;
    this.space.dirty = true;
    this.$("cut").setAttribute("aria-pressed", open);
  }

  /** The patient's surface coloured by how well it is known, or by its shift. */
  colorBySigma(on) {
    this.bySigma = on;
    this.space.colorBySigma(on);
    this.$("sigma").setAttribute("aria-pressed", on);
    legend(this);
  }

  play(on) {
    if (on && this.t >= this.series.end) this.t = this.series.begin;
    this.playing = on;
    this.$("play").textContent = on ? "❚❚" : "▶";
  }

  beat(direction) {
    this.play(false);
    this.seek(this.series.beat(this.t, direction));
  }

  faster(direction) {
    const next = SPEEDS[SPEEDS.indexOf(this.speed) + direction];
    if (next) this.$("speed").value = String((this.speed = next));
  }

  frameStep(direction) {
    const times = this.series.frames.event_s;
    const next = times[Math.min(times.length - 1, Math.max(0, this.frame + direction))];
    if (next !== undefined) this.seek(next + 1e-6);
  }

  applyTheme(theme, chosen = false) {
    this.theme = theme;
    document.documentElement.dataset.theme = theme;
    this.$("theme").textContent = theme === "dark" ? "Light" : "Dark";
    if (chosen) rememberTheme(theme);
    if (!this.space) return;
    this.space.retheme();
    this.overview.back = null;
    this.changed = true;
  }

  resize() {
    this.space.resize();
    this.image?.resize();
    this.strips.resize();
    this.overview.resize();
    this.changed = true;
  }
}

async function start() {
  const scene = await loadScene();
  const [heart, series] = await Promise.all([Heart.of(scene), seriesOf(scene)]);
  if (scene.planes) planesAsSeries(scene, series);
  const viewer = new Viewer(scene, heart, series);
  if (series.live) listen(viewer);
  await viewer.seekShown(viewer.t);
  if (viewer.space.moment?.plane) viewer.view("plane");
  if (scene.kind === "model") viewer.play(true);
  window.dvf = {
    ready: true,
    ready_ms: performance.now(),
    seek: (t) => viewer.seekShown(t),
    state: () => (viewer.show(), viewer.state()),
    play: () => viewer.play(true),
    pause: () => viewer.play(false),
    theme: (name) => viewer.applyTheme(name),
    view: (name) => viewer.view(name),
    forceAt: (phase, x, y, z) => forceAt(heart.distance, scene.fixtures, scene.fixtures_cap_n, phase, x, y, z),
    viewer,
  };
  dispatchEvent(new Event("dvf-ready"));
}

start().catch((error) => {
  document.getElementById("app").innerHTML = `<p class="failed"></p>`;
  document.querySelector(".failed").textContent = `The viewer could not start: ${error.message}`;
  window.dvf = { ready: false, error: String(error) };
  console.error(error);
});
