"""Commands killed, interrupted, or left without a place while they write: their output must be old or new.

A command runs up to its first change below the folder of its output. There it is forked repeatedly, and each
child is ended at a random time until its end; then the output is examined as the next command would see it,
and restored. At last the disk is full, then the folder is read-only (both need the right to mount), and two
processes write at once, several times.
"""

import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import uuid
import zipfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core.errors import DvfIgError
from dvf_ig.intake.session_log.read import read_session_log
from dvf_ig.io.writing.listing import LISTING, read_listing
from dvf_ig.io.writing.place import TEMPORARY

WRITERS = {
    "synth scenario": "synth scenario --preset calm --seconds 8 --seed {n} -o o/scene",
    "synth calibration": "synth calibration nwire --seed {n} -o o/cal",
    "gate": "gate csv:{scene}/ecg.csv -o o/gate.json",
    "calibrate pivot": "calibrate pivot {scene}/calibration/pivot.igs.mha -o o/tip.json",
    "calibrate latency": "calibrate latency {scene}/calibration/latency_tracker.igs.mha "
    "{scene}/calibration/latency_video.igs.mha --line-table {scene}/calibration/latency_lines.xml "
    "-o o/lag.json",
    "calibrate probe": "calibrate probe {scene}/calibration/nwire.igs.mha --device-set "
    "{scene}/calibration/nwire.xml --points {scene}/calibration/nwire_points.xml -o o/probe.json",
    "config init": "config init --cine {scene}/preop/mr.nrrd --labels {scene}/preop/labels.nrrd --us "
    "{scene}/ultrasound.igs.mha --ecg csv:{scene}/ecg.csv -o o/SESSION.yaml",
    "model build": "model build --labels {scene}/preop/labels.nrrd --organ 1,2 -o o/heart.npz",
    "register": "register {scene} -o o/registered",
    "replay": "replay {scene} -o o/run",
    "study": "study calibration --kind watertank --seeds 1 --workers 1 -o o/study",
    "calibrate device": "calibrate device {scene}/landmarks_tracker.mrk.json --touched "
    "{scene}/landmarks_mr.mrk.json --max-residual-mm 50 -o o/device.json",
    "gate --respiration": "gate --respiration csv:breath.csv -o o/gate.json",
    "config schema": "config schema -o o/session.schema.json",
    "model export": "model export model.npz --format stl -o o/surfaces",
    "view": "view run -o o/run.html",
    "view model": "view model.npz -o o/model.html",
    "export slicer": "export slicer run --recording {scene} -o o/slicer",
    "export mcap": "export mcap run -o o/run.mcap",
    "export rerun": "export rerun run -o o/run.rrd",
    "model build --sax --lax": "model build --sax exam/preop/mr.nrrd --labels exam/preop/labels.nrrd "
    "--lax exam/preop/view_0.nrrd --lax exam/preop/view_1.nrrd -o o/model.npz",
    "model build --dicom": "model build --dicom dicom/all --labels dicom/labels.nrrd --organ 1,2 "
    "-o o/model.npz",
    "study hearts --fit": "study hearts --fit trials -o o/study",
    "cache --clear": "cache --clear",
    "serve": "serve {scene} --port 18977 --seconds 3 -o o/live",
}
"""Command lines, each of which writes below the folder "o"."""
MADE_BEFORE = {
    "scene": "synth scenario --preset calm --seconds 17 --seed 101 -o scene",
    "exam": "synth scenario --preset calm --exam sax+lax --seconds 17 --seed 101 -o exam",
    "run": "replay scene -o run",
    "model.npz": "model build --labels scene/preop/labels.nrrd --organ 1,2 -o model.npz",
}
"""Inputs, made if a chosen command names them."""
EACH_ALONE = "cache --clear"
"""Command that removes files which do not depend on each other: any of them may be left."""
LIVE = "serve"
PEER = "synth stream scene --port 18977"
"""Source of the live session, started for each child. Its record is never replaced: there is no old one."""
LIVE_STEPS = ({"o/live/session-unfinished.mcap"}, {"o/live/session.mcap"})
"""Files of a live session that was killed: its record up to then, or all of it without the replay's files."""
PLACES = ("full disk", "read-only folder", "two processes")
CANNOT_WRITE = 4
"""Exit code of a command that cannot write."""
CONTINUED = ("study.json", "trials.jsonl")
"""Files of a study that the next run of it continues, line by line."""
State = dict[str, tuple[int, int, int]]


def fuzz_kill(trials: int, seed: int, chosen: list[str]) -> int:
    """Count findings over all writing commands and print a line for each of them."""
    bad = 0
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)
        os.environ["DVF_IG_CACHE"] = str(Path("cache").resolve())
        scene, words = Path("scene"), " ".join(WRITERS[name] for name in chosen)
        for setup, command in MADE_BEFORE.items():
            if setup == "scene" or re.search(rf"(^| ){setup}\b", words):
                _in_child(partial(_run, command, Path("log")))
                if not Path(setup).exists():
                    raise SystemExit(f"{command}: {Path('log').read_text()}")
        _write_inputs(words)
        for name in chosen:
            read_end, write_end = os.pipe()
            if not (pid := os.fork()):
                os.close(read_end)
                _trials(name, scene.resolve(), trials, seed, write_end)
            os.close(write_end)
            answer = os.fdopen(read_end).read()
            os.waitpid(pid, 0)
            counts = json.loads(answer) if answer else {"failed": 1}
            print(f"{name}: {counts}", flush=True)
            bad += sum(counts.get(key, 0) for key in ("mixed", "damaged", "failed", "without a sentence"))
    return bad


def _in_child(work: Callable[[], int]) -> None:
    """Do it in a process of its own and wait for its end."""
    if not (pid := os.fork()):
        os._exit(work())
    os.waitpid(pid, 0)


def _write_inputs(words: str) -> None:
    """Write the inputs that no command makes."""
    Path("breath.csv").write_text(
        "t_s,chest_mm\n" + "".join(f"{k / 25},{5 * math.sin(k / 15):.3f}\n" for k in range(2000))
    )
    if "dicom" in words:
        from dicom_toy import write_examination

        write_examination(Path("dicom"))
    if "trials" in words:
        Path("trials").mkdir()
        Path("trials/trials.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in _hearts()))


def _hearts() -> Iterator[dict[str, Any]]:
    """Trials of 24 hearts whose features predict their errors."""
    from dvf_ig.registration.evidence.assessment import FEATURES

    rng = np.random.default_rng(5)
    for heart in range(24):
        error = float(rng.uniform(0.5, 3.0))
        features = {name: error * float(rng.uniform(0.8, 1.2)) for name in FEATURES}
        kind = {"world": "first", "images": "sweep", "quality": "calm", "disturbed": False}
        judged = {"stop": "CONVERGED", "tre_mm": 0.6 * error, "tre_max_mm": error}
        scale = {"chi2": 6.0, "covariance_scale": 1.0, "statistics": {"share": error}}
        yield {"seed": heart, "heart": heart, **kind, **judged, **scale, "features": features}


def _run(words: str, log: Path) -> int:
    """Run a command in this process and return its exit code."""
    from dvf_ig.cli.main import app

    with log.open("w") as stream, redirect_stdout(stream), redirect_stderr(stream):
        try:
            app(words.split(" "))
        except SystemExit as ended:
            return int(ended.code or 0)
    return 0


def _trials(name: str, scene: Path, trials: int, seed: int, answer: int) -> None:
    """Write the old output, run the command until it writes, and then the trials; never returns."""
    parent = os.getpid()
    try:
        for folder in ("o", "kept", "first"):
            shutil.rmtree(folder, ignore_errors=True)
        Path("o").mkdir()
        words = WRITERS[name]
        if name == EACH_ALONE:
            os.environ["DVF_IG_CACHE"] = str(Path("o").resolve())
            Path("o/models").mkdir()
            for k in range(200):
                Path(f"o/models/{k:064x}.dvf-model").write_bytes(bytes(1000))
        elif name != LIVE:
            _in_child(partial(_run, words.format(n=101, scene=scene), Path("old.log")))
            if not _state():
                raise RuntimeError(Path("old.log").read_text()[-400:])
        at_first_write = _Hook(lambda: _forked(name, trials, random.Random(f"{seed} {name}"), answer))
        sys.addaudithook(at_first_write)
        uuid.uuid4 = at_first_write.before_name(uuid.uuid4)
        code = _run(words.format(n=102, scene=scene), Path("new.log"))
        if at_first_write.waiting:
            raise RuntimeError(f"{code}: {Path('new.log').read_text()[-400:]}")
        os._exit(code)
    except (OSError, RuntimeError) as error:
        if os.getpid() == parent:
            os.write(answer, json.dumps({"failed": 1, "why": str(error)}).encode())
        else:
            Path("child.log").write_text(traceback.format_exc())
    finally:  # a child that is interrupted also ends here: the rest belongs to the parent
        os._exit(1)


class _Hook:
    """Audit hook (PEP 578) that calls `forked` before the first change below "o", and ends the caller."""

    def __init__(self, forked: Callable[[], bool]) -> None:
        self.waiting, self._forked, self._folder = True, forked, Path("o").resolve()

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.waiting and self._changes(event, arguments):
            self._fork()

    def before_name(self, draw: Callable[[], uuid.UUID]) -> Callable[[], uuid.UUID]:
        """Fork before a temporary folder is named, so that two processes name two."""

        def forked_draw() -> uuid.UUID:
            if self.waiting:
                self._fork()
            return draw()

        return forked_draw

    def _fork(self) -> None:
        self.waiting = False
        if not self._forked():
            os._exit(0)

    def _changes(self, event: str, arguments: tuple[Any, ...]) -> bool:
        if event not in ("open", "os.mkdir", "os.remove", "os.rename", "os.truncate"):
            return False
        if not isinstance(arguments[0], str | bytes | os.PathLike):
            return False
        path = Path(os.path.abspath(os.fsdecode(arguments[0])))
        if not path.is_relative_to(self._folder):
            return False
        if event == "open":
            return bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        return event != "os.mkdir" or not path.exists()


def _forked(name: str, trials: int, rng: random.Random, answer: int) -> bool:
    """Return True in a child, which continues; the parent ends each child and reports the findings."""
    shutil.copytree("o", "kept")
    os.rename(
        "o", "first"
    )  # it stays: the command knows files that it read by their numbers, which are used again
    shutil.copytree("kept", "o")
    old, began = _state(), time.monotonic()
    peer = _start_peer(name)
    if not (pid := _fork(name)):
        return True
    usual = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    _end_peer(peer)
    lasts_s, new = time.monotonic() - began, set(_state())
    kinds = ("kills", "old", "new", "refused by readers", "mixed", "damaged", "without a sentence")
    counts: dict[str, Any] = {**dict.fromkeys(kinds, 0), "files": len(new), "exit": usual}
    for number in range(trials):
        old = _put_back()
        peer = _start_peer(name)
        if not (pid := _fork(name, alone=True)):
            return True
        with suppress(OSError):
            os.setpgid(pid, pid)
        lasts_s = _end(pid, signal.SIGINT if number % 2 else signal.SIGKILL, rng, lasts_s)
        _end_peer(peer)
        counts["kills"] += 1
        _judge(name, old, new, counts)
    for place in PLACES + (PLACES[-1:] * (trials // 4)):
        old = _put_back()
        if (mounted := _mounted(place)) is None:
            counts[f"no right to mount: {place}"] = 1
            continue
        before, children, peer = _state(), [], _start_peer(name)
        for _ in range(2 if place == "two processes" else 1):
            if not (pid := _fork(name)):
                return True
            children.append(pid)
        codes = [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in children]
        _end_peer(peer)
        if mounted:
            removes = name == EACH_ALONE and place == "full disk"
            counts["mixed"] += not removes and _state() != before
            subprocess.run(["umount", "o"], check=True)
            counts["without a sentence"] += codes != [usual if removes else CANNOT_WRITE]
        else:
            counts["without a sentence"] += not set(codes) <= {usual, CANNOT_WRITE} or usual not in codes
            _judge(name, old, new, counts)
        if counts["without a sentence"]:
            logs = [Path(name) for name in ("child.log", "new.log") if Path(name).exists()]
            counts.setdefault("said", [log.read_text()[-300:] for log in logs])
        for code in codes:
            key = f"{place}: {code}"
            counts[key] = counts.get(key, 0) + 1
    os.write(answer, json.dumps({**counts, "writing lasts s": round(lasts_s, 2)}).encode())
    return False


def _fork(name: str, *, alone: bool = False) -> int:
    """Fork a child that goes on with the command; a live session, whose threads a fork loses, starts again.

    Args:
        alone: in a process group of its own, which Ctrl-C ends.
    """
    if pid := os.fork():
        return pid
    if alone:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if name == LIVE:
        log = os.open("new.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(log, stream)
        words = WRITERS[name].format(scene=Path("scene").resolve()).split(" ")
        os.execv(sys.executable, [sys.executable, "-m", "dvf_ig", *words])
    return 0


def _start_peer(name: str) -> "subprocess.Popen[bytes] | None":
    """Start the source of a live session, and wait until it listens; None for other commands."""
    if name != LIVE:
        return None
    command = [sys.executable, "-m", "dvf_ig", *PEER.split()]
    peer = subprocess.Popen(command, stderr=subprocess.PIPE)
    if peer.stderr is not None:
        peer.stderr.readline()
    return peer


def _end_peer(peer: "subprocess.Popen[bytes] | None") -> None:
    if peer is not None:
        peer.kill()
        peer.communicate()


def _mounted(place: str) -> bool | None:
    """Return whether a full or read-only disk takes the folder's place; None without the right to mount."""
    if place == "two processes":
        return False
    size = sum(path.stat().st_size + 8192 for path in Path("kept").rglob("*")) + 65536
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", "o"], check=False).returncode:
        return None
    shutil.copytree("kept", "o", dirs_exist_ok=True)
    if place == "full disk":
        with suppress(OSError), Path("o/other").open("wb", buffering=0) as stream:
            while stream.write(bytes(4096)):
                pass
    else:
        subprocess.run(["mount", "-o", "remount,ro", "o"], check=True)
    return True


def _end(pid: int, kind: signal.Signals, rng: random.Random, lasts_s: float) -> float:
    """End a child at any time or, every other time, soon after its files begin to be moved into place.

    Returns:
        duration of a child, reduced if this one ended by itself before.
    """
    began, anyhow = time.monotonic(), rng.random() < 0.5
    until = began + (rng.uniform(0.0, 1.05 * lasts_s) if anyhow else 2.0 * lasts_s + 1.0)
    while time.monotonic() < until and (anyhow or not _swapping()):
        if os.waitpid(pid, os.WNOHANG) != (0, 0):
            return min(lasts_s, time.monotonic() - began)
        time.sleep(2e-4 if anyhow else 0.0)
    if not anyhow:
        time.sleep(rng.uniform(0.0, 2e-4))
    os.kill(pid, kind)
    for _ in range(100):  # Python loses a Ctrl-C that comes while an object is being deleted
        for _ in range(100):
            if os.waitpid(pid, os.WNOHANG) != (0, 0):
                return lasts_s
            time.sleep(1e-3)
        os.kill(pid, kind)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return lasts_s


def _swapping() -> bool:
    return any(read_listing(Path(folder)).unfinished for folder, _, _ in os.walk("o"))


def _judge(name: str, old: State, new: set[str], counts: dict[str, int]) -> None:
    """Count the output as old, new, mixed, or refused by every reader."""
    if _swapping():
        counts["refused by readers"] += 1
        return
    now = _state()
    if now == old:
        counts["old"] += 1
    elif (name == EACH_ALONE and now.items() <= old.items()) or (name == LIVE and set(now) in LIVE_STEPS):
        is_whole = name != LIVE or all(_whole(Path(file)) for file in now)
        begun = (
            name == LIVE and set(now) == LIVE_STEPS[0]
        )  # a session that was killed before it began has no heart
        kind = "in part" if is_whole else "refused by readers" if begun else "damaged"
        counts[kind] = counts.get(kind, 0) + 1
    elif set(now) == new and not set(now.values()) & set(old.values()):
        counts["new"] += 1
        counts["damaged"] += not all(_whole(Path(name)) for name in now)
    else:
        counts["mixed"] += 1


def _state() -> State:
    """Identify every file of the output except temporary ones."""
    files: State = {}
    for path in sorted(Path("o").rglob("*")):
        if (
            path.is_file()
            and path.name not in (LISTING, *CONTINUED)
            and not any(map(TEMPORARY.fullmatch, path.parts))
        ):
            at = path.stat()
            files[str(path)] = (at.st_ino, at.st_mtime_ns, at.st_size)
    return files


def _put_back() -> State:
    shutil.rmtree("o")
    shutil.copytree("kept", "o")
    return _state()


def _whole(path: Path) -> bool:
    """Return whether a file is complete for its kind."""
    checks: dict[str, Callable[[bytes], bool]] = {
        ".json": lambda data: isinstance(json.loads(data), dict | list),
        ".png": lambda data: data.rstrip(b"\0").endswith(b"IEND\xaeB`\x82"),
        ".html": lambda data: data.rstrip().endswith(b"</html>"),
        ".npz": lambda _: zipfile.ZipFile(path).testzip() is None,
        ".mcap": lambda _: "live" not in path.parts or read_session_log(path) is not None,
    }
    try:
        data = path.read_bytes()
        return checks[path.suffix](data) if path.suffix in checks else len(data) > 0
    except (ValueError, zipfile.BadZipFile, DvfIgError):
        return False
