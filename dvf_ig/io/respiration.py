"""Read and write recorded breathing: a channel of a monitor or ventilator, or a marker on the chest."""

import logging
import re
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Respiration, Signal, UnreadableFileError
from dvf_ig.core.plausible import marker_problem
from dvf_ig.io import limits
from dvf_ig.io.clock_times import past_midnight
from dvf_ig.io.ecg.trigger import EcgName
from dvf_ig.io.ecg.wfdb import read_wfdb_signals
from dvf_ig.io.plus.poses import read_poses
from dvf_ig.io.reading import read_text, reading
from dvf_ig.io.table_text import IN_ONE_SECOND, MM_IN, Column, parse_table
from dvf_ig.io.writing.atomic import write_text

log = logging.getLogger(__name__)

KINDS = ("csv", "wfdb", "marker")
Table = tuple[FloatArray, tuple[str, ...], FloatArray]
"""Times (n,) s, names of k columns, values (n, k) with NaN for empty cells."""

_BREATH = re.compile(r"resp|rsp|breath|thor|abdom|chest|volume|pressure|paw|flow|cvp", re.IGNORECASE)
_COORDINATE = re.compile(r"(?:[tp]|pos_|position_)?([xyz])(?:[ _]*[\[(]?(mm|cm|m)[\])]?)?", re.IGNORECASE)
_RATE = re.compile(r"rate|/min|bpm", re.IGNORECASE)
"""Name or unit of a number of breaths per minute, which does not follow the breath."""
_TIME = re.compile(r"t|times?|timestamps?|stamp|elapsed( time)?|seconds|zeit|uhrzeit", re.IGNORECASE)
_STEP_S = (1e-4, 2.0)
"""Shortest and longest step of times in a stated unit."""
_MOST_STEP_S = 0.5
"""Slower samples than 2 Hz do not show a breath; longer steps of times without a unit may be ms."""


def read_respiration(spec: str, rate_hz: float | None = None) -> Respiration:
    """Read what follows the breath, without its gaps.

    Args:
        spec: `csv:FILE#CHANNEL` or `wfdb:RECORD#CHANNEL`, without #CHANNEL the only one that is named as
            breathing is; or `marker:FILE`, a tracked sequence of one marker or a table of x, y, z (mm).
        rate_hz: sampling rate of a table without times, or whose times state no unit, and of a WFDB record
            whose header states none.
    Raises:
        InvalidInputError: none of these kinds.
        UnreadableFileError: absent or damaged; no such channel, or several that may be meant.
        MissingDependencyError: WFDB without its package.
    """
    parts = split_respiration(spec)
    if not parts.prefix or not parts.name:
        raise InvalidInputError(
            f"'{spec}' names no recording of breathing; write csv:FILE#CHANNEL, wfdb:RECORD#CHANNEL or "
            "marker:FILE"
        )
    kind, path, channel = parts.prefix[:-1], Path(parts.name), parts.field[1:]
    with reading(path, "a recording of breathing"):
        if kind == "marker" and path.suffix.lower() not in (".csv", ".tsv", ".txt"):
            poses = read_poses(path)
            return _samples(path, poses.t_s[poses.valid], poses.translations_mm[poses.valid], poses.source)
        if kind == "wfdb":
            channels, signals = read_wfdb_signals(path, rate_hz)
            at = choose_channel(path, tuple(one.label for one in channels), channel or None, example(path))
            t_s = np.arange(len(signals[at])) / (channels[at].rate_hz or 1.0)
            return _samples(path, t_s, signals[at][:, None], channels[at].label)
        t_s, names, values = _table(path, rate_hz)
        if kind == "marker":
            xyz_mm = _marker(path, names, values)
            if problem := marker_problem(path.stem, xyz_mm[np.isfinite(xyz_mm).all(axis=1)]):
                raise InvalidInputError(problem)
            return _samples(path, t_s, xyz_mm, path.stem)
        at = choose_channel(path, names, channel or None, example(path))
        return _samples(path, t_s, values[:, [at]], names[at])


def _marker(path: Path, names: tuple[str, ...], values: FloatArray) -> FloatArray:
    """Return (n, 3) positions of a marker, mm, by the names of their columns: x, tx, pos_x, "x (mm)", x_m."""
    parts = [_COORDINATE.fullmatch(name) for name in names]
    plain = tuple(names[i] if part is None else part[1].lower() for i, part in enumerate(parts))
    at = [choose_channel(path, plain, axis) for axis in "xyz"]
    scale = [MM_IN[(part[2] or "mm").lower()] if (part := parts[i]) is not None else 1.0 for i in at]
    return values[:, at] * scale


def example(path: Path) -> str:
    """Say how a channel of a file is named."""
    return f"name it: {path.name}#CHANNEL"


def names_breathing(name: str) -> bool:
    """Return whether a channel is named as what follows the breath."""
    return _BREATH.search(name) is not None and _RATE.search(name) is None


def split_respiration(spec: str) -> EcgName:
    """Split what names a recording of breathing; prefix and field are empty if they are not given."""
    kind, _, rest = spec.partition(":")
    if kind not in KINDS:
        return EcgName("", spec, "")
    name, mark, channel = rest.rpartition("#")
    if not mark or Path(rest).exists():
        return EcgName(f"{kind}:", rest, "")
    return EcgName(f"{kind}:", name, f"#{channel}")


def _samples(path: Path, t_s: FloatArray, values: FloatArray, name: str) -> Respiration:
    good = np.isfinite(values).all(axis=1) & np.isfinite(t_s)
    t_s, values = t_s[good], values[good]
    if len(values) and not np.ptp(values, axis=0).any():
        raise UnreadableFileError(f"{path}: '{name}' never changes; needed what follows the breath")
    limits.require_times(t_s, "its times")
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], t_s]))[:-1]
    later = t_s > latest
    if later.sum() < max(2, 0.5 * len(t_s)):
        raise UnreadableFileError(f"{path}: '{name}' has too few samples whose times increase")
    if not later.all():
        log.warning("%s: %d samples are not later than the one before and are left out", path, (~later).sum())
    return Respiration(t_s[later], values[later], name)


def choose_channel(source: object, names: tuple[str, ...], wanted: str | None, advice: str = "") -> int:
    """Find a channel by its name; without one, the only channel, or the only one named as breathing is.

    Args:
        source: what has these channels, and `advice`: how to name one of them, for messages.
    Raises:
        UnreadableFileError: no such channel, or several that may be meant.
    """
    if wanted is not None:
        if wanted not in names:
            raise UnreadableFileError(f"{source} has no channel '{wanted}'; it has {', '.join(names)}")
        return names.index(wanted)
    likely = [i for i, name in enumerate(names) if names_breathing(name)]
    likely = likely or [i for i, name in enumerate(names) if _BREATH.search(name)] or list(range(len(names)))
    if names and all(_RATE.search(name) for name in names):
        raise UnreadableFileError(
            f"{source} has only {', '.join(names)[:60]}, breaths per minute; needed what follows each breath"
        )
    if len(likely) != 1:
        shown = ", ".join(names[i] for i in likely) or "no channel at all"
        raise UnreadableFileError(f"{source} has {shown}, of which one must be breathing; {advice}")
    return likely[0]


def _table(path: Path, rate_hz: float | None) -> Table:
    """Read a text table that names its columns."""
    table = parse_table(path, read_text(path, "a table of breathing"))
    if table.columns is None:
        raise UnreadableFileError(f"{path}: needed a header that names its columns")
    if table.texts:
        log.warning("%s: the columns %s hold words and are left out", path, ", ".join(table.texts))
    header, values = table.columns, table.values
    at = next((i for i, column in enumerate(header) if _TIME.fullmatch(column.name)), None)
    if at is None:
        at = next(iter(table.clocks), None)
    columns = [i for i in range(len(header)) if i != at]
    names = tuple(header[i].heading for i in columns)
    if at is not None:
        times = past_midnight(values[:, at]) if at in table.clocks else values[:, at]
        unit = "s" if at in table.clocks else header[at].unit
        return _seconds(path, times, header[at], unit, rate_hz), names, values[:, columns]
    if None not in (table.rate_hz, rate_hz) and table.rate_hz != rate_hz:
        raise UnreadableFileError(
            f"{path} states {table.rate_hz:g} Hz, but --rate is {rate_hz:g} Hz; omit it"
        )
    if (rate_hz := table.rate_hz or rate_hz) is None:
        raise UnreadableFileError(
            f"{path} has no column of times (t_s, time or timestamp) among {', '.join(names)[:60]}; give its "
            "sampling rate with --rate"
        )
    return np.arange(len(values)) / rate_hz, names, values


def _seconds(path: Path, times: FloatArray, column: Column, unit: str, rate_hz: float | None) -> FloatArray:
    """Convert times to s by their unit; without one, steps too long for a breath need a rate.

    Raises:
        UnreadableFileError: no unit, long steps, and no rate, or one that fits neither s nor ms.
    """
    step, name = float(np.nanmedian(np.diff(times))), column.heading
    if unit.lower() in IN_ONE_SECOND:
        step_s = step / IN_ONE_SECOND[unit.lower()]
        if not _STEP_S[0] <= step_s <= _STEP_S[1]:
            raise UnreadableFileError(
                f"{path}: its times step by {step:g} {unit} (column '{name}'), which shows no breath; "
                "correct the unit in the header"
            )
        return times / IN_ONE_SECOND[unit.lower()]
    if step <= _MOST_STEP_S:
        return times
    if rate_hz is None:
        raise UnreadableFileError(
            f"{path}: its times '{name}' state no unit and step by {step:g}; name the column {name}_ms, or "
            "give the sampling rate: --rate, respiration.rate_hz"
        )
    for unit_s in (1.0, 0.001):
        if 0.5 <= step * unit_s * rate_hz <= 2.0:
            return times * unit_s
    raise UnreadableFileError(
        f"{path}: its times '{name}' step by {step:g}, at {rate_hz:g} Hz neither s nor ms; correct one"
    )


def write_channels(signal: Signal, path: Path | str) -> None:
    """Write a monitor's channels as CSV, `t_s` and a column each; `read_respiration` reads them back exactly.

    Raises:
        OutputError: not writable.
    """
    table = np.column_stack([signal.t_s, signal.samples]).tolist()
    lines = [",".join(["t_s", *signal.leads]), *(",".join(map(repr, row)) for row in table)]
    write_text(Path(path), "\n".join(lines) + "\n")
