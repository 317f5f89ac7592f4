// The ultrasound image as a sheet in space, with the lines in which the heart's surfaces meet it.

import {
  BufferAttribute, BufferGeometry, CanvasTexture, DoubleSide, Group, LineBasicMaterial, LineLoop, LineSegments, Mesh, MeshBasicMaterial,
  SRGBColorSpace,
} from "three";
import { COLORS } from "./colors.js";
import { litRows } from "./pictures.js";

export class UltrasoundSheet {
  /** `dark`: black is what was not insonified, for the sector is not known. */
  constructor(image, dark) {
    this.dark = dark;
    const outline = image.fan_px ?? [
      [-0.5, -0.5], [image.columns - 0.5, -0.5], [image.columns - 0.5, image.rows - 0.5], [-0.5, image.rows - 0.5],
    ];
    const count = outline.length;
    const middle = [0, 1].map((a) => outline.reduce((sum, one) => sum + one[a], 0) / count);
    this.planePixels = [middle, ...outline];
    const geometry = (this.geometry = new BufferGeometry());
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * (count + 1)), 3));
    const uv = this.planePixels.flatMap(([c, r]) => [(c + 0.5) / image.columns, 1 - (r + 0.5) / image.rows]);
    geometry.setAttribute("uv", new BufferAttribute(new Float32Array(uv), 2));
    geometry.setIndex(outline.flatMap((_, i) => [0, 1 + i, 1 + ((i + 1) % count)]));
    const canvas = (this.canvas = document.createElement("canvas"));
    [canvas.width, canvas.height] = [image.columns, image.rows];
    const texture = (this.texture = new CanvasTexture(canvas));
    texture.colorSpace = SRGBColorSpace;
    texture.anisotropy = 4;
    const sheet = new Mesh(geometry, new MeshBasicMaterial({ map: texture, side: DoubleSide, alphaTest: 0.5, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2 }));
    sheet.renderOrder = 1;
    const edge = (this.edge = new BufferGeometry());
    edge.setAttribute("position", new BufferAttribute(new Float32Array(3 * count), 3));
    const border = new LineLoop(edge, new LineBasicMaterial({ color: COLORS.plane }));
    border.renderOrder = 6;
    const group = (this.group = new Group());
    group.add(sheet, border);
    const roles = ["structure", "blood", "unseen", "organ", "patient"];
    this.outlines = Object.fromEntries(roles.map((role) => [role, intersection(role)]));
    group.add(...Object.values(this.outlines));
    group.visible = false;
    this.context = canvas.getContext("2d", { willReadFrequently: !image.fan_px });
  }

  /** Where its pose puts it; hidden without one. */
  place(plane, shown) {
    this.group.visible = plane !== null && shown;
    if (!plane) return;
    const positions = this.geometry.attributes.position;
    const edge = this.edge.attributes.position;
    this.planePixels.forEach(([c, r], i) => {
      const p = [0, 1, 2].map((a) => plane.origin[a] + c * plane.right[a] + r * plane.down[a]);
      positions.setXYZ(i, ...p);
      if (i) edge.setXYZ(i - 1, ...p);
    });
    positions.needsUpdate = edge.needsUpdate = true;
    this.geometry.computeBoundingSphere();
    this.edge.computeBoundingSphere();
  }

  /** Takes the contours of the image, pairs of (column, row), and which roles are shown. */
  contours(list, plane, shown) {
    for (const [role, lines] of Object.entries(this.outlines)) {
      lines.visible = shown[role] ?? true;
      const flat = list.filter((one) => one.role === role).flatMap((one) => one.segments);
      const out = new Float32Array((flat.length / 2) * 3);
      for (let i = 0; i < flat.length; i += 2)
        for (let a = 0; a < 3; a++)
          out[(i / 2) * 3 + a] = plane.origin[a] + flat[i] * plane.right[a] + flat[i + 1] * plane.down[a];
      lines.geometry.dispose();
      lines.geometry = new BufferGeometry();
      lines.geometry.setAttribute("position", new BufferAttribute(out, 3));
    }
  }

  /** Draws a decoded frame into the texture. */
  picture(image) {
    const { context, canvas } = this;
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    if (this.dark) seeThroughBlack(context, canvas);
    this.texture.needsUpdate = true;
  }
}

/** Where a surface meets the plane, drawn in space. */
function intersection(role) {
  const lines = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: COLORS[role] }));
  lines.renderOrder = 2;
  lines.frustumCulled = false;
  return lines;
}

/** What was not insonified is black in a plane without a known sector; there one sees through it. */
function seeThroughBlack(context, { width, height }) {
  const picture = context.getImageData(0, 0, width, height);
  litRows(picture).forEach(([first, last], r) => {
    for (let c = 0; c < width; c++) if (c < first || c > last) picture.data[4 * (r * width + c) + 3] = 0;
  });
  context.putImageData(picture, 0, 0);
}
