"""Read the ECG that a Siemens scanner logs with its physiological monitoring unit (PMU), a `.ecg` file.

One line of integers: a header, texts between 5002 and 6002, samples with marks of the scanner's own trigger
(5000 on, 6000 off), 5003 at the end; then lines with the times of the log. Two leads may alternate.
Source: Kasper et al. 2017, PhysIO toolbox, tapas_physio_read_physlogfiles_siemens.
"""

import re
from pathlib import Path

import numpy as np

from dvf_ig.core import Signal, UnreadableFileError

from .leads import UNKNOWN_UNIT

_TEXT_BEGIN, _TEXT_END, _ON, _OFF, _END = "5002", "6002", "5000", "6000", "5003"
_CLOCK = re.compile(r"Log(Start|Stop)MDHTime:\s*(\d{1,9})")
_AGREES = 0.02
"""Largest relative difference between the stated rate and samples over the time that the log took."""
_ALTERNATING = 2.0
"""Ratio of steps between neighbours to steps between next neighbours above which two leads alternate."""


def is_pmu_log(text: str) -> bool:
    """Return whether a text is the log of a PMU."""
    return re.match(r"\s*\d+(?:\s+\d+)*\s+5002\s", text[:400]) is not None and _END in text


def read_pmu_log(path: Path, text: str, rate_hz: float | None = None) -> Signal:
    """Read the samples of a log, whose marks of a trigger are left out; sample 0 is at 0 s.

    Args:
        path: the file, for messages.
        text: its content.
        rate_hz: samples per second of each lead; None uses the times of the log.
    Raises:
        UnreadableFileError: damaged, no rate, or a rate that contradicts the times of the log.
    """
    body, _, footer = text.partition(f" {_END}")
    words = body.split()
    begin = len(words) - words[::-1].index(_TEXT_END) if _TEXT_END in words else 0
    samples = [word for word in words[begin:] if word not in (_ON, _OFF)]
    if not begin or len(samples) < 2 or not all(re.fullmatch(r"\d{1,5}", word) for word in samples):
        raise UnreadableFileError(f"{path} is a damaged PMU log of a Siemens scanner; export it again")
    values = np.array(samples, dtype=np.float64)
    leads = 2 if _alternates(values) else 1
    values = values[: len(values) // leads * leads].reshape(-1, leads)
    clock = dict(_CLOCK.findall(footer))
    log_s = (int(clock["Stop"]) - int(clock["Start"])) / 1000.0 if {"Start", "Stop"} <= set(clock) else 0.0
    measured_hz = len(values) / log_s if log_s > 0 else None
    if rate_hz is None:
        rate_hz = None if measured_hz is None else float(round(measured_hz))
    elif measured_hz is not None and abs(measured_hz - rate_hz) > _AGREES * rate_hz:
        raise UnreadableFileError(
            f"{path} has {len(values)} samples of each lead in {log_s:g} s, {measured_hz:.4g} Hz, but --rate "
            f"is {rate_hz:g} Hz; omit it"
        )
    if rate_hz is None:
        raise UnreadableFileError(
            f"{path} is a PMU log that does not say when it began and ended; give its sampling rate in Hz "
            "(400 in most versions)",
            settings=("ecg.rate_hz",),
        )
    return Signal(values, rate_hz, 0.0, ("ECG 1", "ECG 2")[:leads], UNKNOWN_UNIT)


def _alternates(values: np.ndarray) -> bool:
    """Return whether samples of two leads alternate."""
    near, next_but_one = np.abs(np.diff(values)).mean(), np.abs(values[2:] - values[:-2]).mean()
    return bool(near > _ALTERNATING * next_but_one)
