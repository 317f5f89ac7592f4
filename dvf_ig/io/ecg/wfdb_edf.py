"""WFDB and EDF recordings, through the packages of the `ecg` extra."""

import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import MissingDependencyError, UnreadableFileError
from dvf_ig.core.signal import Signal
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import refuse_lfs_pointer

from .record_files import record_files

DAMAGE = (ValueError, LookupError, TypeError, ArithmeticError, OSError)
"""What these packages raise on damaged files."""

MOST_DECIMALS = 8
"""A step of an EDF lead with more than these is no round number."""
_TO_MV = {"mv": 1.0, "uv": 1e-3, "µv": 1e-3, "μv": 1e-3, "v": 1e3}


def read_wfdb(record: Path) -> Signal:
    """All leads of a WFDB record in mV; the record is named without suffix.

    Raises:
        MissingDependencyError: the package wfdb is absent.
        UnreadableFileError: a file of the record is absent or damaged.
    """
    wfdb = wfdb_package()
    record = existing_record(record)
    try:
        with quiet():
            data = wfdb.rdrecord(str(record.resolve()))
        for file in record_files(record):
            record_file(file)
    except DAMAGE as exc:
        raise UnreadableFileError(f"{record}: not a readable WFDB record ({exc}); copy it again") from exc
    if data.p_signal is None:
        raise UnreadableFileError(f"{record}: the record has several sampling rates; resample it to one")
    samples = np.asarray(data.p_signal, dtype=np.float64)
    return _signal(record, samples, list(data.units), [str(n) for n in data.sig_name], float(data.fs))


def read_edf(path: Path) -> Signal:
    """The ECG leads of an EDF file in mV: those labelled ECG, or all where none is.

    Raises:
        MissingDependencyError: the package edfio is absent.
        UnreadableFileError: absent, damaged, or leads of different rates.
    """
    edfio = _extra("edfio")
    try:
        with quiet():
            edf = edfio.read_edf(path)
        labelled = [s for s in edf.signals if "ecg" in s.label.lower()]
        chosen = labelled or list(edf.signals)
        rates = {float(s.sampling_frequency) for s in chosen}
        columns = [_physical(s) for s in chosen]
    except FileNotFoundError:
        raise
    except DAMAGE as exc:
        raise UnreadableFileError(f"{path}: not a readable EDF file ({exc}); export it again") from exc
    if len(rates) != 1:
        listed = ", ".join(f"{s.label} {s.sampling_frequency:g} Hz" for s in chosen) or "none"
        raise UnreadableFileError(f"{path}: leads do not share one rate ({listed}); export the ECG alone")
    units = [s.physical_dimension for s in chosen]
    return _signal(path, np.column_stack(columns), units, [s.label for s in chosen], rates.pop())


def _physical(lead: Any) -> FloatArray:
    """(n,) values in the lead's unit: whole numbers of the step that its header's ranges give.

    A step of few decimals, such as 0.0025 mV, is taken as these, not as the quotient of the ranges, and its
    multiples are the decimals that they are: what was digitised in such steps comes back bit for bit.
    """
    low, high = lead.physical_min, lead.physical_max
    if low == high:
        raise ValueError(f"{lead.label} has the same physical minimum and maximum")
    step = (high - low) / (lead.digital_max - lead.digital_min)
    counts = lead.digital.astype(np.float64) - lead.digital_max
    plain = f"{step:.12g}"
    decimals = max(_decimals(plain), _decimals(repr(high)))
    if decimals > MOST_DECIMALS or abs(float(plain) - step) > 1e-13 * abs(step):
        return np.asarray(high + counts * step)
    return np.asarray(np.round(high + counts * float(plain), decimals))


def _decimals(number: str) -> int:
    """Digits after the decimal point."""
    return -int(Decimal(number).as_tuple().exponent)


def existing_record(record: Path) -> Path:
    """The record's path without suffix, checked before wfdb could look for it elsewhere."""
    if record.suffix in (".hea", ".dat", ".atr"):
        record = record.with_suffix("")
    if not Path(f"{record}.hea").is_file():
        raise UnreadableFileError(f"{record}.hea does not exist; a WFDB record needs .hea and .dat together")
    for ending in (".hea", ".dat"):
        refuse_lfs_pointer(Path(f"{record}{ending}"))
    return record


def _signal(path: Path, samples: FloatArray, units: list[str], leads: list[str], rate_hz: float) -> Signal:
    unknown = sorted({unit for unit in units if unit.strip().lower() not in _TO_MV})
    if unknown:
        raise UnreadableFileError(
            f"{path}: leads are in {', '.join(map(repr, unknown))}; needed mV, uV or V (calibrate the record)"
        )
    scale = np.array([_TO_MV[unit.strip().lower()] for unit in units])
    samples = samples if (scale == 1).all() else samples * scale
    return Signal(samples, rate_hz, 0.0, tuple(leads))


def wfdb_package() -> ModuleType:
    return _extra("wfdb")


@contextmanager
def quiet() -> Iterator[None]:
    """Silence what these packages' own dependencies warn about; a user cannot act on it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _extra(name: str) -> ModuleType:
    try:
        with quiet():
            return importlib.import_module(name)
    except ModuleNotFoundError as exc:
        raise MissingDependencyError(
            f'reading this ECG needs the package {name}; install it with: pip install "dvf-ig[ecg]"'
        ) from exc
