"""Command lines with damaged words: each must end with a documented code and one sentence, without leftovers.

A child process runs one line after another; its parent ends it if it hangs. A valid line that takes long is
interrupted as by Ctrl-C, which must not leave anything half-written either.
"""

import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from scripts.fuzz_mutations import NUMBERS
from scripts.fuzz_readers import write_seeds

BASES = """
doctor|inspect s/volume.nrrd|inspect s/scenario/ultrasound.igs.mha|inspect s/model.npz|inspect s/scenario
force s/model.npz --points s/points.csv --phase 0.3|force s/model.npz --points s/points.csv --law guidance
gate csv:s/ecg.csv -o gate.json|gate wfdb:s/r --phase-at 50|gate edf:s/ecg.edf
gate plus:s/scenario/ultrasound.igs.mha
calibrate pivot s/poses.txt -o tip.json|calibrate landmarks s/scenario/tool.igs.mha --device-set s/probe.xml
calibrate probe s/scenario/calibration/nwire.igs.mha --device-set s/scenario/calibration/nwire.xml -o p.json
calibrate latency s/scenario/calibration/latency_tracker.igs.mha s/scenario/calibration/latency_video.igs.mha
calibrate hand-eye s/poses.txt s/poses.txt -o h.json
model build --labels s/series.nrrd -o m.npz|model build --surfaces s -o m.npz|model check s/model.npz
model build --image s/series.nrrd --seeds s/seeds.json -o m.npz|model export s/model.npz -o surface.vtp
model check s/model.npz --labels s/volume.nrrd@0.3
evaluate --transform s/start.tfm --landmarks s/points.mrk.json
evaluate --transform s/start.tfm --landmarks s/points.tag
register s/scenario -o out|register --fixed s/volume.mha --moving s/volume.nii -o out --init s/start.tfm
config init --model s/model.npz --us s/scenario/ultrasound.igs.mha --ecg csv:s/ecg.csv -o out.yaml
config init --model s/model.npz --us-volume s/volume.nii@0.3 --us-volume s/volume.mha@0.5 -o out.yaml
replay s/scenario -o run|replay s/session.yaml -o run|register s/session.yaml -o out
config init s/scenario -o s.yaml|config dump s/session.yaml|config validate s/session.yaml
synth scenario --preset calm --seconds 8 --seed 1 -o scene|synth us s/volume.nrrd -o us.mha
synth calibration nwire -o cal|bench
""".replace("\n", "|")
HOSTILE = r"""
||.|..|-|--|s|s/none|s/none/below|s/model.npz|s/volume.nrrd|s/ecg.csv|s/session.yaml|s/zero|s/fifo|a/../b
csv:|wfdb:|edf:|plus:|csv:s/zero|plus:s/ecg.csv|edf:s/ecg.csv|wfdb:s/none|nope:s/ecg.csv|csv:csv:s/ecg.csv
plus:s/scenario/ultrasound.igs.mha#None|s/volume.nii@|s/volume.nii@nan|s/volume.nii@-1|s/volume.nii@1e400
@0.3|@|s/volume.nii@0.3@0.4|s/volume.nii=0.5|1,2,nan|1,2|1 2 3|[1,2]|{}|٣|⅓|1_000|0x10|1e400|true
%s%n|'|"|*|~|$HOME|None|x=y|=|,|:|;
""".replace("\n", "|")
CONTROL = ("a\0b", "a\nb", "a\rb", "\x1b[31m", "\u202e", "\ud83c", "\udcff", "a\udcfe.json")
"""Control characters, including invalid UTF-8."""
SECONDS = 4.0
HANG_S = 60.0
MEMORY_BYTES = 6 << 30
CODES = range(9)
LEFT = re.compile(r"\.[0-9a-f]{8}(\.|$)")


class TookLong(KeyboardInterrupt):
    """Interruption of a line that exceeds its time."""


def commands() -> dict[str, list[str]]:
    """List every command with its options, as the program declares them."""
    import click
    import typer

    from dvf_ig.cli.main import app

    options: dict[str, list[str]] = {}

    def walk(name: str, one: Any) -> None:
        if isinstance(one, click.Group):
            for part, below in one.commands.items():
                walk(f"{name} {part}".strip(), below)
        else:
            options[name] = sorted(
                text for p in one.params if isinstance(p, click.Option) for text in p.opts if p.name != "help"
            )

    walk("", typer.main.get_command(app))
    return options


def line(number: int, seed: int, commands_and_options: dict[str, list[str]]) -> list[str]:
    """Draw the words of one command line: a valid one with one to three changes."""
    rng = random.Random(f"{seed} line {number}")
    bases = [text for text in BASES.split("|") if text] + [
        f"{n} --seeds 1" for n in commands_and_options if n.startswith("study")
    ]
    words = rng.choice(bases).split(" ")
    name = next(
        n for n in sorted(commands_and_options, key=len, reverse=True) if words[: len(n.split())] == n.split()
    )
    first, options = len(name.split()), [*commands_and_options[name], "--no-such"]
    values = (*HOSTILE.split("|"), *CONTROL, *" ".join(NUMBERS).split(" "), "x" * 300, "x" * 5000)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        at, way = rng.randrange(first, len(words) + 1), rng.randrange(6)
        value = rng.choice(values)
        if way <= 1 and at < len(words):
            words[at] = value
        elif way == 2 and at < len(words):
            del words[at]
        elif way == 3:
            words[at:at] = [rng.choice(options), value]
        elif way == 4:
            words[at:at] = [rng.choice(options)] if rng.random() < 0.5 else [value]
        elif at < len(words):
            words += words[at:]
    return words


def outcome(words: list[str]) -> str | None:
    """Run a command line and describe what is wrong with its end; None if nothing is."""
    from typer.testing import CliRunner

    from dvf_ig.cli.main import app

    fired: list[int] = []

    def too_long(*_: object) -> None:
        fired.append(1)
        raise TookLong

    signal.signal(signal.SIGALRM, too_long)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        result = CliRunner().invoke(app, words)
    except TookLong:
        result = None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    left = [str(p) for p in Path().rglob("*") if LEFT.match(p.name)]
    if left:
        return f"left {left[0]} behind"
    if result is None or fired:  # compilers put an interruption into an error of their own
        return None
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        where = [f for f in traceback.extract_tb(result.exception.__traceback__) if "dvf_ig" in f.filename]
        place = f" in {Path(where[-1].filename).name}:{where[-1].name}" if where else ""
        return f"{type(result.exception).__name__}{place}: {str(result.exception)[:80]!r}"
    if result.exit_code not in CODES:
        return f"exit code {result.exit_code}"
    return _wrong_words(words, result)


def _wrong_words(words: list[str], result: Any) -> str | None:
    """Describe what is wrong with the output, and with files written despite a failure."""
    if "Traceback" in result.output:
        return "a traceback is printed"
    if result.exit_code in (3, 4, 5, 6, 7) and "config" not in words:  # which lists all that is wrong
        lines = [text for text in result.stderr.split("\n") if text.strip()]
        errors = [text for text in lines if text.startswith("error: ")]
        others = [text for text in lines if not text.startswith(("error: ", "note: ", "wrote "))]
        if len(errors) != 1 or others:
            return f"exit code {result.exit_code} with {len(errors)} sentences and {len(others)} other lines"
    new = sorted(path.name for path in Path().iterdir() if path.name != "s")
    if result.exit_code in (2, 3, 4, 5) and new:
        return f"exit code {result.exit_code}, and yet {new[0][:20]!r} was written"
    return None


def child(seed: int, first: int, count: int, seeds: Path) -> None:
    """Run each line in its own folder."""
    import dvf_ig.cli.main

    assert dvf_ig.cli.main.app
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 28, 1 << 28))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    declared = commands()
    for number in range(first, first + count):
        place = seeds.parent / "work"
        place.mkdir()
        (place / "s").symlink_to(seeds)
        os.chdir(place)
        words = line(number, seed, declared)
        print(f"begin {number}", flush=True)
        finding = outcome(words)
        os.chdir(seeds.parent)
        shutil.rmtree(place)
        if finding:
            print(f"found {number} {json.dumps([finding, words])}", flush=True)
    print("end", flush=True)


def fuzz_cli(count: int, seed: int, first: int = 0) -> int:
    """Run command lines and return the number of kinds of findings."""
    kinds: dict[str, list[str]] = {}
    last = first + count
    while first < last:
        lines, code = _batch(seed, first, min(last - first, 500))
        for text in (t for t in lines if t.startswith("found ")):
            number, payload = text.split(" ", 2)[1:]
            _note(kinds, number, *json.loads(payload))
        begun = [int(text.split()[1]) for text in lines if text.startswith("begin ")]
        if lines[-1:] != ["end"]:
            if not begun:
                raise SystemExit("the child did not start")
            _note(kinds, str(begun[-1]), f"the process ended ({code})", line(begun[-1], seed, commands()))
        first = begun[-1] + 1
    print(f"{count} command lines, {len(kinds)} kinds of findings")
    return len(kinds)


def _note(kinds: dict[str, list[str]], number: str, finding: str, words: list[str]) -> None:
    kind = re.sub(r"\d+|'.*'", "#", finding)
    if kind not in kinds:
        kinds[kind] = words
        print(f"{number}: {finding}: {[word[:40] for word in words]!r}", flush=True)


def _batch(seed: int, first: int, count: int) -> tuple[list[str], int]:
    base = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=base if base.is_dir() else None) as scratch:
        seeds, log = Path(scratch) / "seeds", Path(scratch) / "log"
        seeds.mkdir()
        write_seeds(seeds)
        (seeds / "zero").symlink_to("/dev/zero")
        os.mkfifo(seeds / "fifo")
        arguments = ["--child", "cli", "--seed", str(seed), "--first", str(first), "--count", str(count)]
        command = [sys.executable, "-m", "scripts.fuzz_run", *arguments, "--seeds", str(seeds)]
        with log.open("w") as stream:
            process = subprocess.Popen(command, stdout=stream, stderr=subprocess.DEVNULL)
            size, since = 0, time.monotonic()
            while process.poll() is None:
                time.sleep(0.1)
                if log.stat().st_size != size:
                    size, since = log.stat().st_size, time.monotonic()
                if time.monotonic() - since > HANG_S:
                    process.kill()
        return log.read_text().splitlines(), process.returncode
