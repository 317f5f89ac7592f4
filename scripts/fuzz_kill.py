"""Commands killed, interrupted, or left without a place while they write: their output must be old or new.

A command runs up to the time at which it first makes a temporary file or folder; until then nothing of its
output is touched. There it is forked repeatedly, and each child is ended at a random time until its end; then
the output is examined as the next command would see it, and restored. At last the disk is full, then the
folder is read-only (both need the right to mount), and two processes write at once.
"""

import json
import math
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
import uuid
import zipfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path

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
    "model build": "model build --labels {scene}/preop/labels.nrrd --organ 1,2 -o o/model.npz",
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
}
"""Command lines, each of which writes below the folder "o"."""
MADE_BEFORE = {
    "scene": "synth scenario --preset calm --seconds 17 --seed 101 -o scene",
    "run": "replay scene -o run",
    "model.npz": "model build --labels scene/preop/labels.nrrd --organ 1,2 -o model.npz",
}
"""Inputs, made if a chosen command names them."""
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
        scene = Path("scene")
        for made, words in MADE_BEFORE.items():
            if made == "scene" or any(made in WRITERS[name].split() for name in chosen):
                if not (pid := os.fork()):
                    os._exit(_run(words, Path("log")))
                os.waitpid(pid, 0)
        Path("breath.csv").write_text(
            "t_s,chest_mm\n" + "".join(f"{k / 25},{5 * math.sin(k / 15):.3f}\n" for k in range(2000))
        )
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
    try:
        for folder in ("o", "kept"):
            shutil.rmtree(folder, ignore_errors=True)
        Path("o").mkdir()
        words = WRITERS[name]
        if not (pid := os.fork()):
            os._exit(_run(words.format(n=101, scene=scene), Path("old.log")))
        os.waitpid(pid, 0)
        if not _state():
            raise RuntimeError(Path("old.log").read_text()[-400:])
        fresh = uuid.uuid4

        def at_first_write() -> uuid.UUID:
            uuid.uuid4 = fresh
            if _forked(trials, random.Random(f"{seed} {name}"), answer):
                return fresh()
            os._exit(0)

        uuid.uuid4 = at_first_write
        os._exit(_run(words.format(n=102, scene=scene), Path("new.log")))
    except (OSError, RuntimeError) as error:
        os.write(answer, json.dumps({"failed": 1, "why": str(error)}).encode())
    finally:  # a child that is interrupted also ends here: the rest belongs to the parent
        os._exit(1)


def _forked(trials: int, rng: random.Random, answer: int) -> bool:
    """Return True in a child, which continues; the parent ends each child and reports the findings."""
    shutil.copytree("o", "kept")
    old, began = _state(), time.monotonic()
    if not (pid := os.fork()):
        return True
    usual = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    lasts_s, new = time.monotonic() - began, set(_state())
    counts = {"kills": 0, "old": 0, "new": 0, "refused by readers": 0, "mixed": 0, "damaged": 0}
    for number in range(trials):
        old = _put_back()
        if not (pid := os.fork()):
            os.setpgid(0, 0)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            return True
        with suppress(OSError):
            os.setpgid(pid, pid)
        lasts_s = _end(pid, signal.SIGINT if number % 2 else signal.SIGKILL, rng, lasts_s)
        counts["kills"] += 1
        _judge(old, new, counts)
    counts["without a sentence"] = 0
    for place in PLACES:
        old = _put_back()
        if (mounted := _mounted(place)) is None:
            counts[f"no right to mount: {place}"] = 1
            continue
        before, children = _state(), []
        for _ in range(2 if place == "two processes" else 1):
            if not (pid := os.fork()):
                return True
            children.append(pid)
        codes = [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in children]
        if mounted:
            counts["mixed"] += _state() != before
            subprocess.run(["umount", "o"], check=True)
            counts["without a sentence"] += codes != [CANNOT_WRITE]
        else:
            counts["without a sentence"] += not set(codes) <= {usual, CANNOT_WRITE} or usual not in codes
            _judge(old, new, counts)
        counts[place] = codes[0] if len(codes) == 1 else sum(code == usual for code in codes)
    os.write(answer, json.dumps({**counts, "writing lasts s": round(lasts_s, 2)}).encode())
    return False


def _mounted(place: str) -> bool | None:
    """Return whether a full or read-only disk takes the folder's place; None without the right to mount."""
    if place == "two processes":
        return False
    options = "size=16k" if place == "full disk" else "size=16k,ro"
    if subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", "o"], check=False).returncode:
        return None
    if place == "full disk":
        with suppress(OSError), Path("o/other").open("wb", buffering=0) as stream:
            while stream.write(bytes(4096)):
                pass
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


def _judge(old: State, new: set[str], counts: dict[str, int]) -> None:
    """Count the output as old, new, mixed, or refused by every reader."""
    if _swapping():
        counts["refused by readers"] += 1
        return
    now = _state()
    if now == old:
        counts["old"] += 1
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
    }
    try:
        data = path.read_bytes()
        return checks[path.suffix](data) if path.suffix in checks else len(data) > 0
    except (ValueError, zipfile.BadZipFile):
        return False
