"""Headless Chromium by the WebDriver protocol (W3C), with the standard library alone."""

import base64
import json
import shutil
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any

MISSING = "Chromium or its driver is missing (Debian: apt-get install chromium chromium-driver)"
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-dev-shm-usage",
)


def chromium() -> tuple[str, str] | None:
    """Paths of the browser and of its driver; None where either is missing."""
    browser, driver = shutil.which("chromium"), shutil.which("chromedriver")
    return (browser, driver) if browser and driver else None


class Page:
    """One window."""

    def __init__(self, session: str) -> None:
        self._session = session

    def open(self, url: str) -> None:
        _ask("POST", f"{self._session}/url", {"url": url})

    def run(self, script: str, *arguments: Any) -> Any:
        """What a function's body returns."""
        return _ask("POST", f"{self._session}/execute/sync", {"script": script, "args": list(arguments)})

    def until(self, script: str, seconds: float = 20.0) -> Any:
        """The first true answer."""
        end = monotonic() + seconds
        while monotonic() < end:
            found = self.run(script)
            if found:
                return found
            sleep(0.03)
        raise TimeoutError(f"not true within {seconds:g} s: {script}")

    def resize(self, width: int, height: int) -> None:
        sizes = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        command = {"cmd": "Emulation.setDeviceMetricsOverride", "params": sizes}
        _ask("POST", f"{self._session}/goog/cdp/execute", command)

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(_ask("GET", f"{self._session}/screenshot")))

    def requests(self) -> list[str]:
        """Addresses that were asked for since the last call."""
        entries = _ask("POST", f"{self._session}/se/log", {"type": "performance"})
        messages = [json.loads(one["message"])["message"] for one in entries]
        sent = [one["params"] for one in messages if one["method"] == "Network.requestWillBeSent"]
        return [one["request"]["url"] for one in sent]

    def complaints(self) -> list[str]:
        """Errors and warnings of the console since the last call."""
        return [one["message"] for one in _ask("POST", f"{self._session}/se/log", {"type": "browser"})]


@contextmanager
def browser(profile: Path) -> Iterator[Page]:
    """A window of a browser of its own, with an empty profile."""
    found = chromium()
    if found is None:
        raise RuntimeError(MISSING)
    program, driver = found
    log = profile.with_suffix(".log")
    with log.open("w") as out:
        process = subprocess.Popen([driver, "--port=0"], stdout=subprocess.PIPE, stderr=out, text=True)
    session = None
    try:
        root = f"http://127.0.0.1:{_port(process)}"
        options = {"binary": program, "args": [*_FLAGS, f"--user-data-dir={profile}"]}
        wanted = {
            "browserName": "chrome",
            "goog:chromeOptions": options,
            "goog:loggingPrefs": {"performance": "ALL", "browser": "WARNING"},
        }
        answer = _ask("POST", f"{root}/session", {"capabilities": {"alwaysMatch": wanted}})
        session = f"{root}/session/{answer['sessionId']}"
        yield Page(session)
    finally:
        if session is not None:
            _ask("DELETE", session)
        process.terminate()
        process.communicate(timeout=10)


def _port(process: "subprocess.Popen[str]") -> int:
    if process.stdout is None:
        raise RuntimeError("the driver says nothing")
    for line in process.stdout:
        if "successfully on port " in line:
            return int(line.split("on port ")[1].split(".")[0].split()[0])
    raise RuntimeError("the driver did not start")


def _ask(method: str, url: str, body: dict[str, Any] | None = None) -> Any:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"}, method=method)
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)["value"]
    except urllib.error.HTTPError as error:
        told = json.load(error)["value"]
        raise RuntimeError(f"{told['error']}: {told['message'][:500]}") from error
