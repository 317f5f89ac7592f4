// What the reader can do: legend, buttons, drags on the time bars, keys.

import { legendRows, SPEEDS, VIEWS } from "./layout.js";

/** A button for each thing that is shown, which hides it. */
export function legend(viewer) {
  const box = viewer.$("legend");
  box.replaceChildren();
  viewer.space.shown.labels ??= false;
  for (const [role, color, text] of legendRows(viewer.scene, viewer.series, viewer.space.heart, viewer.bySigma)) {
    const button = document.createElement("button");
    button.innerHTML = `<i style="background:${color}"></i>`;
    button.append(text);
    viewer.space.shown[role] ??= true;
    button.dataset.role = role;
    const on = () => viewer.space.shown[role];
    button.setAttribute("aria-pressed", on());
    button.onclick = () => {
      viewer.space.shown[role] = !on();
      if (viewer.image) viewer.image.shown[role] = on();
      button.setAttribute("aria-pressed", on());
      viewer.changed = true;
    };
    box.append(button);
  }
}

/** Buttons, menus, and the canvases on which a drag seeks. */
export function connectControls(viewer) {
  const { $ } = viewer;
  $("play").onclick = () => viewer.play(!viewer.playing);
  $("beat-back").onclick = () => viewer.beat(-1);
  $("beat-on").onclick = () => viewer.beat(1);
  $("speed").onchange = () => (viewer.speed = Number($("speed").value));
  $("span").onchange = () => {
    viewer.strips.span = Number($("span").value);
    viewer.changed = true;
  };
  $("theme").onclick = () => viewer.applyTheme(viewer.theme === "dark" ? "light" : "dark", true);
  $("help").onclick = () => $("keys").showModal();
  for (const button of $("views").children) button.onclick = () => viewer.view(button.dataset.view);
  $("cut").onclick = () => viewer.cut(!viewer.space.open);
  $("cut").hidden = !viewer.scene.image;
  viewer.cut(Boolean(viewer.scene.image));
  $("sigma").onclick = () => viewer.colorBySigma(!viewer.bySigma);
  $("sigma").hidden = !viewer.space.changed;
  drag(viewer, $("overview"), (x) => viewer.overview.timeAt(x));
  drag(viewer, viewer.strips.canvas, (x, from) => viewer.strips.timeAt(x, from));
  if (viewer.series.live) document.body.classList.add("live");
}

/** A drag seeks; strips keep the window in which it began. */
function drag(viewer, canvas, timeAt) {
  const move = (event) => {
    if (viewer.series.live) return;
    const [first, last] = viewer.strips.window(viewer.t);
    viewer.seek(timeAt(event.clientX - canvas.getBoundingClientRect().left, viewer.t, first, last));
  };
  canvas.onpointerdown = (event) => {
    viewer.play(false);
    canvas.setPointerCapture(event.pointerId);
    const from = viewer.t;
    const place = (one) => viewer.seek(timeAt(one.clientX - canvas.getBoundingClientRect().left, from));
    if (!viewer.series.live) place(event);
    canvas.onpointermove = canvas === viewer.strips.canvas ? (one) => !viewer.series.live && place(one) : move;
  };
  canvas.onpointerup = canvas.onpointercancel = () => (canvas.onpointermove = null);
}

/** The keys of the help. */
export function connectKeys(viewer) {
  const { series } = viewer;
  const step = (event) => (event.shiftKey || viewer.registration ? 1 : 0.1);
  const actions = {
    " ": () => !viewer.registration && viewer.play(!viewer.playing),
    ArrowLeft: (event) => viewer.seek(viewer.t - step(event)),
    ArrowRight: (event) => viewer.seek(viewer.t + step(event)),
    ArrowUp: () => viewer.beat(-1),
    ArrowDown: () => viewer.beat(1),
    ",": () => viewer.frameStep(-1),
    ".": () => viewer.frameStep(1),
    Home: () => viewer.seek(series.begin),
    End: () => viewer.seek(series.end),
    "-": () => viewer.faster(-1),
    "+": () => viewer.faster(1),
    c: () => viewer.cut(!viewer.space.open),
    u: () => viewer.space.changed && viewer.$("sigma").click(),
    l: () => viewer.$("legend").querySelector('[data-role="labels"]')?.click(),
    t: () => viewer.$("theme").click(),
    h: () => viewer.$("keys").showModal(),
    "?": () => viewer.$("keys").showModal(),
  };
  VIEWS.forEach(([name], i) => (actions[i + 1] = () => viewer.view(name)));
  addEventListener("keydown", (event) => {
    if (event.target.matches("select, input") || event.ctrlKey || event.metaKey || event.altKey) return;
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action || viewer.$("keys").open) return;
    event.preventDefault();
    action(event);
  });
}
