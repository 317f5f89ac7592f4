// The scene in space: beating heart, ultrasound plane, tool, force, fixture, sides of the patient, millimetre scale.

import {
  Color, DirectionalLight, HemisphereLight, PerspectiveCamera, Plane, Scene, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { AnaglyphEffect } from "three/examples/jsm/effects/AnaglyphEffect.js";
import { StereoEffect } from "three/examples/jsm/effects/StereoEffect.js";
import { themeColor } from "./colors.js";
import { colorPatient, ForceArrow, pellet, planeEdge, surfaceMeshes, TargetPath, targetMark, Tool } from "./shapes.js";
import { UltrasoundSheet } from "./sheet.js";

/** CSS pixels from the top at which a letter is clear of the buttons. */
const BELOW_BUTTONS = 56;
/** Training is seen from where the paper's people sat, with eyes as far apart as people's. */
const EYES_AWAY_MM = 750;
const EYES_APART_MM = 64;
const SIDES = [
  ["L", [1, 0, 0]], ["R", [-1, 0, 0]], ["P", [0, 1, 0]], ["A", [0, -1, 0]], ["S", [0, 0, 1]], ["I", [0, 0, -1]],
];

export class Space {
  constructor(host, scene, heart) {
    this.host = host;
    this.heart = heart;
    this.scene = new Scene();
    this.center = new Vector3(...heart.center);
    this.camera = new PerspectiveCamera(28, 1, 10, 3000);
    this.renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.localClippingEnabled = true;
    host.prepend(this.renderer.domElement);
    this.orbit(new Vector3(0, 0, 1));
    this.controls.target.copy(this.center);
    this.half = halfExtents(heart, this.center);
    this.radius = Math.hypot(this.half[0], this.half[1], this.half[2]) / 1.25;
    this.shown = { organ: true, unseen: true, patient: true, blood: true, plane: true, field: true };
    this.open = true;
    this.cutPlane = new Plane(new Vector3(0, 0, 1), 0);
    this.light();
    this.surfaces = heart.surfaces.map((surface) => this.added(surfaceMeshes(surface)));
    this.changed = heart.surfaces.some((one) => one.role === "patient");
    this.ultrasound = scene.image && this.added(new UltrasoundSheet(scene.image, Boolean(scene.planes)));
    this.paths = (scene.fixtures ?? []).filter((one) => one.path_mm).map((one) => this.added(new TargetPath(one)));
    this.tool = this.added(new Tool(scene.tool));
    this.force = this.added(new ForceArrow());
    this.sides = SIDES.map(([letter, direction]) => ({ mark: sideMark(host, letter), direction: new Vector3(...direction) }));
    this.targets = (scene.targets ?? []).map((one) => this.added(targetMark(one, scene.bound_mm)));
    for (const one of scene.planes ?? []) this.added(planeEdge(one, scene.image));
    this.preset("front");
    this.retheme();
  }

  /** Puts a shape into the scene, and gives it back. */
  added(shape) {
    this.scene.add(shape.group);
    return shape;
  }

  /** Turns about the axis that is up from now on. */
  orbit(up) {
    this.controls?.dispose();
    this.camera.up.copy(up);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => (this.dirty = true));
  }

  light() {
    const sky = new HemisphereLight(0xffffff, 0x40322c, 1.0);
    sky.position.set(0, -0.4, 1);
    this.scene.add(sky);
    this.lamp = new DirectionalLight(0xffffff, 2.1);
    this.scene.add(this.lamp, this.lamp.target);
    this.lamp.target.position.copy(this.center);
  }

  retheme() {
    this.scene.background = new Color(themeColor("space"));
    this.veil = Number(themeColor("veil"));
    this.dirty = true;
  }

  /** Shows one moment: model phase, plane of the frame, tip, shaft and force; null for what is not known. */
  show({ phase, plane, tip, shaft, force, pellets }) {
    this.moment = { plane, tip, force };
    const known = phase !== null;
    for (const { surface, geometry, group } of this.surfaces) {
      group.visible = this.shown[surface.key] ?? true;
      if (!group.visible) continue;
      surface.at(known ? phase : 0);
      geometry.attributes.position.needsUpdate = true;
      geometry.computeVertexNormals();
    }
    for (const { group } of this.targets) group.visible = this.shown.targets !== false;
    for (const path of this.paths) path.place(known ? phase : 0, this.shown.path !== false);
    this.ultrasound?.place(plane, this.shown.plane);
    this.tool.place(tip, shaft);
    this.pellets?.forEach((one, i) => one.place(pellets?.[i], i === 0));
    this.force.place(tip, force);
    this.dirty = true;
  }

  /** Colours the patient's surface by how well its shift is known, or by the shift. */
  colorBySigma(on) {
    for (const { surface, geometry } of this.surfaces) if (surface.outward) colorPatient(geometry, surface, on);
    this.dirty = true;
  }

  /** Takes the contours of the image: pairs of (column, row). */
  contours(list, plane) {
    this.ultrasound?.contours(list, plane, this.shown);
    this.dirty = true;
  }

  /** Draws a decoded frame into the plane's texture. */
  picture(image) {
    if (!this.ultrasound || !image) return;
    this.ultrasound.picture(image);
    this.dirty = true;
  }

  /** Views: of the patient, of the plane as the image panel shows it, close to the tool. */
  preset(name) {
    const toward = { front: [0.35, -1, 0.42], left: [1, -0.25, 0.3], above: [0.1, -0.35, 1], back: [-0.4, 1, 0.4] };
    const { plane, tip, force } = this.moment ?? {};
    let direction = new Vector3(...(toward[name] ?? toward.front)).normalize();
    const target = this.center.clone();
    let distance = 1.1 * this.radius;
    let up = new Vector3(0, 0, 1);
    if (name === "plane" && plane) {
      up = new Vector3(...plane.down).normalize().negate();
      direction = new Vector3(...plane.normal).negate().addScaledVector(up, 0.12).normalize();
      distance = 1.2 * this.radius;
    }
    this.orbit(up);
    if (name === "tool" && tip) {
      const away = new Vector3(...tip).sub(this.center).normalize();
      const across = new Vector3().crossVectors(away, this.camera.up).normalize();
      direction = across.multiplyScalar(this.camera.position.clone().sub(this.center).dot(across) < 0 ? -1 : 1);
      direction.addScaledVector(away, 0.45).addScaledVector(this.camera.up, 0.25).normalize();
      target.set(...tip);
      if (force) target.addScaledVector(new Vector3(...force), 12);
      distance = 0.48 * this.radius;
    }
    this.controls.target.copy(target);
    const half = Math.tan((this.camera.fov * Math.PI) / 360) * Math.min(1, this.camera.aspect);
    this.camera.position.copy(target).addScaledVector(direction, distance / half);
    this.controls.update();
    this.dirty = true;
  }

  /** The view of a training, which cannot be turned: the place of the eye is part of the task. */
  train({ toward, up, sight, pellets }) {
    this.resize();
    this.pellets = Array.from({ length: pellets }, () => this.added(pellet()));
    this.open = false;
    this.orbit(new Vector3(...up));
    this.controls.enabled = false;
    const direction = new Vector3(...toward);
    this.controls.target.copy(this.center);
    this.camera.position.copy(this.center).addScaledVector(direction, EYES_AWAY_MM);
    const narrow = Math.min(1, sight === "side-by-side" ? this.camera.aspect / 2 : this.camera.aspect);
    this.camera.fov = (2 * Math.atan((0.95 * this.radius) / narrow / EYES_AWAY_MM) * 180) / Math.PI;
    this.camera.focus = EYES_AWAY_MM - this.radius / 2;
    this.camera.updateProjectionMatrix();
    this.controls.update();
    if (sight === "anaglyph") this.stereo = Object.assign(new AnaglyphEffect(this.renderer), { eyeSep: EYES_APART_MM, planeDistance: this.camera.focus });
    if (sight === "side-by-side") (this.stereo = new StereoEffect(this.renderer)).setEyeSeparation(EYES_APART_MM);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.renderer.setSize(width, height);
    this.stereo?.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

  /** Millimetres of one CSS pixel at the point that the camera turns about. */
  get mmPerPixel() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    return (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.host.clientHeight;
  }

  /** CSS pixels of a point (mm). */
  pixelOf(point) {
    const p = new Vector3(...point).project(this.camera);
    return [((p.x + 1) / 2) * this.host.clientWidth, ((1 - p.y) / 2) * this.host.clientHeight];
  }

  /** Letters around the scene, below the row of buttons; one towards or away from the eye would name no side of what is seen. */
  placeLetters() {
    const { clientWidth: width, clientHeight: height } = this.host;
    const [across, upwards] = [0, 1].map((a) => new Vector3().setFromMatrixColumn(this.camera.matrixWorld, a));
    const room = [Math.min(width / 2 - 20, height / 2 + 80), height / 2 - 22];
    for (const { mark, direction } of this.sides) {
      const [x, y] = [direction.dot(across), -direction.dot(upwards)];
      const size = Math.hypot(x, y);
      mark.hidden = size < 0.7;
      mark.style.left = `${width / 2 + (room[0] * x) / size}px`;
      mark.style.top = `${Math.max(BELOW_BUTTONS, height / 2 + (room[1] * y) / size)}px`;
    }
  }

  render() {
    if (!this.dirty) return false;
    this.dirty = false;
    const eye = this.camera.position;
    this.lamp.position.copy(eye).addScaledVector(this.camera.up, 0.4 * this.radius);
    const plane = this.open && this.shown.plane ? this.moment?.plane : null;
    if (plane) {
      this.cutPlane.setFromNormalAndCoplanarPoint(new Vector3(...plane.normal), new Vector3(...plane.origin));
      if (this.cutPlane.distanceToPoint(eye) > 0) this.cutPlane.negate();
    }
    this.placeLetters();
    for (const { surface, solid, veil } of this.surfaces) {
      const shell = surface.role === "fixture";
      const blood = surface.role === "blood";
      const ofMr = surface.role === "organ" || surface.role === "unseen";
      const around = this.changed && this.shown.patient && ofMr; // a veil about the patient's surface
      solid.visible = !around && (Boolean(plane) || shell || !blood || !this.shown.organ);
      solid.material.clippingPlanes = plane ? [this.cutPlane] : null;
      veil.visible = around || ((ofMr || ["patient", "structure"].includes(surface.role)) && Boolean(plane));
      veil.material.opacity = this.veil;
    }
    (this.stereo ?? this.renderer).render(this.scene, this.camera);
    return true;
  }
}

/** A letter that names a side of the patient. */
function sideMark(host, letter) {
  const mark = document.createElement("b");
  mark.className = "over side";
  mark.textContent = letter;
  host.append(mark);
  return mark;
}

/** How far the organ reaches from its centre along each axis. */
function halfExtents(heart, center) {
  const organ = heart.surfaces.find((one) => one.role === "organ");
  const out = organ ? [20, 20, 20] : [60, 60, 60];
  organ?.at(0).forEach((value, i) => (out[i % 3] = Math.max(out[i % 3], Math.abs(value - center.getComponent(i % 3)))));
  return out;
}
