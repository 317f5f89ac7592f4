// A running session: events from the server that the page came from.

const SILENT_MS = 1500;

export function listen(viewer) {
  const source = new EventSource("events");
  const told = viewer.$("connection");
  let last = performance.now();
  const tell = (text, lost) => {
    told.hidden = false;
    told.textContent = text;
    told.classList.toggle("lost", lost);
  };
  tell("connecting …", true);
  source.onmessage = (message) => {
    last = performance.now();
    viewer.series.push(JSON.parse(message.data));
    tell("live", false);
  };
  source.onerror = () => tell("no connection; trying again …", true);
  setInterval(() => {
    if (source.readyState === EventSource.OPEN && performance.now() - last > SILENT_MS) tell("the session is silent", true);
  }, 500);
}
