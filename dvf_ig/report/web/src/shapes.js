// What stands in the scene: surfaces, tool, force, path of a guidance, sides of the patient, targets, planes.
// Each has a `group` that the scene takes.

import {
  BackSide, BufferAttribute, BufferGeometry, CanvasTexture, ConeGeometry, CylinderGeometry, DoubleSide, FrontSide, Group, Line,
  LineBasicMaterial, LineLoop, Mesh, MeshBasicMaterial, MeshLambertMaterial, MeshPhongMaterial, SphereGeometry, Sprite, SpriteMaterial,
  Vector3,
} from "three";
import { COLORS, shiftColor, sigmaColor } from "./colors.js";
import { bracket } from "./heart.js";

const UP = new Vector3(0, 1, 0);
const ARROW_MM_PER_N = 70;
/** A tool of which nothing is stated: radii of ball and shaft, and the shaft's length. */
const [BALL_MM, STEM_MM, SHAFT_MM] = [2.6, 1.6, 130];

/** Behind the ultrasound plane a surface is solid, before it a veil. */
export function surfaceMeshes(surface) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(surface.at(0), 3));
  geometry.setIndex(new BufferAttribute(surface.triangles, 1));
  geometry.computeVertexNormals();
  const vertexColors = Boolean(surface.outward);
  const color = vertexColors ? 0xffffff : COLORS[surface.role];
  if (vertexColors) colorPatient(geometry, surface, false);
  const fixture = surface.role === "fixture";
  const blood = surface.role === "blood";
  const solid = new Mesh(
    geometry,
    new MeshPhongMaterial({
      color, vertexColors, side: fixture ? BackSide : DoubleSide, transparent: fixture, opacity: fixture ? 0.3 : 1, depthWrite: !fixture,
      shininess: 35, specular: fixture ? 0 : 0x2a2a2a,
    }),
  );
  const veil = new Mesh(
    geometry,
    new MeshLambertMaterial({ color, vertexColors, side: FrontSide, transparent: true, opacity: 0.2, depthWrite: false }),
  );
  veil.renderOrder = blood ? 3 : 4;
  solid.renderOrder = fixture ? -1 : 0;
  const group = new Group();
  group.add(solid, veil);
  return { surface, geometry, solid, veil, group };
}

/** Colours a surface of the patient by its shift from the MR, or by how well that is known. */
export function colorPatient(geometry, surface, bySigma) {
  const rgb = bySigma
    ? Array.from(surface.sigma).flatMap((one) => sigmaColor(one, surface.largest_sigma_mm))
    : Array.from(surface.outward).flatMap((one) => shiftColor(one, surface.largest_mm));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(rgb), 3));
}

/** A ball at the tip, the shaft behind it, as thick and long as stated; a pale copy shows through what hides them. */
export class Tool {
  constructor(stated) {
    const group = (this.group = new Group());
    const [radius, length] = [stated?.diameter_mm / 2 || BALL_MM, stated?.shaft_mm || SHAFT_MM];
    const stem = stated?.diameter_mm ? radius : STEM_MM;
    const shaft = new CylinderGeometry(stem, stem, length, 20).translate(0, length / 2, 0);
    const tip = new SphereGeometry(radius, 24, 16);
    const metal = new MeshLambertMaterial({ color: 0xb9c0c8 });
    const ball = new MeshLambertMaterial({ color: 0xffffff, emissive: 0x333333 });
    const ghost = new MeshBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.28, depthTest: false, depthWrite: false });
    const hull = new MeshBasicMaterial({ color: 0x111111, side: BackSide });
    const rim = new Mesh(new SphereGeometry(radius + 0.5, 24, 16), hull);
    group.add(new Mesh(shaft, metal), new Mesh(tip, ball), rim);
    for (const shape of [shaft, tip]) {
      const pale = new Mesh(shape, ghost);
      pale.renderOrder = 8;
      group.add(pale);
    }
    this.shaft = group.children.filter((one) => one.geometry === shaft);
  }

  /** At the tip, along the shaft's direction; null hides what is not known. */
  place(tip, shaft) {
    this.group.visible = tip !== null;
    if (!tip) return;
    this.group.position.set(...tip);
    for (const one of this.shaft) one.visible = shaft !== null;
    if (shaft) this.group.quaternion.setFromUnitVectors(UP, new Vector3(...shaft).normalize());
  }
}

/** Shaft and head with a dark rim, in front of all else. */
export class ForceArrow {
  constructor() {
    const group = (this.group = new Group());
    const part = (geometry, color, order, side) => {
      const material = new MeshBasicMaterial({ color, depthTest: false, depthWrite: false, transparent: true, side });
      const mesh = new Mesh(geometry, material);
      mesh.renderOrder = order;
      group.add(mesh);
      return mesh;
    };
    const stem = (r) => new CylinderGeometry(r, r, 1, 16).translate(0, 0.5, 0);
    const head = (r, h, lift) => new ConeGeometry(r, h, 24).translate(0, h / 2 - lift, 0);
    this.stems = [part(stem(1.7), 0x111111, 20, FrontSide), part(stem(1.15), COLORS.force, 21, FrontSide)];
    this.heads = [part(head(4.3, 10.2, 0.7), 0x111111, 20, FrontSide), part(head(3.4, 8.4, 0), COLORS.force, 21, FrontSide)];
  }

  /** Begins at the tip; hidden where either is not known, or the force is too small to see. */
  place(tip, force) {
    const size = tip && force ? Math.hypot(...force) : 0;
    this.group.visible = size > 0.005;
    if (!this.group.visible) return;
    const length = ARROW_MM_PER_N * size;
    const head = Math.min(1, length / 12);
    const stem = Math.max(0.01, length - 8.4 * head);
    this.group.position.set(...tip);
    this.group.quaternion.setFromUnitVectors(UP, new Vector3(...force).divideScalar(size));
    for (const one of this.stems) one.scale.set(head, stem, head);
    for (const one of this.heads) {
      one.position.y = stem;
      one.scale.setScalar(head);
    }
  }
}

/** The path that a guidance leads to, moving with the heart. */
export class TargetPath {
  constructor(fixture) {
    this.fixture = fixture;
    this.geometry = new BufferGeometry();
    const count = fixture.path_mm[0].length;
    this.geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * count), 3));
    this.group = new Line(this.geometry, new LineBasicMaterial({ color: COLORS.fixture, depthTest: false }));
    this.group.renderOrder = 7;
  }

  /** Where the path is at a phase of the cycle. */
  place(phase, visible) {
    this.group.visible = visible;
    const { path_fractions: fractions, path_mm } = this.fixture;
    const [a, b, weight] = fractions.length > 1 ? bracket(fractions, phase) : [0, 0, 0];
    const position = this.geometry.attributes.position;
    path_mm[a].forEach((p, i) => {
      const q = path_mm[b][i];
      position.setXYZ(i, ...p.map((one, axis) => one + weight * (q[axis] - one)));
    });
    position.needsUpdate = true;
    this.geometry.computeBoundingSphere();
  }
}

/** A point in a ball of the bound on its error. */
export function targetMark(target, bound) {
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
  return { group };
}

/** A pellet of a training; the one at hand shows through what hides it. */
export function pellet() {
  const material = new MeshLambertMaterial({ color: 0x2456c8, emissive: 0x101830 });
  const ghost = new MeshBasicMaterial({ color: COLORS.force, transparent: true, opacity: 0.75, depthTest: false, depthWrite: false });
  const ball = new SphereGeometry(2, 24, 16);
  const [far, near] = [new Mesh(ball, material), new Mesh(ball, ghost)];
  near.renderOrder = 6;
  const group = new Group();
  group.add(far, near);
  const place = (at, current) => {
    group.visible = Boolean(at);
    near.visible = current;
    if (at) group.position.set(...at);
  };
  return { group, place };
}

/** Where another plane of a registration lies. */
export function planeEdge(plane, { columns, rows }) {
  const corners = [[0, 0], [columns, 0], [columns, rows], [0, rows]];
  const m = plane.mr_from_pixel;
  const points = corners.flatMap(([c, r]) => m.map((row) => row[0] * c + row[1] * r + row[2]));
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
  return { group: new LineLoop(geometry, new LineBasicMaterial({ color: COLORS.plane, transparent: true, opacity: 0.45 })) };
}
