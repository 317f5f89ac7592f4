"""Read and write ECG recordings, named by `wfdb:`, `edf:`, `csv:` or `plus:PATH`, or by a path's ending."""

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Signal, UnreadableFileError
from dvf_ig.core.plausible import ECG_RATE_HZ, ECG_SWING_MV
from dvf_ig.io import limits
from dvf_ig.io.plus.ecg_field import read_ecg_field
from dvf_ig.io.reading import reading
from dvf_ig.io.table_text import IN_ONE_MV
from dvf_ig.io.writing.atomic import write_text

from .edf import read_edf
from .leads import Channel, choose_leads, swing_of
from .text_table import read_ecg_table
from .wfdb import read_wfdb

log = logging.getLogger(__name__)

RATE_TOLERANCE = 1e-3
"""Largest relative difference between a rate that the user gives and the one that the file has."""
KINDS = ("wfdb", "edf", "csv", "plus")
_KIND_OF_ENDING = {
    ".hea": "wfdb",
    ".dat": "wfdb",
    ".atr": "wfdb",
    ".edf": "edf",
    ".bdf": "edf",
    ".csv": "csv",
    ".tsv": "csv",
    ".csv.gz": "csv",
    ".tsv.gz": "csv",
    ".ecg": "csv",
}
_FOREIGN = {
    "acq": "an AcqKnowledge recording (BIOPAC); save it as EDF, or as text with the time and channel names",
    "adicht": "a LabChart recording; export it as text with the time, or as EDF",
    "adidat": "a LabChart recording; export it as text with the time, or as EDF",
    "scp": "an SCP-ECG recording; export it as EDF, or as CSV with times in s and leads in mV",
    "smr": "a Spike2 recording; export it as EDF, or as text with times",
    "smrx": "a Spike2 recording; export it as EDF, or as text with times",
    "vhdr": "a BrainVision recording; export it as EDF",
}
"""What files of other programs are, by their endings, and what to export instead."""
_ISHNE = (b"ISHNE1.0", b"ANN  1.0")
_SEQUENCE_ENDINGS = (".mha", ".mhd", ".nrrd", ".nhdr")


def read_ecg(spec: str, rate_hz: float | None = None, lead: str | None = None) -> Signal:
    """Read the ECG leads of a recording; other channels are left out, with a warning that names them.

    Args:
        spec: `wfdb:PATH` (record, with or without suffix), `edf:PATH` (EDF or BDF), `csv:PATH` (see
            `read_ecg_table`), `plus:PATH` or `plus:PATH#FIELD` (a tracked sequence with an ECG in it:
            `read_ecg_field`), or the path alone if its ending (.hea, .dat, .edf, .bdf, .csv, .tsv, .mha,
            .nrrd) implies the format.
        rate_hz: sampling rate of a recording that states none.
        lead: labels of the leads to take, separated by commas, instead of those that are named as an ECG.
    Returns:
        the leads, NaN for missing samples; WFDB and EDF start at 0 s, the ECG of a sequence uses the
        sequence's clock.
    Raises:
        InvalidInputError: `spec` names no known format.
        UnreadableFileError: absent, damaged, unevenly sampled, no ECG, or of another rate than `rate_hz`.
        MissingDependencyError: WFDB without `pip install '.[ecg]'`.
    """
    kind, path = split_spec(spec)
    if what := foreign_recording(path):
        raise UnreadableFileError(f"{path} is {what}")
    with reading(path, f"an ECG ({kind})"):
        if kind == "wfdb":
            signal = read_wfdb(path, lead, rate_hz)
        elif kind == "plus":
            signal = _leads_of_field(path, read_ecg_field(path, _field(spec)), lead)
        else:
            signal = read_edf(path, lead) if kind == "edf" else read_ecg_table(path, rate_hz, lead)
        if rate_hz is not None and abs(rate_hz - signal.rate_hz) > RATE_TOLERANCE * signal.rate_hz:
            raise UnreadableFileError(
                f"{path} is sampled at {signal.rate_hz:.6g} Hz, but --rate is {rate_hz:g} Hz; omit it"
            )
        require_plausible(path, signal)
        return signal


def _leads_of_field(path: Path, signal: Signal, lead: str | None) -> Signal:
    """Take the ECG leads of a field of a sequence; the field's own unit is kept."""
    chosen = choose_leads(path, [Channel(label) for label in signal.leads], lead, declared=True)
    left_out = tuple(label for i, label in enumerate(signal.leads) if i not in chosen)
    labels = tuple(signal.leads[i] for i in chosen)
    return replace(signal, samples=signal.samples[:, chosen], leads=labels, left_out=left_out)


def require_plausible(path: Path, signal: Signal) -> None:
    """Refuse values, rates and times that no ECG has; warn of an empty lead and of a swing that no heart has.

    Raises:
        UnreadableFileError: names the problem and the file.
    """
    slowest, fastest = ECG_RATE_HZ
    if not slowest <= signal.rate_hz <= fastest:
        raise UnreadableFileError(
            f"{path} is sampled at {signal.rate_hz:.4g} Hz; an ECG is at {slowest:g} to {fastest:g} Hz: "
            "correct its rate, or the unit of its times",
            settings=("ecg.rate_hz",),
        )
    limits.require_times(signal.start_s, "its first time")
    largest = _largest(signal.samples)
    if np.isnan(largest):
        raise UnreadableFileError(f"{path} holds no sample of {', '.join(signal.leads)[:60]}, only gaps")
    if largest > limits.ECG_VALUE:
        raise UnreadableFileError(
            f"{path} holds a sample of {largest:g} {signal.unit}; needed finite values below "
            f"{limits.ECG_VALUE:g}, and nan where a sample is missing"
        )
    for lead, samples in zip(signal.leads, signal.samples.T, strict=True):
        if np.isnan(samples[0]) and np.isnan(samples).all():
            log.warning("%s: lead %s holds no sample, only gaps", path, lead)
            continue
        in_one_mv, (least, most) = IN_ONE_MV.get(signal.unit.lower()), ECG_SWING_MV
        swing = 0.0 if in_one_mv is None else swing_of(samples, signal.rate_hz) / in_one_mv
        if swing > 0 and not least <= swing <= most:
            log.warning(
                f"{path}: lead {lead} swings by {swing:.3g} mV from beat to beat, and a heart gives "
                f"{least:g} to {most:g} mV: its unit or gain is wrong; R peaks are found from its shape "
                "alone"
            )


def _largest(samples: FloatArray) -> float:
    """Return the largest magnitude; NaN if every sample is missing."""
    ends = (float(samples.max()), float(samples.min()))
    if np.isnan(ends[0]):
        ends = (float(np.fmax.reduce(samples, axis=None)), float(np.fmin.reduce(samples, axis=None)))
    return max(abs(ends[0]), abs(ends[1]))


def split_spec(spec: str) -> tuple[str, Path]:
    """Split an ECG name into its kind and path: `wfdb:PATH` → ("wfdb", PATH), `100.dat` → ("wfdb", 100.dat),
    `plus:PATH#FIELD` → ("plus", PATH).
    """
    kind, colon, path = str(spec).partition(":")
    if what := foreign_recording(Path(spec)):
        raise UnreadableFileError(f"{spec} is {what}")
    if kind == "plus" and path:
        return kind, Path(_without_field(path))
    if colon and kind in KINDS and path:
        return kind, Path(path)
    if _without_field(spec).lower().endswith(_SEQUENCE_ENDINGS):
        return "plus", Path(_without_field(spec))
    by_ending = _kind_by_name(spec)
    if by_ending is None:
        raise InvalidInputError(
            f"'{spec}' names no ECG; write wfdb:RECORD, edf:FILE, csv:FILE or plus:SEQUENCE (or a file "
            "with the ending .hea, .dat, .edf, .bdf, .csv, .tsv or .igs.mha)"
        )
    return by_ending, Path(spec)


def foreign_recording(path: Path) -> str | None:
    """Say what a recording of another program is, and what to export instead; None for any other file."""
    if not path.is_file():
        return None
    if path.stat().st_size >= len(_ISHNE[0]):
        with path.open("rb") as stream:
            if stream.read(len(_ISHNE[0])) in _ISHNE:
                return (
                    "an ISHNE Holter recording; export it as EDF, or as CSV with times in s and leads in mV "
                    "(its beat annotations are not needed)"
                )
    return _FOREIGN.get(path.suffix.lower().removeprefix("."))


def _without_field(path: str) -> str:
    """Remove "#FIELD" from a path, unless a file's own name contains the #."""
    return path.rpartition("#")[0] if "#" in path and not Path(path).exists() else path


def _field(spec: str) -> str | None:
    """Return the field of "plus:sweep.igs.mha#EcgData"; None if no field is named."""
    path = spec.removeprefix("plus:")
    return path[len(_without_field(path)) + 1 :] or None


def _kind_by_name(path: str) -> str | None:
    """Return the format implied by the ending; a WFDB record may be named without its ending."""
    name = Path(path).name.lower()
    kind = next((kind for ending, kind in _KIND_OF_ENDING.items() if name.endswith(ending)), None)
    return "wfdb" if kind is None and path and Path(f"{path}.hea").is_file() else kind


def names_ecg(spec: str) -> bool:
    """Return whether a path names an ECG by prefix or ending; a sequence, which may contain one, does not."""
    return spec.partition(":")[0] in KINDS or _kind_by_name(spec) is not None


def write_ecg_csv(signal: Signal, path: Path | str) -> None:
    """Write a recording as CSV: header `t_s,<lead>…`, every digit kept, `nan` for missing samples.

    Raises:
        InvalidInputError: a lead name with a comma, bracket or line break.
        OutputError: not writable.
    """
    for lead in signal.leads:
        if re.search(r"[,\[\]\r\n\"]", lead):
            raise InvalidInputError(f"lead name '{lead}' cannot be used in a CSV header; rename the lead")
    note = "" if signal.unit == "mV" else f" [{signal.unit}]"
    table = np.column_stack([signal.t_s, signal.samples]).tolist()
    lines = [",".join(["t_s", *(lead + note for lead in signal.leads)])]
    lines += [",".join(map(repr, row)) for row in table]
    write_text(Path(path), "\n".join(lines) + "\n")
