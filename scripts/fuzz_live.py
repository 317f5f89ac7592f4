"""`dvf-ig serve` under live faults: it must end in a stated state without force, whatever the fault.

Each case starts `serve` as its own program on the toy's patient, streams to it over loopback at real
speed until a force is given, injects one fault, and ends it. The last force that a peer received must
be zero, the last status a latch with a sentence, the exit code as stated.
"""

import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from live_toy import ORIGIN_S, arrivals_of
from served_toy import serve_toy
from toy_session import Streams, compare_known, ecg_events, ecg_of, frame_events, register_known, tool_events
from waiting import heed_interrupts

from dvf_ig.live.igtl import Image, Incoming, Message, Status, Text, Transform, WireError, encode

RR_S, STREAM_S, ECG_CHUNK = 0.5, 60.0, 5
READY_S, GIVEN_S, ENDED_S = 240.0, 40.0, 20.0
"""Longest time that a busy machine may need to listen, to give a force, to end."""
GUIDING_N = 0.02
ROOT = Path(__file__).resolve().parents[1]
FAIL, SLOW = "FAIL", "SLOW"
"""Devices whose message makes the child's session raise, or makes it slow to send its last messages."""
SLOW_S = 0.6
PAGE_PATHS = ("/scene.json", "/", "/events")

Change = Callable[[float, Message], Iterable[Message | bytes]]
"""Function from seconds since the fault began (negative: before) and a message to what is sent instead."""


# ------------------------------------------------------------------ the program under test


def child(arguments: list[str]) -> None:
    """Run `serve` with the toy's patient; a registration is known at once."""
    from dvf_ig.cli.main import run
    from dvf_ig.live.devices import DeviceNames
    from dvf_ig.live.link import Link

    patch = pytest.MonkeyPatch()
    serve_toy(patch)
    patch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
    patch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)
    patch.setattr("dvf_ig.session.registration_plan.FIRST_REGISTRATION_S", 2.5)
    patch.setattr("dvf_ig.session.work.COMPUTE_S", 0.3)
    image_of, send_last = DeviceNames.image_of, Link.send_last

    def slowly(link: Link, messages: list[Message]) -> None:
        time.sleep(SLOW_S)
        send_last(link, messages)

    def failing(names: DeviceNames, message: Message) -> object:
        if message.device == FAIL:
            raise RuntimeError("a fault on purpose")
        if message.device == SLOW:
            patch.setattr(Link, "send_last", slowly)
        return image_of(names, message)

    patch.setattr(DeviceNames, "image_of", failing)
    sys.argv = ["dvf-ig", *arguments]
    run()


# ------------------------------------------------------------------ the peer


def recording() -> list[tuple[float, Message]]:
    """Record the toy's streams at a fast heart, each message with the time at which it is sent."""
    beats = np.arange(0.4, STREAM_S + 2.0, RR_S)
    ecg = ecg_events(ecg_of(0.0, STREAM_S, r_peaks=beats), chunk=ECG_CHUNK)
    streams = Streams(ecg, frame_events(STREAM_S), tool_events(STREAM_S))
    arrivals = arrivals_of(streams, latency_s=0.0)
    return [(a.arrived_s, a.taken) for a in arrivals if isinstance(a.taken, Message)]


@dataclass
class Heard:
    """Messages received by a peer: forces with their times, and the newest status."""

    forces: list[tuple[float, float]] = field(default_factory=list)
    status: Status | None = None
    closed: bool = False

    def take(self, message: Message) -> None:
        if message.device == "ToolForce" and isinstance(message.content, Transform):
            newton = float(np.linalg.norm(message.content.matrix[:3, 3]))
            self.forces.append((time.monotonic(), newton))
        elif message.device == "DvfIg" and isinstance(message.content, Status):
            self.status = message.content

    @property
    def force_n(self) -> float:
        """Return the last force; NaN if none has come."""
        return self.forces[-1][1] if self.forces else float("nan")


class Peer:
    """Peer that connects to `serve`, streams, and listens."""

    def __init__(
        self, port: int, messages: list[tuple[float, Message]], change: Change, fault_s: float | None = None
    ) -> None:
        self.connection = socket.create_connection(("127.0.0.1", port), timeout=5.0)
        self.port, self.heard, self.reads = port, Heard(), True
        self.fault_s = fault_s
        self._messages, self._change, self._stop = messages, change, threading.Event()
        self._threads = [threading.Thread(target=one, daemon=True) for one in (self._send, self._hear)]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(5.0)
        self.connection.close()

    def reconnect(self) -> None:
        old, self.connection = self.connection, socket.create_connection(("127.0.0.1", self.port))
        old.close()

    def send(self, one: Message | bytes) -> None:
        """Send a whole message, unless the other side has gone or does not read for long."""
        try:
            self.connection.sendall(encode(one) if isinstance(one, Message) else one)
        except OSError:
            return

    def _send(self) -> None:
        begin_s = time.monotonic()
        for t_s, message in self._messages:
            while (left_s := begin_s + t_s - time.monotonic()) > 0.0:
                if self._stop.wait(min(left_s, 0.02)):
                    return
            since_s = -1.0 if self.fault_s is None else time.monotonic() - self.fault_s
            for one in self._change(since_s, message):
                self.send(one)

    def _hear(self) -> None:
        incoming, heard_from = Incoming(), self.connection
        while True:
            if self.connection is not heard_from:
                incoming, heard_from = Incoming(), self.connection
            if not self.reads:
                if self._stop.wait(0.02):
                    return
                continue
            try:
                if not select.select([heard_from], [], [], 0.02)[0]:
                    if self._stop.is_set():
                        return
                    continue
                data = heard_from.recv(1 << 16)
                messages = incoming.feed(data) if data else []
            except (OSError, ValueError, WireError):
                data, messages = b"", []
            if not data and self.connection is heard_from:
                self.heard.closed = True
                return
            for message in messages:
                if isinstance(message, Message):
                    self.heard.take(message)


# ------------------------------------------------------------------ faults


@dataclass(frozen=True)
class Fault:
    """Fault and its expected outcome.

    Attributes:
        change: change of the stream; `act`: action when the fault begins.
        lasts_s: time from its start until the program is ended.
        force: whether a force is given, or withheld, at its end; None if either is right.
        code: expected exit codes; `ends`: the program ends by itself; `by`: the signal that ends it.
        from_start: the fault is at the stream's start.
        hears_end: the peer receives the end, unless it does not read.
        page: the program serves its page.
    """

    name: str
    change: Change
    act: "Callable[[Case], None] | None" = None
    lasts_s: float = 2.5
    force: bool | None = None
    code: tuple[int, ...] = (0,)
    ends: bool = False
    by: signal.Signals = signal.SIGINT
    from_start: bool = False
    hears_end: bool = True
    page: bool = False


@dataclass
class Case:
    """State of a running fault."""

    process: "subprocess.Popen[bytes]"
    peer: Peer
    port: int
    page_port: int
    resumed_s: float | None = None
    finished: threading.Event = field(default_factory=threading.Event)
    others: list[Peer] = field(default_factory=list)


def _unchanged(since_s: float, message: Message) -> Iterable[Message | bytes]:
    return (message,)


def _of(device: str, change: Callable[[float, Message], Iterable[Message | bytes]]) -> Change:
    """Change one device's messages during the fault."""

    def changed(since_s: float, message: Message) -> Iterable[Message | bytes]:
        here = since_s >= 0.0 and (device in ("", message.device))
        return change(since_s, message) if here else (message,)

    return changed


def _once(device: str, change: Callable[[Message], Message]) -> Change:
    """Change a device's first message in the fault."""
    changed_one: list[bool] = []

    def changed(since_s: float, message: Message) -> Iterable[Message | bytes]:
        if changed_one or since_s < 0.0 or message.device != device:
            return (message,)
        changed_one.append(True)
        return (change(message),)

    return changed


TOOL, PROBE, IMAGE, ECG = "ToolToTracker", "ProbeToTracker", "Image_Tracker", "EcgData"


def _stamped(by_s: float) -> Callable[[Message], Message]:
    def changed(message: Message) -> Message:
        fields = dict(message.fields)
        if (key := f"{ECG}Timestamp") in fields:
            fields[key] = repr(float(fields[key]) + by_s)
        stamp_s = None if message.stamp_s is None else message.stamp_s + by_s
        return replace(message, stamp_s=stamp_s, fields=MappingProxyType(fields))

    return changed


def _posed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Message], Message]:
    def changed(message: Message) -> Message:
        if not isinstance(message.content, Transform):
            return message
        return replace(message, content=Transform(change(message.content.matrix.copy())))

    return changed


def _all(change: Callable[[Message], Message]) -> Callable[[float, Message], Iterable[Message]]:
    return lambda since_s, message: (change(message),)


def _moved(by_mm: float) -> Callable[[np.ndarray], np.ndarray]:
    def changed(matrix: np.ndarray) -> np.ndarray:
        matrix[0, 3] += by_mm
        return matrix

    return changed


def _to_and_fro(by_mm: float) -> Callable[[float, Message], Iterable[Message]]:
    """Move every other pose, as two programs on one connection send them."""
    turn: list[int] = []

    def changed(since_s: float, message: Message) -> Iterable[Message]:
        turn.append(0)
        return (_posed(_moved(by_mm if len(turn) % 2 else 0.0))(message),)

    return changed


def _filled(value: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda matrix: np.full((4, 4), value)


def _frozen() -> Callable[[float, Message], Iterable[Message]]:
    sent: list[Message] = []

    def changed(since_s: float, message: Message) -> Iterable[Message]:
        sent.append(message)
        return (replace(message, content=sent[0].content),)

    return changed


def _drifting(rate: float) -> Callable[[float, Message], Iterable[Message]]:
    return lambda since_s, message: (_stamped(rate * since_s)(message),)


def _text(text: str) -> Callable[[Message], Message]:
    return lambda message: replace(message, content=Text(text))


def _pixels(pixels: np.ndarray) -> Callable[[Message], Message]:
    return lambda message: replace(message, content=Image(pixels, np.eye(4)))


def _swapped() -> Callable[[float, Message], Iterable[Message]]:
    waiting: list[Message] = []

    def changed(since_s: float, message: Message) -> Iterable[Message]:
        if waiting:
            return (message, waiting.pop())
        waiting.append(message)
        return ()

    return changed


def _wrong_checksum(message: Message) -> bytes:
    data = bytearray(encode(message))
    data[50] ^= 1
    return bytes(data)


def _with(
    extra: Callable[[Message], list[Message | bytes]], count: int
) -> Callable[..., Iterable[Message | bytes]]:
    return lambda since_s, message: (message, *(one for _ in range(count) for one in extra(message)))


def _stopped(seconds: float) -> Callable[[Case], None]:
    def act(case: Case) -> None:
        case.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        case.resumed_s = time.monotonic()
        case.process.send_signal(signal.SIGCONT)

    return act


def _half_message(case: Case) -> None:
    case.peer.send(encode(Message(TOOL, 1.0, Transform(np.eye(4))))[:70])


def _cut(case: Case) -> None:
    _half_message(case)
    case.peer.reconnect()


def _garbage(case: Case) -> None:
    case.peer.send(os.urandom(4096))
    time.sleep(0.2)
    case.peer.reconnect()


def _second_sender(case: Case) -> None:
    here = [(t_s, message) for t_s, message in case.peer._messages if message.device == TOOL]
    case.others.append(Peer(case.port, here, lambda _, message: (_posed(_moved(1.0))(message),)))


def _idle_connections(case: Case) -> None:
    for _ in range(20):
        case.others.append(Peer(case.port, [], _unchanged))


def _unread(case: Case) -> None:
    case.peer.reads = False


def _sends(device: str) -> Callable[[Case], None]:
    return lambda case: case.peer.send(Message(device, None, Text("x")))


def _page_requests(lines: str, threads: int) -> Callable[[Case], None]:
    """Send requests one after the other from `threads` threads until the case is finished."""

    def ask(case: Case, number: int) -> None:
        while not case.finished.is_set():
            path = PAGE_PATHS[number % len(PAGE_PATHS)]
            try:
                with socket.create_connection(("127.0.0.1", case.page_port), timeout=1.0) as one:
                    host = f"127.0.0.1:{case.page_port}"
                    one.sendall(f"GET {path} HTTP/1.0\r\nHost: {host}\r\n{lines}\r\n".encode())
                    while not case.finished.is_set() and one.recv(1 << 16):
                        pass
            except OSError:
                time.sleep(0.001)

    def act(case: Case) -> None:
        for number in range(threads):
            threading.Thread(target=ask, args=(case, number), daemon=True).start()

    return act


def _half_requests(case: Case) -> None:
    for _ in range(30):
        one = socket.create_connection(("127.0.0.1", case.page_port), timeout=1.0)
        one.sendall(b"GET /events HTTP/1.0\r\n")


def _first(device: str, change: Callable[[Message], Message]) -> Change:
    """Change the stream's first message of a device."""
    return _once(device, change)


FAR_S = 2.0**32 - 2.0 * STREAM_S - ORIGIN_S
SMALL, COLOUR = np.zeros((1, 1, 1), np.uint8), np.zeros((1, 24, 24, 3), np.uint8)
OTHER, BLACK = np.full((1, 40, 30), 9, np.uint8), np.zeros((1, 24, 24), np.uint8)
MANY = " ".join(["0.5"] * 15_000)


def faults() -> tuple[Fault, ...]:
    """List all faults; changes keep state, so each case needs new ones."""
    return (
        Fault("nothing", _unchanged, force=True),
        Fault("tool stops", _of(TOOL, lambda *_: ()), force=False),
        Fault(
            "tool stops for 0.3 s", _of(TOOL, lambda since_s, m: () if since_s < 0.3 else (m,)), force=True
        ),
        Fault("everything stops", _of("", lambda *_: ()), force=False),
        Fault("tool jumps 60 mm to and fro", _of(TOOL, _to_and_fro(60.0)), force=False),
        Fault("tool frozen", _of(TOOL, _frozen()), force=False),
        Fault("tool not a number", _of(TOOL, _all(_posed(_filled(float("nan"))))), force=False),
        Fault("tool scaled", _of(TOOL, _all(_posed(lambda m: 1.2 * m))), force=False),
        Fault("tool at 1e30 mm", _of(TOOL, _all(_posed(_moved(1e30)))), force=False),
        Fault("tool at 500 m", _of(TOOL, _all(_posed(_moved(5e5)))), force=False),
        Fault("two programs send the tool", _unchanged, _second_sender, lasts_s=3.5, force=False),
        Fault("one tool stamp near 2^32 s", _once(TOOL, _stamped(FAR_S)), force=True),
        Fault("all stamps near 2^32 s", _of("", _all(_stamped(FAR_S))), force=False),
        Fault(
            "stamps near 2^32 s from the start", _first(TOOL, _stamped(FAR_S)), from_start=True, force=True
        ),
        Fault("one tool stamp 10 s ahead", _once(TOOL, _stamped(10.0)), force=True),
        Fault("first tool stamp 10 s ahead", _first(TOOL, _stamped(10.0)), from_start=True, force=True),
        Fault("one image stamp 10 s ahead", _once(IMAGE, _stamped(10.0)), force=True),
        Fault("one ECG stamp 10 s ahead", _once(ECG, _stamped(10.0))),
        Fault("clocks go back 100 s", _of("", _all(_stamped(-100.0))), lasts_s=3.5, force=False),
        Fault("clocks go ahead 100 s", _of("", _all(_stamped(100.0))), lasts_s=3.5),
        Fault("clocks drift by 2 %", _of("", _drifting(0.02))),
        Fault("no stamps", _of("", _all(lambda m: replace(m, stamp_s=None)))),
        Fault("ECG stops", _of(ECG, lambda *_: ())),
        Fault("first ECG sample 1e200", _first(ECG, _text("1e200 0 0 0 0")), from_start=True, force=True),
        Fault("ECG not a number", _of(ECG, _all(_text("nan nan nan nan nan")))),
        Fault("ECG of 15 000 samples", _of(ECG, _all(_text(MANY)))),
        Fault("ECG is no text of numbers", _of(ECG, _all(_text("x y z")))),
        Fault("images stop", _of(IMAGE, lambda *_: ())),
        Fault("first image 1 x 1", _first(IMAGE, _pixels(SMALL)), from_start=True, force=True),
        Fault("first image 40 x 30", _first(IMAGE, _pixels(OTHER)), from_start=True, force=True),
        Fault("images of another size", _of(IMAGE, _all(_pixels(OTHER)))),
        Fault("images of 1 x 1", _of(IMAGE, _all(_pixels(SMALL)))),
        Fault("images of colours", _of(IMAGE, _all(_pixels(COLOUR)))),
        Fault("black images", _of(IMAGE, _all(_pixels(BLACK)))),
        Fault("everything twice", _of("", lambda since_s, m: (m, m)), force=True),
        Fault("messages swapped", _of(TOOL, _swapped())),
        Fault("half a message", _unchanged, _half_message),
        Fault("cut within a message, and back", _unchanged, _cut, lasts_s=3.5),
        Fault("garbage, and back", _unchanged, _garbage, lasts_s=3.5),
        Fault("wrong checksums beside", _of(TOOL, _with(lambda m: [_wrong_checksum(m)], 20)), force=True),
        Fault("flood of texts", _of(TOOL, _with(lambda m: [Message("Other", m.stamp_s, Text("x"))], 200))),
        Fault(
            "flood of refused images",
            _of(TOOL, _with(lambda m: [_pixels(COLOUR)(replace(m, device=IMAGE))], 20)),
        ),
        Fault("20 more connections", _unchanged, _idle_connections, force=True),
        Fault("peer does not read", _unchanged, _unread, hears_end=False),
        Fault("stopped for 12 ms", _unchanged, _stopped(0.012)),
        Fault("stopped for 50 ms", _unchanged, _stopped(0.050)),
        Fault("stopped for 0.2 s", _unchanged, _stopped(0.2), force=False),
        Fault("stopped for 1 s", _unchanged, _stopped(1.0), force=False),
        Fault("stopped for 2 s", _unchanged, _stopped(2.0), force=False),
        Fault("terminal that is not read", _of(TOOL, _with(lambda m: [_wrong_checksum(m)], 50)), force=True),
        Fault("slow to end at Ctrl-C", _unchanged, _sends(SLOW), force=True),
        Fault("SIGTERM", _unchanged, by=signal.SIGTERM, force=True),
        Fault("SIGHUP", _unchanged, by=signal.SIGHUP, force=True),
        Fault("the program fails", _unchanged, _sends(FAIL), code=(70,), ends=True, force=False),
        Fault("flood of the page", _unchanged, _page_requests("", 8), page=True),
        Fault("cross-site flood", _unchanged, _page_requests("Sec-Fetch-Site: cross-site\r\n", 8), page=True),
        Fault("half requests of the page", _unchanged, _half_requests, page=True, force=True),
    )


UNREAD = "terminal that is not read"


# ------------------------------------------------------------------ one case


@dataclass(frozen=True)
class Outcome:
    """Outcome of a fault: state and force before the end, the last ones, the exit code, what is wrong."""

    state: str
    force_n: float
    last_state: str
    last_n: float
    code: int | None
    wrong_while: tuple[str, ...]
    """Problems at the end, including a machine too busy for a force."""
    wrong_at_end: tuple[str, ...]

    @property
    def row(self) -> tuple[str, ...]:
        force = (f"{self.force_n:.2f} N", f"{self.last_n:.2f} N")
        wrong = "; ".join((*self.wrong_while, *self.wrong_at_end)) or "ok"
        return (self.state, force[0], self.last_state, force[1], str(self.code), wrong)


def run_fault(fault: Fault, folder: Path, messages: list[tuple[float, Message]]) -> Outcome:
    """Start the program, inject the fault and end it."""
    arguments = [sys.executable, "-m", "scripts.fuzz_live", "serve", "x", "--listen", "--port", "0"]
    arguments += ["--page", "0"] if fault.page else []
    read_end, write_end = os.pipe()
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests/toys'}"}
    with (folder / "stdout").open("wb") as stdout:
        process = subprocess.Popen(
            arguments,
            stdout=stdout,
            stderr=write_end,
            stdin=subprocess.DEVNULL,
            cwd=ROOT,
            env=environment,
            preexec_fn=heed_interrupts,
        )
    os.close(write_end)
    terminal = _Terminal(read_end)
    try:
        return _judged(fault, process, terminal, messages)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        terminal.end()


class _Terminal:
    """Reader of a program's stderr while `reads` is set."""

    def __init__(self, target: int) -> None:
        self.text, self.reads = "", True
        self._target, self._stop = target, threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def number_after(self, words: str) -> int | None:
        _, match, rest = self.text.partition(words)
        line, end, _ = rest.partition("\n")
        return int(line) if match and end else None

    def end(self) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._target)

    def _read(self) -> None:
        while not self._stop.is_set():
            if not self.reads or not select.select([self._target], [], [], 0.02)[0]:
                self._stop.wait(0.02)
                continue
            data = os.read(self._target, 1 << 16)
            if not data:
                return
            self.text += data.decode("utf-8", "replace")


def _until(condition: Callable[[], bool], within_s: float) -> bool:
    end_s = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.005)
    return True


def _judged(
    fault: Fault,
    process: "subprocess.Popen[bytes]",
    terminal: _Terminal,
    messages: list[tuple[float, Message]],
) -> Outcome:
    ports = ["listening at 127.0.0.1:", "shown at http://127.0.0.1:"][: 1 + fault.page]
    if not _until(lambda: None not in map(terminal.number_after, ports), READY_S):
        raise SystemExit(f"serve did not start: {terminal.text[-800:]}")
    port, *page = (terminal.number_after(words) or 0 for words in ports)
    peer = Peer(port, messages, fault.change, time.monotonic() if fault.from_start else None)
    case, wrong = Case(process, peer, port, page[0] if page else 0), []
    try:
        if not _until(lambda: peer.heard.force_n > GUIDING_N, GIVEN_S):
            wrong.append("no force was given before the fault")
        terminal.reads = fault.name != UNREAD
        begin_s = time.monotonic()
        peer.fault_s = peer.fault_s or begin_s
        if fault.act is not None:
            fault.act(case)
        _until(lambda: process.poll() is not None, max(0.0, fault.lasts_s - time.monotonic() + begin_s))
        heard = peer.heard
        state, force_n = heard.status.name if heard.status else "none", heard.force_n
        wrong += _wrong_while(fault, case, force_n)
        if not fault.ends and process.poll() is None:
            process.send_signal(fault.by)
        _until(lambda: process.poll() is not None, ENDED_S)
        peer.reads = True
        _until(lambda: heard.closed, 2.0)
        ended = _wrong_at_end(fault, process.poll(), heard, terminal.text)
        last = heard.status.name if heard.status else "none"
        return Outcome(state, force_n, last, heard.force_n, process.poll(), tuple(wrong), tuple(ended))
    finally:
        case.finished.set()
        for one in (peer, *case.others):
            one.end()


def _wrong_while(fault: Fault, case: Case, force_n: float) -> list[str]:
    wrong = []
    if not fault.ends and case.process.poll() is not None:
        wrong.append("it ended by itself")
    if fault.force is not None and not fault.ends and (force_n > GUIDING_N) != fault.force:
        wrong.append("a force was given" if force_n > GUIDING_N else "no force was given")
    if case.resumed_s is not None and fault.force is False:
        after = [newton for t_s, newton in case.peer.heard.forces if t_s > case.resumed_s]
        if after and after[0] > 0.0:
            wrong.append(f"the first force after the stop was {after[0]:.2f} N")
    return wrong


def _wrong_at_end(fault: Fault, code: int | None, heard: Heard, text: str) -> list[str]:
    wrong = []
    if code not in fault.code:
        wrong.append("it did not end" if code is None else f"exit code {code}")
    if not heard.closed:
        wrong.append("the connection stayed open")
    if not fault.hears_end:
        return wrong
    if heard.force_n != 0.0:
        wrong.append(f"the last force was {heard.force_n:.2f} N")
    if heard.status is None or heard.status.name != "LATCHED" or not heard.status.text:
        wrong.append("no state was stated at the end")
    if fault.code == (0,) and "Traceback" in text:
        wrong.append("a traceback")
    return wrong


def fuzz_live(repeats: int, chosen: list[str]) -> int:
    """Count findings over all faults, `repeats` times each, and print a line for each case."""
    messages, bad, cases = recording(), 0, 0
    for number in range(repeats):
        for fault in faults():
            if chosen and fault.name not in chosen:
                continue
            with tempfile.TemporaryDirectory() as scratch:
                outcome = run_fault(fault, Path(scratch), messages)
            cases, bad = cases + 1, bad + bool(outcome.wrong_while or outcome.wrong_at_end)
            print(f"{number + 1}  {fault.name:<34}  " + "  ".join(outcome.row), flush=True)
    print(f"{cases} cases: {bad} findings")
    return bad


if __name__ == "__main__":
    child(sys.argv[1:])
