"""Read WFDB recordings through the package of the `ecg` extra."""

import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from dvf_ig.core.errors import MissingDependencyError, UnreadableFileError, install_extra
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.io import limits
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import refuse_lfs_pointer

from .units import in_millivolts
from .wfdb_header import read_record_header

_DAMAGE = (
    ValueError,
    LookupError,
    TypeError,
    ArithmeticError,
    OSError,
    NameError,
    AttributeError,
    RuntimeError,
    AssertionError,
    MemoryError,
)
"""Exceptions that the package raises on damaged files."""


UNIT = "mV"
"""Unit of a signal that states none, as of a lead that no segment holds (WFDB header(5))."""


def read_wfdb(record: Path) -> Signal:
    """Read all leads of a WFDB record, named without suffix, in mV.

    A signal without a gain is read at 200 units per mV (WFDB header(5)), with a warning. A lead that no
    segment holds is all NaN; a lead without a name becomes "signal 0" and so on.

    Raises:
        MissingDependencyError: the package wfdb is absent.
        UnreadableFileError: a file of the record is absent or damaged.
    """
    wfdb = _package()
    record = existing_record(record)
    header = read_record_header(record)
    for file in header.files:
        refuse_lfs_pointer(file)
    if header.stated is not None and header.available is not None and header.available < header.stated:
        raise UnreadableFileError(
            f"{record}: not a readable WFDB record (truncated: {header.available} of {header.stated} "
            "samples); copy it again"
        )
    try:
        with _quiet():
            data = wfdb.rdrecord(str(record.resolve()))
    except _DAMAGE as exc:
        raise UnreadableFileError(f"{record}: not a readable WFDB record ({exc}); copy it again") from exc
    for file in header.files:
        record_file(file)
    if data.p_signal is None:
        raise UnreadableFileError(f"{record}: the record has several sampling rates; resample it to one")
    limits.require_count(data.p_signal.size, limits.SAMPLES, "samples")
    samples = np.asarray(data.p_signal, dtype=np.float64)
    labels = tuple(name or f"signal {n}" for n, name in enumerate(data.sig_name))
    units = [unit or UNIT for unit in data.units]
    return Signal(in_millivolts(record, samples, units), header.rate_hz, 0.0, labels)


def existing_record(record: Path) -> Path:
    """Return the record's path without suffix, after checking that its files exist."""
    if record.suffix in (".hea", ".dat", ".atr"):
        record = record.with_suffix("")
    if not Path(f"{record}.hea").is_file():
        raise UnreadableFileError(f"{record}.hea does not exist; a WFDB record needs .hea and .dat together")
    for ending in (".hea", ".dat"):
        refuse_lfs_pointer(Path(f"{record}{ending}"))
    return record


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence warnings of the package's own dependencies; a user cannot act on them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _package() -> ModuleType:
    try:
        with _quiet():
            return importlib.import_module("wfdb")
    except ModuleNotFoundError as exc:
        raise MissingDependencyError(
            f"reading this ECG needs the package wfdb; {install_extra('ecg')}"
        ) from exc
