// Ultrasound frames and planes as pictures: decoded when they are needed, and what of them was insonified.

import { bytesOf } from "./payload.js";

const LIT = 8;
const ROWS_BESIDE = 4;

/** First and last column of each row in which a picture is not black; what lies between was insonified.
 *
 * Medians over some rows: compression leaves stray pixels beside the image. */
export function litRows({ data, width, height }) {
  const rows = Array.from({ length: height }, (_, r) => {
    let [first, last] = [width, -1];
    for (let c = 0; c < width; c++) {
      if (data[4 * (r * width + c)] < LIT) continue;
      first = Math.min(first, c);
      last = c;
    }
    return [first, last];
  });
  return rows.map((_, r) => {
    const near = rows.slice(Math.max(0, r - ROWS_BESIDE), r + ROWS_BESIDE + 1);
    return [0, 1].map((end) => near.map((row) => row[end]).sort((a, b) => a - b)[near.length >> 1]);
  });
}

/** Frames decoded when they are needed; the last ones are kept. */
export class Pictures {
  constructor(frames) {
    this.frames = frames;
    this.kept = new Map();
  }

  /** The bitmap of frame i, if it is there already. */
  ready(i) {
    return this.kept.get(this.frames.event_s[i])?.bitmap ?? null;
  }

  async get(i) {
    const key = this.frames.event_s[i];
    let entry = this.kept.get(key);
    if (!entry) {
      entry = {};
      const blob = new Blob([bytesOf(this.frames.images[i])], { type: this.frames.mime });
      entry.promise = createImageBitmap(blob).then((bitmap) => (entry.bitmap = bitmap));
      this.kept.set(key, entry);
      if (this.kept.size > 64) this.kept.delete(this.kept.keys().next().value);
    }
    return entry.promise;
  }
}
