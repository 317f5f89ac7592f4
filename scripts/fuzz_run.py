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
from scripts.fuzz_traits import TRAITS, fuzz_traits

STATE = Path("out/fuzz/state.json")
FOUND = Path("tests/io/found")
SLOW_S = 2.0
"""Time above which a read is a finding; after HANG_S the child is ended."""
HANG_S = 20.0
MEMORY_BYTES = 1 << 29
"""Largest memory above that of the program and its libraries; files here have 10 kB."""
ADDRESS_BYTES = 3 << 29
"""Address space above the program's that the system allows; libraries reserve without use."""
BATCH = 5000
MEMORY_DISK = Path("/dev/shm")
"""Folder in memory for damaged files, if it exists: a disk takes longer to write than a reader to read."""


def outcome(reader: str, path: Path) -> str | None:
    """Read a file and describe what is wrong; None if it is read, or refused in one sentence."""
    from dvf_ig.core.errors import DvfIgError

    in_use = _peak_bytes(reset=True)
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            wrong = unfit(READERS[reader][1](path))
        finding = None if wrong is None else f"accepted with {wrong} out of range"
    except DvfIgError as error:
        finding = "a message of several lines" if "\n" in str(error) else None
    except Exception as error:  # noqa: BLE001  errors that a reader must not raise are the findings
        where = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in where if "dvf_ig" in frame.filename]
        finding = (
            f"{type(error).__name__} in {Path(own[-1].filename).name}:{own[-1].name}" if own else repr(error)
        )
    seconds, more = time.process_time() - began, _peak_bytes(reset=False) - in_use
    if finding is None and more > MEMORY_BYTES:
        return f"memory: {more >> 20} MiB"
    return f"slow: {seconds:.1f} s" if finding is None and seconds > SLOW_S else finding


def _peak_bytes(*, reset: bool) -> int:
    """Return the peak memory of this process since the last reset (proc(5): VmHWM); 0 if unknown."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM")), 0)


def case(reader: str, seed: int, number: int, seeds: Path) -> tuple[str, bytes]:
    """Draw name and content of one damaged file."""
    rng = random.Random(f"{seed} {reader} {number}")
    name = rng.choice(READERS[reader][0])
    data = damaged((seeds / name).read_bytes(), rng)
    return name, resealed(data) if reader == "model" and rng.random() < 0.9 else data


def child(reader: str, seed: int, first: int, count: int, seeds: Path) -> None:
    """Read `count` damaged files; each begins with its number on stdout and ends with what is wrong."""
    for name in READERS[reader][0]:  # loads and compiles everything once
        outcome(reader, seeds / name)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_BYTES, used + ADDRESS_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in range(first, first + count):
        name, data = case(reader, seed, number, seeds)
        whole = (seeds / name).read_bytes()
        (seeds / name).write_bytes(data)
        print(f"begin {number}", flush=True)
        finding = outcome(reader, seeds / name)
        (seeds / name).write_bytes(whole)
        if finding:
            print(f"found {number} {json.dumps(finding)}", flush=True)
    print("end", flush=True)


def run_batch(reader: str, seed: int, first: int, count: int, seeds: Path) -> tuple[int, dict[int, str]]:
    """Run a batch; return the next number and the findings by number."""
    arguments = ["--child", reader, "--seed", str(seed), "--first", str(first), "--count", str(count)]
    command = [sys.executable, "-m", "scripts.fuzz_run", *arguments, "--seeds", str(seeds)]
    findings: dict[int, str] = {}
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
            findings[int(number)] = json.loads(text)
    if lines[-1:] == ["end"]:
        return first + count, findings
    begun = [int(line.split()[1]) for line in lines if line.startswith("begin")]
    if not begun:
        raise SystemExit(f"the child for {reader} did not start; run: {' '.join(command)}")
    findings[begun[-1]] = f"the process ended ({process.returncode})"
    return begun[-1] + 1, findings


def keep(reader: str, seed: int, number: int, finding: str, seeds: Path) -> Path:
    """Keep a finding as a file that a test reads from now on, made smaller if it stays a finding."""
    name, data = case(reader, seed, number, seeds)
    if "process ended" not in finding and "slow" not in finding:
        data = smaller(reader, name, data, finding, seeds)
    digest = hashlib.sha256(data).hexdigest()[:8]
    folder = FOUND / reader / digest
    folder.mkdir(parents=True, exist_ok=True)
    (folder / Path(name).name).write_bytes(data)
    return folder


def smaller(reader: str, name: str, data: bytes, finding: str, seeds: Path) -> bytes:
    """Restore the seed's content, a stretch after another, as long as the finding stays the same."""
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
                if tried != data and outcome(reader, seeds / name) == finding:
                    data = tried
    finally:
        (seeds / name).write_bytes(whole)
    return data


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--reader", action="append", choices=sorted({*READERS, *TRAITS}), metavar="NAME")
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
    parser.add_argument(
        "--traits", type=int, metavar="N", help="N files with a trait of people's files a reader"
    )
    parser.add_argument("--forces", type=int, metavar="N", help="N forces at hostile places, and no files")
    for hidden in ("--child", "--seeds"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    for hidden in ("--first", "--count"):
        parser.add_argument(hidden, type=int, help=argparse.SUPPRESS)
    parser.add_argument(
        "--live", type=int, metavar="N", help="every live fault of `serve` N times, and no files"
    )
    parser.add_argument("--fault", action="append", metavar="NAME", help="of --live; default: all")
    options = parser.parse_args()
    if options.child == "cli":
        fuzz_cli.child(options.seed, options.first, options.count, Path(options.seeds))
        return 0
    if options.child:
        child(options.child, options.seed, options.first, options.count, Path(options.seeds))
        return 0
    if options.live:
        from scripts.fuzz_live import fuzz_live

        return 1 if fuzz_live(options.live, options.fault or []) else 0
    if options.kill:
        from scripts.fuzz_kill import WRITERS, fuzz_kill

        return 1 if fuzz_kill(options.kill, options.seed, options.command or list(WRITERS)) else 0
    if options.cli:
        return 1 if fuzz_cli.fuzz_cli(options.cli, options.seed) else 0
    if options.forces:
        from scripts.fuzz_forces import fuzz_forces

        return 1 if fuzz_forces(options.forces, options.seed) else 0
    with tempfile.TemporaryDirectory(dir=MEMORY_DISK if MEMORY_DISK.is_dir() else None) as scratch:
        seeds = Path(scratch) / "seeds"
        seeds.mkdir()
        if options.traits:
            chosen = [name for name in options.reader or TRAITS if name in TRAITS]
            return 1 if fuzz_traits(chosen, options.seed, options.traits, seeds) else 0
        write_seeds(seeds)
        return _once(options, seeds) if options.once else _for_minutes(options, seeds)


def _once(options: Any, seeds: Path) -> int:
    """Read earlier findings, then N new files of each reader, in this process, for the test suite."""
    for name, (files, read) in READERS.items():
        for file in files:
            if wrong := unfit(read(seeds / file)):  # a file must be valid before it is damaged
                print(f"{name}: the whole {file} is accepted with {wrong} out of range")
                return 1
    earlier = [(path.parts[-3], path.name, path.read_bytes()) for path in sorted(FOUND.glob("*/*/*"))]
    readers = options.reader or sorted(READERS)
    new = ((r, *case(r, options.seed, number, seeds)) for r in readers for number in range(options.once))
    bad = 0
    for reader, name, data in itertools.chain(earlier, new):
        place = next(seeds / file for file in READERS[reader][0] if file.endswith(name))
        whole = place.read_bytes()
        place.write_bytes(data)
        finding = outcome(reader, place)
        place.write_bytes(whole)
        if finding:
            print(f"{reader} {name}: {finding}")
            bad += 1
    return 1 if bad else 0


def _for_minutes(options: Any, seeds: Path) -> int:
    state: dict[str, int] = json.loads(STATE.read_text()) if STATE.is_file() else {}
    until, kinds = time.monotonic() + 60 * options.minutes, dict[str, str]()
    readers = options.reader or sorted(READERS)
    while time.monotonic() < until:
        for reader in readers:
            if time.monotonic() >= until:
                break
            key = f"{reader} {options.seed}"
            state[key], findings = run_batch(reader, options.seed, state.get(key, 0), BATCH, seeds)
            for number, what in findings.items():
                if f"{reader}: {what}" not in kinds:
                    kinds[f"{reader}: {what}"] = str(keep(reader, options.seed, number, what, seeds))
                    print(f"{reader} {number}: {what}; kept in {kinds[f'{reader}: {what}']}", flush=True)
            STATE.parent.mkdir(parents=True, exist_ok=True)
            STATE.write_text(json.dumps(state, indent=1, sort_keys=True))
    counts = {reader: state.get(f"{reader} {options.seed}", 0) for reader in readers}
    print(f"{sum(counts.values())} files read, {min(counts.values())} or more a reader, {len(kinds)} kinds")
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
