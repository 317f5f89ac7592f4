// Dark or light: what the reader chose before, or what the machine prefers.

export function localTheme() {
  try {
    const kept = localStorage.getItem("dvf-theme");
    if (kept) return kept;
  } catch {
    // a page from disk may have no storage
  }
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

export function rememberTheme(theme) {
  try {
    localStorage.setItem("dvf-theme", theme);
  } catch {
    // as above
  }
}
