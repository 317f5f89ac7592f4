// The scene in space: beating heart, ultrasound plane, tool, force, fixture, sides of the patient, millimetre scale.

import {
  BackSide, BufferAttribute, BufferGeometry, CanvasTexture, Color, ConeGeometry, CylinderGeometry,
  DirectionalLight, DoubleSide, FrontSide, Group, HemisphereLight, Line, LineBasicMaterial, LineLoop, LineSegments, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, MeshPhongMaterial, PerspectiveCamera, Plane, Quaternion, Scene, SphereGeometry, Sprite, SpriteMaterial, SRGBColorSpace,
  Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { COLORS, themeColor } from "./colors.js";
import { bracket } from "./heart.js";
import { litRows } from "./image.js";

const UP = new Vector3(0, 1, 0);
const ARROW_MM_PER_N = 70;
const SHAFT_MM = 130;
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
    this.camera.up.set(0, 0, 1);
    this.renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.localClippingEnabled = true;
    host.prepend(this.renderer.domElement);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.copy(this.center);
    this.controls.addEventListener("change", () => (this.dirty = true));
    this.half = halfExtents(heart, this.center);
    this.radius = Math.hypot(this.half[0], this.half[1], this.half[2]) / 1.25;
    this.shown = { organ: true, blood: true, fixture: true, plane: true, field: true };
    this.open = true;
    this.cutPlane = new Plane(new Vector3(0, 0, 1), 0);
    this.light();
    this.surfaces = heart.surfaces.map((surface) => this.surfaceMeshes(surface));
    this.ultrasound = scene.image && this.ultrasoundPlane(scene.image);
    this.paths = (scene.fixtures ?? []).filter((one) => one.path_mm).map((one) => this.pathLine(one));
    this.tool = this.toolGroup();
    this.force = this.arrow();
    this.sides = SIDES.map(([letter, direction]) => this.sideMark(letter, direction));
    this.targets = (scene.targets ?? []).map((one) => this.targetMark(one, scene.bound_mm));
    this.dark = Boolean(scene.planes);
    for (const one of scene.planes ?? []) this.scene.add(this.planeEdge(one, scene.image));
    this.preset("front");
    this.retheme();
  }

  light() {
    const sky = new HemisphereLight(0xffffff, 0x40322c, 1.0);
    sky.position.set(0, -0.4, 1);
    this.scene.add(sky);
    this.lamp = new DirectionalLight(0xffffff, 2.1);
    this.scene.add(this.lamp, this.lamp.target);
    this.lamp.target.position.copy(this.center);
  }

  /** Behind the ultrasound plane a surface is solid, before it a veil. */
  surfaceMeshes(surface) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(surface.at(0), 3));
    geometry.setIndex(new BufferAttribute(surface.triangles, 1));
    geometry.computeVertexNormals();
    const color = COLORS[surface.role];
    const fixture = surface.role === "fixture";
    const blood = surface.role === "blood";
    const solid = new Mesh(
      geometry,
      new MeshPhongMaterial({
        color, side: fixture ? BackSide : DoubleSide, transparent: fixture, opacity: fixture ? 0.3 : 1, depthWrite: !fixture,
        shininess: 35, specular: fixture ? 0 : 0x2a2a2a,
      }),
    );
    const veil = new Mesh(
      geometry,
      new MeshLambertMaterial({ color, side: FrontSide, transparent: true, opacity: 0.2, depthWrite: false }),
    );
    veil.renderOrder = blood ? 3 : 4;
    solid.renderOrder = fixture ? -1 : 0;
    const group = new Group();
    group.add(solid, veil);
    this.scene.add(group);
    return { surface, geometry, solid, veil, group };
  }

  ultrasoundPlane(image) {
    const outline = image.fan_px ?? [
      [-0.5, -0.5], [image.columns - 0.5, -0.5], [image.columns - 0.5, image.rows - 0.5], [-0.5, image.rows - 0.5],
    ];
    const count = outline.length;
    const middle = [0, 1].map((a) => outline.reduce((sum, one) => sum + one[a], 0) / count);
    this.planePixels = [middle, ...outline];
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * (count + 1)), 3));
    const uv = this.planePixels.flatMap(([c, r]) => [(c + 0.5) / image.columns, 1 - (r + 0.5) / image.rows]);
    geometry.setAttribute("uv", new BufferAttribute(new Float32Array(uv), 2));
    geometry.setIndex(outline.flatMap((_, i) => [0, 1 + i, 1 + ((i + 1) % count)]));
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [image.columns, image.rows];
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = SRGBColorSpace;
    texture.anisotropy = 4;
    const sheet = new Mesh(geometry, new MeshBasicMaterial({ map: texture, side: DoubleSide, alphaTest: 0.5, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2 }));
    sheet.renderOrder = 1;
    const edge = new BufferGeometry();
    edge.setAttribute("position", new BufferAttribute(new Float32Array(3 * count), 3));
    const border = new LineLoop(edge, new LineBasicMaterial({ color: COLORS.plane }));
    border.renderOrder = 6;
    const group = new Group();
    group.add(sheet, border);
    for (const role of ["blood", "organ"]) group.add(this.outline(role));
    group.visible = false;
    this.scene.add(group);
    return { group, geometry, edge, canvas, texture, context: canvas.getContext("2d", { willReadFrequently: !image.fan_px }) };
  }

  /** Where a surface meets the plane, drawn in space. */
  outline(role) {
    const lines = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: COLORS[role] }));
    lines.renderOrder = 2;
    lines.frustumCulled = false;
    this.outlines = { ...this.outlines, [role]: lines };
    return lines;
  }

  /** Takes the contours of the image: pairs of (column, row). */
  contours(list, plane) {
    if (!this.outlines) return;
    for (const [role, lines] of Object.entries(this.outlines)) {
      lines.visible = this.shown[role];
      const flat = list.filter((one) => one.role === role).flatMap((one) => one.segments);
      const out = new Float32Array((flat.length / 2) * 3);
      for (let i = 0; i < flat.length; i += 2)
        for (let a = 0; a < 3; a++)
          out[(i / 2) * 3 + a] = plane.origin[a] + flat[i] * plane.right[a] + flat[i + 1] * plane.down[a];
      lines.geometry.dispose();
      lines.geometry = new BufferGeometry();
      lines.geometry.setAttribute("position", new BufferAttribute(out, 3));
    }
    this.dirty = true;
  }

  pathLine(fixture) {
    const geometry = new BufferGeometry();
    const count = fixture.path_mm[0].length;
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * count), 3));
    const line = new Line(geometry, new LineBasicMaterial({ color: COLORS.fixture, depthTest: false }));
    line.renderOrder = 7;
    this.scene.add(line);
    return { fixture, geometry, line };
  }

  /** A ball at the tip, the shaft behind it; a pale copy shows through what hides them. */
  toolGroup() {
    const group = new Group();
    const shaft = new CylinderGeometry(1.6, 1.6, SHAFT_MM, 20).translate(0, SHAFT_MM / 2 + 2, 0);
    const tip = new SphereGeometry(2.6, 24, 16);
    const metal = new MeshLambertMaterial({ color: 0xb9c0c8 });
    const ball = new MeshLambertMaterial({ color: 0xffffff, emissive: 0x333333 });
    const ghost = new MeshBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.28, depthTest: false, depthWrite: false });
    const hull = new MeshBasicMaterial({ color: 0x111111, side: BackSide });
    const rim = new Mesh(new SphereGeometry(3.1, 24, 16), hull);
    group.add(new Mesh(shaft, metal), new Mesh(tip, ball), rim);
    for (const shape of [shaft, tip]) {
      const pale = new Mesh(shape, ghost);
      pale.renderOrder = 8;
      group.add(pale);
    }
    this.shaft = group.children.filter((one) => one.geometry === shaft);
    this.scene.add(group);
    return group;
  }

  /** Shaft and head with a dark rim, in front of all else. */
  arrow() {
    const group = new Group();
    const part = (geometry, color, order, side) => {
      const material = new MeshBasicMaterial({ color, depthTest: false, depthWrite: false, transparent: true, side });
      const mesh = new Mesh(geometry, material);
      mesh.renderOrder = order;
      group.add(mesh);
      return mesh;
    };
    const stem = (r) => new CylinderGeometry(r, r, 1, 16).translate(0, 0.5, 0);
    const head = (r, h, lift) => new ConeGeometry(r, h, 24).translate(0, h / 2 - lift, 0);
    this.arrowParts = {
      stems: [part(stem(1.7), 0x111111, 20, FrontSide), part(stem(1.15), COLORS.force, 21, FrontSide)],
      heads: [part(head(4.3, 10.2, 0.7), 0x111111, 20, FrontSide), part(head(3.4, 8.4, 0), COLORS.force, 21, FrontSide)],
    };
    this.scene.add(group);
    return group;
  }

  sideMark(letter, direction) {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 64;
    const sprite = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), depthTest: false, transparent: true, sizeAttenuation: false }));
    const axis = direction.findIndex((one) => one !== 0);
    sprite.position.copy(this.center).addScaledVector(new Vector3(...direction), this.half[axis] + 14);
    sprite.scale.setScalar(0.028);
    sprite.renderOrder = 9;
    this.scene.add(sprite);
    return { letter, canvas, sprite };
  }

  /** A point in a ball of the bound on its error. */
  targetMark(target, bound) {
    const group = new Group();
    const part = (radius, opacity, depthTest) => {
      const material = new MeshBasicMaterial({ color: COLORS.force, transparent: true, opacity, depthTest, depthWrite: false });
      const mesh = new Mesh(new SphereGeometry(radius, 24, 16), material);
      mesh.renderOrder = 10;
      group.add(mesh);
    };
    part(1.2, 0.95, false);
    if (bound) part(bound, 0.3, true);
    group.position.set(...target.xyz_mm);
    this.scene.add(group);
    return group;
  }

  /** Where another plane of a registration lies. */
  planeEdge(plane, { columns, rows }) {
    const corners = [[0, 0], [columns, 0], [columns, rows], [0, rows]];
    const m = plane.mr_from_pixel;
    const points = corners.flatMap(([c, r]) => m.map((row) => row[0] * c + row[1] * r + row[2]));
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
    return new LineLoop(geometry, new LineBasicMaterial({ color: COLORS.plane, transparent: true, opacity: 0.45 }));
  }

  retheme() {
    this.scene.background = new Color(themeColor("space"));
    this.veil = Number(themeColor("veil"));
    for (const { letter, canvas, sprite } of this.sides) {
      const draw = canvas.getContext("2d");
      draw.clearRect(0, 0, 64, 64);
      draw.font = "600 44px system-ui, sans-serif";
      draw.textAlign = "center";
      draw.textBaseline = "middle";
      draw.fillStyle = themeColor("mark");
      draw.fillText(letter, 32, 34);
      sprite.material.map.needsUpdate = true;
    }
    this.dirty = true;
  }

  /** Shows one moment: model phase, plane of the frame, tip, shaft and force; null for what is not known. */
  show({ phase, plane, tip, shaft, force }) {
    this.moment = { plane, tip, force };
    const known = phase !== null;
    for (const { surface, geometry, group } of this.surfaces) {
      group.visible = this.shown[surface.role] ?? true;
      if (!group.visible) continue;
      surface.at(known ? phase : 0);
      geometry.attributes.position.needsUpdate = true;
      geometry.computeVertexNormals();
    }
    for (const one of this.targets) one.visible = this.shown.targets !== false;
    for (const { fixture, geometry, line } of this.paths) {
      line.visible = this.shown.path !== false;
      moved(fixture, geometry, known ? phase : 0);
    }
    this.placePlane(plane);
    this.tool.visible = tip !== null;
    if (tip) {
      this.tool.position.set(...tip);
      for (const one of this.shaft) one.visible = shaft !== null;
      if (shaft) this.tool.quaternion.setFromUnitVectors(UP, new Vector3(...shaft).normalize());
    }
    this.placeArrow(tip, force);
    this.dirty = true;
  }

  placePlane(plane) {
    if (!this.ultrasound) return;
    this.ultrasound.group.visible = plane !== null && this.shown.plane;
    if (!plane) return;
    const positions = this.ultrasound.geometry.attributes.position;
    const edge = this.ultrasound.edge.attributes.position;
    this.planePixels.forEach(([c, r], i) => {
      const p = [0, 1, 2].map((a) => plane.origin[a] + c * plane.right[a] + r * plane.down[a]);
      positions.setXYZ(i, ...p);
      if (i) edge.setXYZ(i - 1, ...p);
    });
    positions.needsUpdate = edge.needsUpdate = true;
    this.ultrasound.geometry.computeBoundingSphere();
    this.ultrasound.edge.computeBoundingSphere();
  }

  placeArrow(tip, force) {
    const size = tip && force ? Math.hypot(...force) : 0;
    this.force.visible = size > 0.005;
    if (!this.force.visible) return;
    const length = ARROW_MM_PER_N * size;
    const head = Math.min(1, length / 12);
    const stem = Math.max(0.01, length - 8.4 * head);
    this.force.position.set(...tip);
    this.force.quaternion.setFromUnitVectors(UP, new Vector3(...force).divideScalar(size));
    for (const one of this.arrowParts.stems) one.scale.set(head, stem, head);
    for (const one of this.arrowParts.heads) {
      one.position.y = stem;
      one.scale.setScalar(head);
    }
  }

  /** Draws a decoded frame into the plane's texture. */
  picture(image) {
    if (!this.ultrasound || !image) return;
    const { context, canvas } = this.ultrasound;
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    if (this.dark) seeThroughBlack(context, canvas);
    this.ultrasound.texture.needsUpdate = true;
    this.dirty = true;
  }

  /** Views: of the patient, face to face with the plane, close to the tool. */
  preset(name) {
    const toward = { front: [0.35, -1, 0.42], left: [1, -0.25, 0.3], above: [0.1, -0.35, 1], back: [-0.4, 1, 0.4] };
    const { plane, tip, force } = this.moment ?? {};
    let direction = new Vector3(...(toward[name] ?? toward.front)).normalize();
    const target = this.center.clone();
    let distance = 1.1 * this.radius;
    if (name === "plane" && plane) {
      direction = new Vector3(...plane.normal);
      if (direction.y > 0) direction.negate();
      direction.addScaledVector(new Vector3(...plane.down).normalize(), -0.12).normalize();
      distance = 1.05 * this.radius;
    }
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

  resize() {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.renderer.setSize(width, height);
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
    const view = eye.clone().sub(this.controls.target).normalize();
    // a letter towards the eye would lie over the heart and name no side of what is seen
    this.sides.forEach(({ sprite }, i) => (sprite.visible = Math.abs(view.dot(new Vector3(...SIDES[i][1]))) < 0.7));
    for (const { surface, solid, veil } of this.surfaces) {
      const shell = surface.role === "fixture";
      const blood = surface.role === "blood";
      solid.visible = Boolean(plane) || shell || !blood || !this.shown.organ;
      solid.material.clippingPlanes = plane ? [this.cutPlane] : null;
      veil.visible = surface.role === "organ" && Boolean(plane);
      veil.material.opacity = this.veil;
    }
    this.renderer.render(this.scene, this.camera);
    return true;
  }
}

function moved(fixture, geometry, phase) {
  const fractions = fixture.path_fractions;
  const [a, b, weight] = fractions.length > 1 ? bracket(fractions, phase) : [0, 0, 0];
  const position = geometry.attributes.position;
  fixture.path_mm[a].forEach((p, i) => {
    const q = fixture.path_mm[b][i];
    position.setXYZ(i, ...p.map((one, axis) => one + weight * (q[axis] - one)));
  });
  position.needsUpdate = true;
  geometry.computeBoundingSphere();
}

/** What was not insonified is black in a plane without a known sector; there one sees through it. */
function seeThroughBlack(context, { width, height }) {
  const picture = context.getImageData(0, 0, width, height);
  litRows(picture).forEach(([first, last], r) => {
    for (let c = 0; c < width; c++) if (c < first || c > last) picture.data[4 * (r * width + c) + 3] = 0;
  });
  context.putImageData(picture, 0, 0);
}

/** How far the organ reaches from its centre along each axis. */
function halfExtents(heart, center) {
  const organ = heart.surfaces.find((one) => one.role === "organ");
  const out = organ ? [20, 20, 20] : [60, 60, 60];
  organ?.at(0).forEach((value, i) => (out[i % 3] = Math.max(out[i % 3], Math.abs(value - center.getComponent(i % 3)))));
  return out;
}
