// Colours by what is shown, told apart by people with any colour blindness (Okabe and Ito 2008).

export const COLORS = {
  organ: "#f0916a",
  unseen: "#8d8f98",
  blood: "#56b4e9",
  fixture: "#1fc39a",
  force: "#f0e442",
  plane: "#cc79a7",
  tool: "#ffffff",
};

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
