// Colours by what is shown, told apart by people with any colour blindness (Okabe and Ito 2008).

export const COLORS = {
  organ: "#f0916a",
  unseen: "#8d8f98",
  blood: "#56b4e9",
  patient: "#f2f2f2",
  structure: "#b7a1f5",
  fixture: "#1fc39a",
  force: "#f0e442",
  plane: "#cc79a7",
  tool: "#ffffff",
};

/** Red, green and blue of a shift outwards (red) or inwards (blue), grey where it is not known. */
export function shiftColor(shift, largest) {
  if (Number.isNaN(shift)) return [0.35, 0.35, 0.37];
  const share = Math.min(1, Math.abs(shift) / largest);
  const [r, g, b] = shift > 0 ? [0.7, 0.02, 0.06] : [0.02, 0.14, 0.5];
  return [r, g, b].map((end) => 0.9 + share * (end - 0.9));
}

/** Red, green and blue of how well a shift is known, dark where it is known least, grey where it is not. */
export function sigmaColor(sigma, largest) {
  if (Number.isNaN(sigma)) return [0.35, 0.35, 0.37];
  const share = Math.min(1, sigma / largest);
  return [0.32, 0.08, 0.4].map((end) => 0.95 + share * (end - 0.95));
}

export const STATES = {
  ok: "#009e73",
  degraded: "#e69f00",
  fade: "#9a9fa6",
  latched: "#d55e00",
};

/** Colours that go with the theme, from the style sheet. */
export function themeColor(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
