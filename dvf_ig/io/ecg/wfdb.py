"""Read WFDB recordings through the package of the `ecg` extra."""

import importlib
import logging
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from dvf_ig.core import FloatArray, Signal
from dvf_ig.core.errors import MissingDependencyError, UnreadableFileError, install_extra
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import refuse_lfs_pointer

from .leads import Channel, choose_leads, in_millivolts
from .wfdb_header import RecordHeader, read_record_header, simplified

log = logging.getLogger(__name__)

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


def read_wfdb(record: Path, lead: str | None = None, rate_hz: float | None = None) -> Signal:
    """Read the ECG leads of a WFDB record (`choose_leads`), named without suffix, in mV, at their own rate.

    A signal without a gain is read at 200 units per mV (WFDB header(5)), with a warning. A lead that no
    segment holds is all NaN.

    Args:
        record: path without suffix.
        lead: labels of the leads to take instead, separated by commas.
        rate_hz: samples per second of a record whose header states none.
    Raises:
        MissingDependencyError: the package wfdb is absent.
        UnreadableFileError: a file of the record is absent or damaged; no ECG, or leads of several rates.
    """
    channels, signals = read_wfdb_signals(record, rate_hz)
    chosen = choose_leads(record, channels, lead)
    samples, unit = in_millivolts(
        record, np.column_stack([signals[i] for i in chosen]), [channels[i] for i in chosen]
    )
    left_out = tuple(channel.label for i, channel in enumerate(channels) if i not in chosen)
    labels = tuple(channels[i].label for i in chosen)
    return Signal(samples, channels[chosen[0]].rate_hz or 0.0, 0.0, labels, unit, left_out)


def read_wfdb_signals(record: Path, rate_hz: float | None = None) -> tuple[list[Channel], list[FloatArray]]:
    """Read all signals of a WFDB record, each at its own rate.

    A signal without a name becomes "signal 0" and so on.

    Args:
        record, rate_hz: as of `read_wfdb`.
    Raises:
        MissingDependencyError: the package wfdb is absent.
        UnreadableFileError: a file of the record is absent or damaged.
    """
    wfdb = wfdb_package()
    record = existing_record(record)
    header = read_record_header(record)
    for file in header.files:
        refuse_lfs_pointer(file)
    _compare_lengths(record, header)
    try:
        with quiet(), _readable(record, header) as readable:
            data = wfdb.rdrecord(str(readable.resolve()), smooth_frames=False)
    except _DAMAGE as exc:
        raise UnreadableFileError(f"{record}: not a readable WFDB record ({exc}); copy it again") from exc
    for file in header.files:
        record_file(file)
    if data.e_p_signal is None:
        raise UnreadableFileError(f"{record}: not a readable WFDB record (no samples); copy it again")
    frames_hz = _frames_hz(record, header, rate_hz)
    labels = [name or f"signal {n}" for n, name in enumerate(data.sig_name)]
    rates = [frames_hz * (count or 1) for count in data.samps_per_frame or [1] * len(labels)]
    units = [unit or UNIT for unit in data.units]
    channels = [Channel(*channel) for channel in zip(labels, units, rates, strict=True)]
    return channels, [np.asarray(samples, dtype=np.float64) for samples in data.e_p_signal]


def _compare_lengths(record: Path, header: RecordHeader) -> None:
    if header.stated is None or header.available is None:
        return
    if header.available < header.stated:
        raise UnreadableFileError(
            f"{record}: not a readable WFDB record (truncated: {header.available} of {header.stated} "
            "samples); copy it again"
        )
    if header.available > header.stated:
        log.warning(
            f"{record}: its files hold {header.available} samples of each signal, its header says "
            f"{header.stated}; the rest is left out"
        )


def _frames_hz(record: Path, header: RecordHeader, rate_hz: float | None) -> float:
    """Return the rate of the header, else `rate_hz`, else the default of WFDB, with a warning."""
    if header.rate_stated:
        return header.rate_hz
    if rate_hz is None:
        log.warning(
            "%s states no sampling rate: the WFDB default of %g Hz is assumed", record, header.rate_hz
        )
    return rate_hz or header.rate_hz


@contextmanager
def _readable(record: Path, header: RecordHeader) -> Iterator[Path]:
    """Yield the record, or a temporary copy with record lines that the package can parse."""
    texts = {file: simplified(file) for file in header.files if file.suffix == ".hea"}
    if not any(texts.values()):
        yield record
        return
    with tempfile.TemporaryDirectory(prefix="dvf_ig_") as folder:
        for file in dict.fromkeys(header.files):
            copy, text = Path(folder) / file.relative_to(record.parent), texts.get(file)
            copy.parent.mkdir(parents=True, exist_ok=True)
            if text is None:
                shutil.copyfile(file, copy)
            else:
                copy.write_text(text, encoding="ascii", errors="replace")
        yield Path(folder) / record.name


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
def quiet() -> Iterator[None]:
    """Silence warnings of the package's own dependencies; a user cannot act on them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def wfdb_package() -> ModuleType:
    """Return the package that reads WFDB.

    Raises:
        MissingDependencyError: absent.
    """
    try:
        with quiet():
            return importlib.import_module("wfdb")
    except ModuleNotFoundError as exc:
        raise MissingDependencyError(
            f"reading a WFDB record needs the package wfdb; {install_extra('ecg')}"
        ) from exc
