// A running session: events from the server that the page came from.

const SILENT_MS = 1500;
const RELOAD_MS = 1500;

export function listen(viewer) {
  const source = new EventSource("events");
  const told = viewer.$("connection");
  let last = performance.now();
  const tell = (text, lost) => {
    told.hidden = false;
    told.textContent = text;
    told.classList.toggle("lost", lost);
    document.body.classList.toggle("stale", lost);
  };
  tell("connecting …", true);
  source.onmessage = (message) => {
    last = performance.now();
    const event = JSON.parse(message.data);
    viewer.series.push(event);
    // the scene was asked for before the first frame, which tells the size of the image
    if (event.frame && !viewer.scene.image && last > RELOAD_MS) location.reload();
    if (!viewer.opened && viewer.space.moment?.plane) viewer.view("plane");
    viewer.opened ||= Boolean(viewer.space.moment?.plane);
    tell("live", false);
  };
  source.onerror = () => tell("no connection; trying again …", true);
  setInterval(() => {
    if (source.readyState === EventSource.OPEN && performance.now() - last > SILENT_MS) tell("the session is silent", true);
  }, 500);
}
