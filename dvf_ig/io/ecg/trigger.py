"""Read and write trigger pulses: one column of times in seconds, with or without a header."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import Signal, TriggerTimes, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.reading import read_text, reading
from dvf_ig.io.writing.atomic import write_text

from .recording import KINDS, read_ecg

TRIGGER_PREFIX = "trigger:"
_DELAY = re.compile(r"#\s*delay_s\s+(\S+)")


def read_beat_source(
    spec: str, *, rate_hz: float | None = None, delay_s: float | None = None, lead: str | None = None
) -> Signal | TriggerTimes:
    """Read an ECG (`read_ecg`), or with `trigger:PATH` trigger pulses (`read_triggers`).

    Args:
        spec: an ECG, or `trigger:PATH`.
        rate_hz: sampling rate of an ECG table without times.
        delay_s: of the pulses of a trigger after the R peak.
        lead: leads of an ECG to take (`read_ecg`).
    Raises:
        UnreadableFileError, InvalidInputError, MissingDependencyError: as these two, or an argument that
            belongs to the other.
    """
    if spec.startswith(TRIGGER_PREFIX):
        if rate_hz is not None or lead is not None:
            what = "lead" if rate_hz is None else "rate"
            raise UnreadableFileError(f"a {what} belongs to an ECG; '{spec}' holds the times of pulses")
        return read_triggers(spec.removeprefix(TRIGGER_PREFIX), delay_s)
    if delay_s is not None:
        raise UnreadableFileError(
            f"a delay belongs to trigger:FILE; '{spec}' is an ECG, whose R peaks are found"
        )
    return read_ecg(spec, rate_hz, lead)


def read_triggers(path: Path | str, delay_s: float | None = None) -> TriggerTimes:
    """Read times of trigger pulses.

    Args:
        path: text file, one time (s) per line; the first line may be a header, and a line `# delay_s 0.03`
            states the delay after the R peak.
        delay_s: replaces the delay that the file states.
    Raises:
        UnreadableFileError: absent, empty, a line that is not one number, or times out of order.
    """
    path = Path(path)
    lines = [line.strip().rstrip(",") for line in read_text(path, "a list of trigger times").splitlines()]
    stated = [match[1] for line in lines if (match := _DELAY.fullmatch(line))]
    rows = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
    if rows and not _is_number(rows[0][1]):
        rows = rows[1:]
    if not rows:
        raise UnreadableFileError(f"{path} holds no trigger time; needed one time in seconds per line")
    bad = [row for row in rows if not _is_number(row[1])]
    if bad or not all(_is_number(text) for text in stated):
        number, line = bad[0] if bad else (1 + lines.index(f"# delay_s {stated[0]}"), stated[0])
        raise UnreadableFileError(f"{path}, line {number}: '{line[:40]}' is not one time in seconds")
    if delay_s is None:
        delay_s = float(stated[0]) if stated else 0.0
    with reading(path, "a list of trigger times"):
        times = np.array([float(line) for _, line in rows])
        limits.require_times(times, "its list")
        return TriggerTimes(times, delay_s)


def write_triggers(trigger: TriggerTimes, path: Path | str) -> None:
    """Write a trigger in the format of `read_triggers`, with every digit.

    Raises:
        OutputError: not writable.
    """
    lines = [f"# delay_s {trigger.delay_s!r}", "t_s", *map(repr, trigger.t_s.tolist())]
    write_text(Path(path), "\n".join(lines) + "\n")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class EcgName:
    """`plus:sweep.igs.mha#EcgData` as its format, its file, and the field in it."""

    prefix: str
    name: str
    field: str


def split_ecg(spec: str) -> EcgName:
    """Split the name of an ECG or a trigger; prefix and field are empty if they are not given."""
    kind, colon, rest = spec.partition(":")
    if not colon or f"{kind}:" not in (*(f"{k}:" for k in KINDS), TRIGGER_PREFIX):
        kind, colon, rest = "", "", spec
    name, at, field = rest.partition("#")
    return EcgName(kind + colon, name, at + field)
