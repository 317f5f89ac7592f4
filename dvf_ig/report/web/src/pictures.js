// Ultrasound frames and planes as pictures: decoded when they are needed, and what of them was insonified.

import { bytesOf } from "./payload.js";

const LIT = 8;

/** First and last column of each row in which a picture is not black; what lies between was insonified. */
export function litRows({ data, width, height }) {
  return Array.from({ length: height }, (_, r) => {
    let [first, last] = [width, -1];
    for (let c = 0; c < width; c++) {
      if (data[4 * (r * width + c)] < LIT) continue;
      first = Math.min(first, c);
      last = c;
    }
    return [first, last];
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
