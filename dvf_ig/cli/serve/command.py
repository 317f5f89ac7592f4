"""`dvf-ig serve`: a live session with PLUS or 3D Slicer."""

import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from dvf_ig.cli import fixture_options
from dvf_ig.cli.session_argument import ModelOption, require_own_model
from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, out_folder, output_file, warn

from .log import LOG, LogLevel, logged
from .setup import live_setup
from .undrained import queued_stderr

if TYPE_CHECKING:
    from dvf_ig.guidance.devices import HeldDevice
    from dvf_ig.intake.live import LiveConfig
    from dvf_ig.live.haptic import HapticTool
    from dvf_ig.live.loop import Answer, LiveLoop
    from dvf_ig.live.record import Record
    from dvf_ig.live.summary import LiveSummary
    from dvf_ig.session import SessionHistory

    from .setup import LiveSetup

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
REMEMBERED = 200
"""Registrations and beats that are kept where there is no record: a session may last for hours."""


@fixture_options.takes_fixture
def serve(
    session: Annotated[
        Path,
        Argument(
            metavar="SESSION",
            help="A session.yaml with a section 'live' (see the guide, live link), or a scenario folder that "
            "`dvf-ig synth stream` sends.",
        ),
    ],
    model: ModelOption = None,
    host: Annotated[
        str | None,
        Option(help="PLUS or Slicer; as a server, the address to listen at.", show_default="127.0.0.1"),
    ] = None,
    port: Annotated[
        int | None,
        Option(min=0, max=65535, help="Its port; as a server, 0 takes a free one.", show_default="18944"),
    ] = None,
    listen: Annotated[
        bool, Option("--listen", help="Be the server that PLUS or Slicer connects to.")
    ] = False,
    allow: Annotated[
        list[str] | None, Option(help="Address of another machine that poses may come from; may be repeated.")
    ] = None,
    out: Annotated[
        Path | None,
        out_folder("Folder for the session's record, which `dvf-ig replay` repeats and `dvf-ig view` shows."),
    ] = None,
    seconds: Annotated[float | None, Option(min=0.1, help="End after so long (default: Ctrl-C).")] = None,
    page: Annotated[
        int | None,
        Option(min=0, max=65535, help="Show the session at http://127.0.0.1:PORT; 0 takes a free one."),
    ] = None,
    log_level: Annotated[LogLevel, Option(help="Least severe messages that are shown and logged.")] = "info",
    log_file: Annotated[
        Path | None, Option(callback=output_file, help="Append the messages with their times to this file.")
    ] = None,
    device: Annotated[
        str | None,
        Option(
            metavar="[force-dimension|openhaptics|simulated[:premium|:omni]]",
            help="Haptic device that is the tool and gives the force (guide, live session); a simulated one "
            "is led by a hand that follows the tool's poses.",
        ),
    ] = None,
    *,
    fixture: dict[str, Any],
    fixtures: fixture_options.FixturesFileOption = None,
    retiming: fixture_options.RetimingOption = None,
    margin: fixture_options.MarginOption = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Take poses, ultrasound and ECG from PLUS or 3D Slicer (OpenIGTLink), and send back pose and force.

    Sends MrFromTracker and ToolForce (TRANSFORM, at most 60 a second), DvfIg (STATUS) and DvfIgState
    (STRING). Other machines are refused unless --allow names them. At the end latency and counts are printed.
    It reports who connects, registrations, and whenever force is given, released or latched, with the reason.
    In a terminal, r and Enter re-arms after a latch, as does a device's button; the network never does.
    """
    with queued_stderr(), command(threads), logged(log_level, log_file), ExitStack() as stack:
        from dvf_ig.guidance.devices import limits_of, open_device
        from dvf_ig.intake import read_session
        from dvf_ig.live.haptic import place_of
        from dvf_ig.live.serve import require_allowed

        require_own_model(session, model)
        files = read_session(session, "live")
        options, of_file = fixture_options.chosen_fixtures(fixture, fixtures)
        if files.fixtures is not None:
            fixture_options.refuse_options(fixture, fixtures)
            options = files.fixtures
        mode = fixture_options.chosen_retiming(retiming, files.retiming or of_file)
        changes: dict[str, Any] = {"host": host, "port": port, "role": "server" if listen else None}
        changes["allow"] = None if not allow else (*files.required_live.allow, *allow)
        live = files.required_live.model_copy(update={key: v for key, v in changes.items() if v is not None})
        require_allowed(live)
        hardware = None if device is None else stack.enter_context(closing(open_device(device)))
        if hardware is not None:
            place_of(hardware, files.device)
            options = replace(options, device=limits_of(hardware, options.device))
        ready = live_setup(files, model, fixture_options.with_margin(options, margin), mode, seed)
        typer.echo(ready.origin, err=True)
        for finding in ready.findings:
            warn(f"{finding.key}: {finding.sentence}")
        _serve(ready, live, page, seconds, out, hardware, as_json=as_json)


def _serve(
    ready: "LiveSetup",
    live: "LiveConfig",
    page: int | None,
    seconds: float | None,
    out: Path | None,
    hardware: "HeldDevice | None",
    *,
    as_json: bool,
) -> None:
    """Run the session, and print and write what it did."""
    from dvf_ig.core import OutputError
    from dvf_ig.live.record import LOG, NO_RECORD
    from dvf_ig.live.summary import LiveSummary
    from dvf_ig.session import SessionHistory, no_force

    from .setup import recorded_session, write_logged_run

    summary, history = LiveSummary(), SessionHistory(REMEMBERED if out is None else None)
    if out is None:
        result = _run_session(ready, live, page, seconds, summary, history, NO_RECORD, hardware)
        failure = missing = None
    else:
        with recorded_session(out, ready) as record:
            result = _run_session(ready, live, page, seconds, summary, history, record, hardware)
        failure, missing = record.failure, record.missing
        result["record"] = {"folder": str(out), "lost": record.lost, "failure": failure}
    last = history.last_registration
    reason = None if last is None else last.reason
    whole = ready.setup.heart.model.seen is None
    silent = no_force(summary.by_status, posed=bool(history.updates), reason=reason, whole=whole)
    emit(result, summary.table(result), as_json=as_json)
    if silent is not None:
        warn(f"no force was given: {silent}")
    if out is not None and failure is None:
        if missing is None:
            write_logged_run(out, ready, history)
        else:
            warn(f"{out / LOG} can be neither replayed nor viewed, because no {missing} came")
    if failure is not None:
        raise OutputError(failure)


def _run_session(
    ready: "LiveSetup",
    live: "LiveConfig",
    page: int | None,
    seconds: float | None,
    summary: "LiveSummary",
    history: "SessionHistory",
    record: "Record",
    hardware: "HeldDevice | None",
) -> dict[str, Any]:
    """Until it ends; what it did, as JSON values."""
    from dvf_ig.live.page import PageFeed, PageServer
    from dvf_ig.live.samples.source import sampled_events
    from dvf_ig.live.sentences import Narrator, counted, narrated
    from dvf_ig.live.serve import LiveOptions, live_session

    feed = None if page is None else PageFeed(ready.setup, live.ecg.rate_hz, history)
    newest: deque[Answer] = deque(maxlen=1)

    def observe(answer: "Answer") -> None:
        summary.add(answer)
        newest.append(answer)
        if feed is not None:
            feed.observe(answer)

    with ExitStack() as stack:
        tell = stack.enter_context(counted(LOG.warning))
        haptic = None if hardware is None else stack.enter_context(_haptic_tool(ready, hardware))
        end_requested = stack.enter_context(_end_requests(haptic))
        samples = stack.enter_context(sampled_events(live, ready.files.folder, tell))
        options = LiveOptions(
            live,
            ready.landmarks,
            samples=samples,
            observe=observe,
            tell=tell,
            history=history,
            record=record,
            haptic=haptic,
        )
        if feed is not None and page is not None:
            options = replace(options, watch=feed.event)
            server = stack.enter_context(PageServer(feed, page))
            LOG.info(f"the session is shown at http://127.0.0.1:{server.port}")
        loop = stack.enter_context(live_session(ready.setup, options))
        _tell_where(live, loop)
        narrator = Narrator(LOG.info)

        def look() -> None:
            names = [peer.name for peer in loop.link.peers]
            narrator.peers(names, loop.link.last_end)
            if newest and haptic is None:  # a device reports its own servo
                narrator.state(newest[-1].state)

        stack.enter_context(narrated(look))
        try:
            _run(loop, seconds, end_requested)
        finally:
            if haptic is not None:
                LOG.info(f"{haptic.device.name} gives no force: {haptic.ended}")
                if feed is not None:
                    feed.end(haptic.ended)
        result = summary.result(loop)
    return result if haptic is None else {**result, "device": haptic.result()}


def _haptic_tool(ready: "LiveSetup", hardware: "HeldDevice") -> "HapticTool":
    """The device as the session's tool, within its limits."""
    from dvf_ig.guidance import Fixtures
    from dvf_ig.live.haptic import HapticTool, place_of

    setup = ready.setup
    if hardware.ends_force_after_s is None:
        LOG.warning(
            f"{hardware.name} does not state that it ends the force by itself if this program is killed"
        )
    fixtures = Fixtures(setup.heart.model, setup.fixtures)
    place = place_of(hardware, ready.files.device)
    return HapticTool(hardware, fixtures, setup.device, place, setup.calibrations.tip, LOG.warning)


def _tell_where(live: "LiveConfig", loop: "LiveLoop") -> None:
    where = f"{live.host}:{loop.link.port or live.port}"
    LOG.info(f"listening at {where}" if live.role == "server" else f"connecting to {where}")


def _run(loop: "LiveLoop", seconds: float | None, end_requested: Callable[[], bool]) -> None:
    """Run until the time is over or the end is requested; raise what ended the session before."""
    from dvf_ig.live.serve import SessionThread

    if sys.stdin.isatty():
        threading.Thread(target=_watch_keys, args=(loop,), daemon=True).start()
    thread = SessionThread(loop)
    thread.start()
    thread.wait(seconds, end_requested)
    if end_requested():
        typer.echo("ending", err=True)
    thread.end()


@contextmanager
def _end_requests(haptic: "HapticTool | None") -> Iterator[Callable[[], bool]]:
    """Note Ctrl-C and the signals that end a program; a session answers them after its last messages.

    A haptic device's force ends at once. Nothing is raised from a handler, so that no step of the end can be
    interrupted. A signal that the program was started to ignore (nohup) stays ignored.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return

    def note(number: int, _: object) -> None:
        received.append(number)
        if haptic is not None:
            haptic.withdraw(f"ended by {signal.Signals(number).name}")

    heeded = [one for one in ENDING if signal.getsignal(one) is not signal.SIG_IGN]
    before = {one: signal.signal(one, note) for one in heeded}
    try:
        yield lambda: bool(received)
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _watch_keys(loop: "LiveLoop") -> None:
    for line in sys.stdin:
        if line.strip().lower() == "r":
            loop.ask_rearm()
