"""A live session from its configuration: link, clocks, session, and the threads that they need."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from math import inf

import numpy as np

from dvf_ig.core import InvalidInputError, Landmarks
from dvf_ig.guidance.servo.inputs import VALID_FOR_S
from dvf_ig.intake.live import BreathFieldConfig, BreathMarkerConfig, EcgFieldConfig, LiveConfig
from dvf_ig.session import Event, Landmark, Session, SessionHistory, SessionSetup, ThreadedExecutor, ToolPose

from .answers import last_messages
from .devices import DeviceNames, flips_between
from .events import EventSource
from .frames import LiveEvent
from .haptic import HapticTool
from .igtl import encode
from .igtl.codec import checksum
from .link import LOOPBACK, Inbox, Link, connect, is_loopback, listen
from .loop import Answer, LiveLoop, no_more
from .priority import answering_soon
from .record import NO_RECORD, CountedWork, Record
from .samples.field import EcgField
from .samples.respiration import BreathField

CUT_OFF = "the connection is ended because of a message that broke the protocol; connect again"
LOOK_EVERY_S = 0.05
"""Interval at which a caller that waits for a session checks whether it is asked to end it."""
SampledEvents = Callable[[], list[LiveEvent]]


def _nothing(_: object) -> None:
    """Default callback without effect."""


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options of a live session in addition to its setup.

    Attributes:
        config: who sends what.
        landmarks: touched before, in frames "mr" and "tracker"; None if a start pose takes their place.
        samples: events of ECG and breathing that no peer sends (`dvf_ig.live.samples`).
        observe: called with every answer, `watch` with every event, `tell` with a sentence about a problem.
        history: of registrations and beats; None keeps the last ones.
        record: receives everything in order.
        haptic: device that is the tool, entered already; None if the peers send the tool's poses.
    """

    config: LiveConfig
    landmarks: tuple[Landmarks, Landmarks] | None = None
    samples: SampledEvents = no_more
    observe: Callable[[Answer], None] = _nothing
    watch: Callable[[Event], None] = _nothing
    tell: Callable[[str], None] = _nothing
    history: SessionHistory | None = None
    record: Record = NO_RECORD
    haptic: HapticTool | None = None
    clock: Callable[[], float] = field(default=time.monotonic)


@contextmanager
def live_session(setup: SessionSetup, options: LiveOptions) -> Iterator[LiveLoop]:
    """Connected, or listening, and ready to `run`; everything ends with the context.

    Raises:
        InvalidInputError: as `open_link`; names in `allow` that are no addresses.
    """
    config, inbox = options.config, Inbox()
    with ExitStack() as stack:
        executor = CountedWork(stack.enter_context(ThreadedExecutor(waits=False)), options.record)
        session = stack.enter_context(
            Session(
                setup,
                executor=executor,
                clock=time.perf_counter,
                history=options.history,
                latch_after_s=VALID_FOR_S,
            )
        )
        _compile_kernels(setup)
        stack.enter_context(answering_soon())
        link = open_link(config, inbox)
        link.farewell = b"".join(map(encode, last_messages(CUT_OFF, None)))
        stack.enter_context(link)
        yield LiveLoop(
            session=session,
            source=EventSource(
                device_names(config), _ecg_of_peers(config), options.tell, _breath_of_peers(config)
            ),
            inbox=inbox,
            link=link,
            more_events=options.samples,
            observe=options.observe,
            tell=options.tell,
            watch=options.watch,
            landmarks=_touched(options),
            record=options.record,
            haptic=options.haptic,
            clock=options.clock,
        )


def _compile_kernels(setup: SessionSetup) -> None:
    """Compile, or load, what messages and states need; a session would be silent meanwhile."""
    checksum(b"")
    with Session(setup) as session:
        for t_s in (0.0, 0.01):
            session.push(ToolPose(t_s, np.eye(4)))
            session.state(t_s)


class SessionThread(threading.Thread):
    """Thread that runs a live session while its caller goes on.

    Its end is an event: in Python 3.11 an exception that a signal raises within `Thread.join` marks a thread
    that still runs as ended (CPython issue 90882).
    """

    def __init__(self, loop: LiveLoop) -> None:
        super().__init__(name="dvf-ig session", daemon=True)
        self._loop, self._asked, self._ended = loop, threading.Event(), threading.Event()
        self._error: BaseException | None = None

    def run(self) -> None:
        """Run until `end`, or an error, which `end` raises."""
        try:
            self._loop.run(self._asked)
        except BaseException as error:  # noqa: BLE001  raised again by `end`
            self._error = error
        finally:
            self._ended.set()

    def wait(self, seconds: float | None, end_requested: Callable[[], bool]) -> None:
        """Wait for the session's end, at most `seconds`, or until `end_requested`."""
        end_s = inf if seconds is None else time.monotonic() + seconds
        while not end_requested() and (left_s := end_s - time.monotonic()) > 0.0:
            if self._ended.wait(min(left_s, LOOK_EVERY_S)):
                return

    def end(self) -> None:
        """End the session after its last messages; raise what ended it before."""
        self._asked.set()
        self._ended.wait()
        self.join()
        if self._error is not None:
            raise self._error


def open_link(config: LiveConfig, inbox: Inbox) -> Link:
    """As a client of a server on this machine or of one that is allowed; as a server for those who are.

    Raises:
        InvalidInputError: as `require_allowed`, or the address cannot be listened at.
    """
    require_allowed(config)
    if config.role == "server":
        return listen(config.host, config.port, inbox, (LOOPBACK, *config.allow))
    return connect(config.host, config.port, inbox)


def require_allowed(config: LiveConfig) -> None:
    """Raise InvalidInputError where poses would come from another machine that `allow` does not name."""
    if is_loopback(config.host):
        return
    if config.role == "server" and not config.allow:
        raise InvalidInputError(
            f"{config.host} can be reached from other machines; name those that may connect (--allow)"
        )
    if config.role == "client" and config.host not in config.allow:
        raise InvalidInputError(
            f"{config.host} is another machine; poses come from it only if you allow it: "
            f"--allow {config.host}"
        )


def device_names(config: LiveConfig) -> DeviceNames:
    """The names that the configuration gives."""
    flips = flips_between(config.image_orientation, config.used_orientation)
    breath = config.respiration
    chest = breath.marker if isinstance(breath, BreathMarkerConfig) else None
    return DeviceNames(config.probe, config.tool, config.image, config.reference, chest, flips)


def _ecg_of_peers(config: LiveConfig) -> EcgField | None:
    ecg = config.ecg
    return EcgField(ecg.field, ecg.rate_hz, ecg.lead) if isinstance(ecg, EcgFieldConfig) else None


def _breath_of_peers(config: LiveConfig) -> BreathField | None:
    breath = config.respiration
    if not isinstance(breath, BreathFieldConfig):
        return None
    return BreathField(breath.field, breath.rate_hz, breath.channel)


def _touched(options: LiveOptions) -> tuple[Landmark, ...]:
    """Landmarks as events that happened before the session began."""
    if options.landmarks is None:
        return ()
    now_s = options.clock()
    names, marked, touched = options.landmarks[0].paired_with(options.landmarks[1])
    return tuple(
        Landmark(now_s, name, mr_mm, tracker_mm)
        for name, mr_mm, tracker_mm in zip(names, marked.xyz_mm, touched.xyz_mm, strict=True)
    )
