"""Damage files and read them (`scripts/fuzz`). A child reads; its parent ends it when it takes too long."""

import argparse
import hashlib
import itertools
import json
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from scripts import fuzz_cli
from scripts.fuzz_mutations import damaged, resealed
from scripts.fuzz_readers import READERS, unfit, write_seeds

STATE = Path("out/fuzz/state.json")
FOUND = Path("tests/io/found")
SLOW_S = 2.0
"""A read that takes longer is a finding; after HANG_S the child is ended."""
HANG_S = 20.0
MEMORY_BYTES = 1 << 29
"""Memory in use above what the program and its libraries take themselves; files here have 10 kB."""
ADDRESS_BYTES = 3 << 29
"""Addresses above those of the program, beyond which the system refuses; libraries reserve without use."""
BATCH = 5000
MEMORY_DISK = Path("/dev/shm")
"""Where it is there, files are damaged in memory: a disk takes longer to write than a reader to read."""


def outcome(reader: str, path: Path) -> str | None:
    """What is wrong with how a file is read; None where it is read, or refused in a sentence."""
    from dvf_ig.core.errors import DvfIgError

    in_use = _peak_bytes(reset=True)
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            wrong = unfit(READERS[reader][1](path))
        found = None if wrong is None else f"accepted with {wrong} out of range"
    except DvfIgError as error:
        found = "a message of several lines" if "\n" in str(error) else None
    except Exception as error:  # noqa: BLE001  what a reader must not raise is what is looked for
        where = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in where if "dvf_ig" in frame.filename]
        found = (
            f"{type(error).__name__} in {Path(own[-1].filename).name}:{own[-1].name}" if own else repr(error)
        )
    taken, more = time.process_time() - began, _peak_bytes(reset=False) - in_use
    if found is None and more > MEMORY_BYTES:
        return f"memory: {more >> 20} MiB"
    return f"slow: {taken:.1f} s" if found is None and taken > SLOW_S else found


def _peak_bytes(*, reset: bool) -> int:
    """The most memory this process has had in use since the last reset (proc(5): VmHWM); 0 where unknown."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM")), 0)


def case(reader: str, seed: int, number: int, seeds: Path) -> tuple[str, bytes]:
    """Name and content of one damaged file."""
    rng = random.Random(f"{seed} {reader} {number}")
    name = rng.choice(READERS[reader][0])
    data = damaged((seeds / name).read_bytes(), rng)
    return name, resealed(data) if reader == "model" and rng.random() < 0.9 else data


def child(reader: str, seed: int, first: int, count: int, seeds: Path) -> None:
    """Read `count` damaged files; each begins with its number on stdout and ends with what is wrong."""
    for name in READERS[reader][0]:  # loads and compiles what reading needs, once
        outcome(reader, seeds / name)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_BYTES, used + ADDRESS_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in range(first, first + count):
        name, data = case(reader, seed, number, seeds)
        whole = (seeds / name).read_bytes()
        (seeds / name).write_bytes(data)
        print(f"begin {number}", flush=True)
        found = outcome(reader, seeds / name)
        (seeds / name).write_bytes(whole)
        if found:
            print(f"found {number} {json.dumps(found)}", flush=True)
    print("end", flush=True)


def run_batch(reader: str, seed: int, first: int, count: int, seeds: Path) -> tuple[int, dict[int, str]]:
    """Where to go on, and what was found by number."""
    arguments = ["--child", reader, "--seed", str(seed), "--first", str(first), "--count", str(count)]
    command = [sys.executable, "-m", "scripts.fuzz_run", *arguments, "--seeds", str(seeds)]
    found: dict[int, str] = {}
    with tempfile.TemporaryDirectory(dir=MEMORY_DISK if MEMORY_DISK.is_dir() else None) as scratch:
        copy = Path(scratch) / "seeds"
        shutil.copytree(seeds, copy)
        command[-1] = str(copy)
        log = Path(scratch) / "log"
        with log.open("w") as stream:
            process = subprocess.Popen(command, stdout=stream, stderr=subprocess.DEVNULL)
            size, since = 0, time.monotonic()
            while process.poll() is None:
                time.sleep(0.05)
                if log.stat().st_size != size:
                    size, since = log.stat().st_size, time.monotonic()
                if time.monotonic() - since > HANG_S + 60 * (size == 0):
                    process.kill()
        lines = log.read_text().splitlines()
    for line in lines:
        if line.startswith("found"):
            _, number, text = line.split(" ", 2)
            found[int(number)] = json.loads(text)
    if lines[-1:] == ["end"]:
        return first + count, found
    begun = [int(line.split()[1]) for line in lines if line.startswith("begin")]
    if not begun:
        raise SystemExit(f"the child for {reader} did not start; run: {' '.join(command)}")
    found[begun[-1]] = f"the process ended ({process.returncode})"
    return begun[-1] + 1, found


def keep(reader: str, seed: int, number: int, found: str, seeds: Path) -> Path:
    """A finding as a file that a test reads from now on; made smaller where it stays one."""
    name, data = case(reader, seed, number, seeds)
    if "process ended" not in found and "slow" not in found:
        data = smaller(reader, name, data, found, seeds)
    digest = hashlib.sha256(data).hexdigest()[:8]
    folder = FOUND / reader / digest
    folder.mkdir(parents=True, exist_ok=True)
    (folder / Path(name).name).write_bytes(data)
    return folder


def smaller(reader: str, name: str, data: bytes, found: str, seeds: Path) -> bytes:
    """Put back what the seed has, a stretch after another, as long as the finding stays the same."""
    whole = (seeds / name).read_bytes()
    if len(whole) != len(data):
        return data
    try:
        step = len(data)
        while step >= 8:
            step //= 4
            for begin in range(0, len(data), max(step, 1)):
                tried = data[:begin] + whole[begin : begin + step] + data[begin + step :]
                (seeds / name).write_bytes(tried)
                if tried != data and outcome(reader, seeds / name) == found:
                    data = tried
    finally:
        (seeds / name).write_bytes(whole)
    return data


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--reader", action="append", choices=sorted(READERS), metavar="NAME")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--once",
        type=int,
        metavar="N",
        help="N files of each reader and those found before, and no more; keeps nothing",
    )
    parser.add_argument("--cli", type=int, metavar="N", help="N damaged command lines, and no files")
    parser.add_argument("--kill", type=int, metavar="N", help="N kills of each writing command, and no files")
    parser.add_argument("--command", action="append", metavar="NAME", help="of --kill; default: all")
    parser.add_argument("--forces", type=int, metavar="N", help="N forces at hostile places, and no files")
    for hidden in ("--child", "--seeds"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    for hidden in ("--first", "--count"):
        parser.add_argument(hidden, type=int, help=argparse.SUPPRESS)
    parser.add_argument(
        "--live", type=int, metavar="N", help="every live fault of `serve` N times, and no files"
    )
    parser.add_argument("--fault", action="append", metavar="NAME", help="of --live; default: all")
    given = parser.parse_args()
    if given.child == "cli":
        fuzz_cli.child(given.seed, given.first, given.count, Path(given.seeds))
        return 0
    if given.child:
        child(given.child, given.seed, given.first, given.count, Path(given.seeds))
        return 0
    if given.live:
        from scripts.fuzz_live import fuzz_live

        return 1 if fuzz_live(given.live, given.fault or []) else 0
    if given.kill:
        from scripts.fuzz_kill import WRITERS, fuzz_kill

        return 1 if fuzz_kill(given.kill, given.seed, given.command or list(WRITERS)) else 0
    if given.cli:
        return 1 if fuzz_cli.fuzz_cli(given.cli, given.seed) else 0
    if given.forces:
        from scripts.fuzz_forces import fuzz_forces

        return 1 if fuzz_forces(given.forces, given.seed) else 0
    with tempfile.TemporaryDirectory(dir=MEMORY_DISK if MEMORY_DISK.is_dir() else None) as scratch:
        seeds = Path(scratch) / "seeds"
        seeds.mkdir()
        write_seeds(seeds)
        return _once(given, seeds) if given.once else _for_minutes(given, seeds)


def _once(given: Any, seeds: Path) -> int:
    """In this process, for the test suite: what was found before, then N new files of each reader."""
    for name, (files, read) in READERS.items():
        for file in files:
            if wrong := unfit(read(seeds / file)):  # what is damaged must have been whole
                print(f"{name}: the whole {file} is accepted with {wrong} out of range")
                return 1
    kept = [(path.parts[-3], path.name, path.read_bytes()) for path in sorted(FOUND.glob("*/*/*"))]
    readers = given.reader or sorted(READERS)
    new = ((r, *case(r, given.seed, number, seeds)) for r in readers for number in range(given.once))
    bad = 0
    for reader, name, data in itertools.chain(kept, new):
        place = next(seeds / known for known in READERS[reader][0] if known.endswith(name))
        whole = place.read_bytes()
        place.write_bytes(data)
        found = outcome(reader, place)
        place.write_bytes(whole)
        if found:
            print(f"{reader} {name}: {found}")
            bad += 1
    return 1 if bad else 0


def _for_minutes(given: Any, seeds: Path) -> int:
    state: dict[str, int] = json.loads(STATE.read_text()) if STATE.is_file() else {}
    until, kinds = time.monotonic() + 60 * given.minutes, dict[str, str]()
    readers = given.reader or sorted(READERS)
    while time.monotonic() < until:
        for reader in readers:
            if time.monotonic() >= until:
                break
            key = f"{reader} {given.seed}"
            state[key], found = run_batch(reader, given.seed, state.get(key, 0), BATCH, seeds)
            for number, what in found.items():
                if f"{reader}: {what}" not in kinds:
                    kinds[f"{reader}: {what}"] = str(keep(reader, given.seed, number, what, seeds))
                    print(f"{reader} {number}: {what}; kept in {kinds[f'{reader}: {what}']}", flush=True)
            STATE.parent.mkdir(parents=True, exist_ok=True)
            STATE.write_text(json.dumps(state, indent=1, sort_keys=True))
    counts = {reader: state.get(f"{reader} {given.seed}", 0) for reader in readers}
    print(f"{sum(counts.values())} files read, {min(counts.values())} or more a reader, {len(kinds)} kinds")
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
