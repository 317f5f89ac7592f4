"""Read phase times of a 4-D data set: our `timing.json`, or bivme's file with trigger times per slice."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.timing.cycle import CycleTiming, require_whole_cycle
from dvf_ig.io.json_file import read_json, write_json
from dvf_ig.io.reading import reading

log = logging.getLogger(__name__)

ASSUMED_RR_S = 1.0
_KEYS = {"fractions", "rr_s", "rr_assumed", "timing_assumed", "series"}
_SAME = 0.02
"""Largest relative difference of two lengths of a cycle that are called equal."""


def read_timing(
    path: Path | str | None, *, folder: Path, phases: int, image: str | None = None
) -> CycleTiming:
    """Read the timing of `phases` phases.

    Args:
        path: the timing file; None looks for `timing.json` in `folder`; otherwise phase i is at i/N
            of an RR of 1.0 s, both marked as assumed.
        folder: of the data.
        phases: how many phases the data have.
        image: name of the image file, for a timing file that lists several.
    Raises:
        UnreadableFileError: absent, not a timing file, or of another number of phases.
    """
    if path is None:
        path = folder / "timing.json"
        if not path.is_file():
            return CycleTiming.uniform(phases, ASSUMED_RR_S, rr_assumed=True)
    path = Path(path)
    with reading(path, "a timing file"):
        timing = _parse(path, read_json(path, "a timing file"), image)
        if len(timing) != phases:
            raise UnreadableFileError(f"{path} times {len(timing)} phases, the data have {phases}")
        return timing


def timing_document(timing: CycleTiming) -> dict[str, Any]:
    """Build the JSON object that `timing_from_document` reads back exactly."""
    return {
        "fractions": timing.fractions.tolist(),
        "rr_s": timing.rr_s,
        "rr_assumed": timing.rr_assumed,
        "timing_assumed": timing.timing_assumed,
    }


def write_timing(timing: CycleTiming, path: Path | str) -> None:
    """Write a timing file: fractions, rr_s, and which of them were assumed."""
    write_json(path, timing_document(timing))


def timing_from_document(path: Path, document: Any) -> CycleTiming:
    """Build a CycleTiming from `{"fractions": [...], "rr_s": …}`."""
    if not isinstance(document, dict) or not {"fractions", "rr_s"} <= document.keys():
        raise UnreadableFileError(
            f'{path} is not a timing file; needed {{"fractions": [...], "rr_s": ...}}, or trigger times'
        )
    if unknown := sorted(map(str, document.keys() - _KEYS)):
        log.warning("%s: the fields %s are not known and are ignored", path, ", ".join(unknown))
    assumed = [document.get(key, False) for key in ("rr_assumed", "timing_assumed")]
    fractions = document["fractions"]
    numbers = fractions if isinstance(fractions, list) else []
    if any(not isinstance(flag, bool) for flag in assumed) or any(
        isinstance(number, bool | str) for number in (document["rr_s"], *numbers)
    ):
        raise UnreadableFileError(
            f"{path}: fractions or rr_s are not numbers, or rr_assumed or timing_assumed not true or false"
        )
    try:
        timing = CycleTiming(np.array(fractions, dtype=np.float64), float(document["rr_s"]), *assumed)
        if timing.rr_s < 1 and abs(_end(timing) - timing.rr_s) < _SAME * timing.rr_s:
            log.warning(
                f"{path}: its fractions would end the cycle at {_end(timing):.3g}, as times in s of its "
                "rr_s do; they are read as shares of the cycle"
            )
        return timing
    except (TypeError, ValueError, OverflowError) as exc:
        if isinstance(exc, InvalidInputError):
            raise
        raise UnreadableFileError(f"{path}: fractions or rr_s are not numbers ({exc})") from exc


def _end(timing: CycleTiming) -> float:
    """Return the fraction a mean step after the last phase: 1 for a whole cycle."""
    count = len(timing)
    return float(timing.fractions[-1] * count / (count - 1)) if count > 1 else 1.0


def _parse(path: Path, document: Any, image: str | None) -> CycleTiming:
    series = document if isinstance(document, dict) else {}
    listed = {name: e for name, e in series.items() if isinstance(e, dict) and "trigger_ms" in e}
    if not listed:
        return timing_from_document(path, document)
    if image in listed:
        return _from_triggers(path, listed[image])
    short_axis = [entry for name, entry in listed.items() if name.startswith("sax")]
    if len(short_axis) == 1:
        return _from_triggers(path, short_axis[0])
    if len(listed) == 1:
        return _from_triggers(path, next(iter(listed.values())))
    raise UnreadableFileError(f"{path} lists {', '.join(listed)}; none is the short-axis (sax…) series")


def _from_triggers(path: Path, entry: dict[str, Any]) -> CycleTiming:
    """Average trigger time / RR over slices, each acquired at its own RR; average the RR."""
    try:
        trigger_s = np.atleast_2d(np.array(entry["trigger_ms"], dtype=np.float64)) / 1000.0
        rr_s = np.array(entry["RR_ms"], dtype=np.float64) / 1000.0
        if rr_s.shape != trigger_s.shape[:1]:
            raise UnreadableFileError(
                f"{path}: trigger_ms has {len(trigger_s)} slices, RR_ms {rr_s.size}; needed one RR interval "
                "each"
            )
        fractions = (trigger_s / rr_s[:, None]).mean(axis=0)
    except (KeyError, TypeError, ValueError, OverflowError) as exc:
        if isinstance(exc, UnreadableFileError):
            raise
        raise UnreadableFileError(f"{path}: needed trigger_ms and RR_ms of each slice ({exc})") from exc
    require_whole_cycle(fractions, "trigger_ms")
    return CycleTiming(fractions, float(rr_s.mean()))
