"""Choose the ECG leads among the channels of a recording, by label and unit."""

import logging
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError
from dvf_ig.io.table_text import IN_ONE_MV, UNSTATED

log = logging.getLogger(__name__)

UNKNOWN_UNIT = "unknown"
_SPLIT = re.compile(r"[^a-z0-9]+")
_ECG_WORDS = re.compile(
    r"[a-z]*e[ck]g(data|sig\w*|raw|clean|lead|ch|channel|wave\w*|value|filt\w*|[a-z]{0,3})\d*"
    r"|ele[ck]trocardiogra\w*|elektrokardiogra\w*|holter\d*|m?cl\d*|m[lv]i{1,3}|m[lv]\d|cm\d|cc\d"
    r"|d?i{1,3}|d[1-3]|a?v[rlf]|v[1-9]?r?|v[xyz]|v[12]raw|lead[a-z]?\d*|[lr][al]|[ae]s|ai"
)
"""Words that name a lead: ECG, EKG, I to III, aVR, aVL, aVF, V1 to V9, V3R, MLII, MV2, MCL1, CM5, VX, ES."""
_EASI = re.compile(r"^(?:[ae]-s|a-i)$")
_NO_NAME = re.compile(r"|(column|signal|channel|ch|chan|lead)[ _]?\d*", re.IGNORECASE)
"""Labels that say nothing of what was recorded."""
_CAMEL = re.compile(r"(?<=[a-z]{2})(?=[A-Z])")
_CARDIAC = re.compile(r"cardiac\d*|heart")
"""Name of the heart's channel in BIDS: an ECG or a pulse."""
_OTHER_WORDS = re.compile(
    r"pleth\w*|ppg\w*|ppu|puls\w*|[a-z]*spo2\w*|sao2|[aun]?[abi]bp\w*|bp|art|cvp\w*|[pbiu]ap|icp\w*|uvp|pressure|press"
    r"|druck|resp\w*|rsp\w*|breath\w*|atem\w*|atmung|airflow|flow|thor\w*|abd\w*|imp|impedance|[a-z]*co2|co"
    r"|eda|gsr|scl|emg\w*|eog\w*|eeg\w*|scg|pcg|bcg|phono\w*|temp\w*|acc\w*|gyro\w*|gyr|mag\w*|marker\w*|mark\d*"
    r"|trig\w*|event\w*|status|stim\w*|annot\w*|sync\w*|ttl|digital|hr|hrv|heartrate|rate|rr|st\d?|pvc|pac(er|e)?|quality|sqi|snore"
    r"|position|pos|light|sound|mic\w*|photo\w*|battery|bat|nseq|seq|counter|index|valid|flag\w*|loss|error"
    r"|timestamp\w*|time|date|clock|g[xyz]|filter|peaks?|onsets?|offsets?|phase|completion|rpeaks?|beats?|reference"
)
"""Words that name something else, or something derived from an ECG."""

Kind = Literal["ecg", "cardiac", "unknown", "other"]


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of a recording.

    Attributes:
        label: as the file has it.
        unit: as the file has it; "" if it states none.
        rate_hz: None if all channels of the file share one.
    """

    label: str
    unit: str = ""
    rate_hz: float | None = None

    @property
    def kind(self) -> Kind:
        """Whether label and unit are those of an ECG lead, of something else, or of neither."""
        if self.unit.strip().lower() not in (*IN_ONE_MV, *UNSTATED):
            return "other"
        label = _EASI.sub(lambda easi: easi[0].replace("-", ""), _CAMEL.sub(" ", self.label).lower())
        words = [word for word in _SPLIT.split(label) if word]
        named = [word for word in words if _ECG_WORDS.fullmatch(word)]
        others = [word for word in words if word not in named and _OTHER_WORDS.fullmatch(word)]
        if others and not (named and set(others) == {"eeg"}):  # "EEG EKG1-REF" is an EEG recorder's ECG
            return "other"
        if named:
            return "ecg"
        return "cardiac" if any(_CARDIAC.fullmatch(word) for word in words) else "unknown"

    @property
    def described(self) -> str:
        """Label, unit and rate, for messages."""
        rate = "" if self.rate_hz is None else f" at {self.rate_hz:g} Hz"
        return f"{self.label or 'unnamed'}{f' [{self.unit}]' if self.unit else ''}{rate}"


def choose_leads(
    source: Path | str, channels: Sequence[Channel], lead: str | None = None, *, declared: bool = False
) -> list[int]:
    """Choose the channels that are ECG leads, and report those that are left out.

    Args:
        source: the file or stream, for messages.
        channels: every channel of the recording except times.
        lead: labels to take instead, separated by commas.
        declared: whether the file calls all of them an ECG, so that a label without meaning is a lead.
    Returns:
        indices of channels of one rate, in the file's order.
    Raises:
        UnreadableFileError: no channel is an ECG; several could be, and none is named so; no such `lead`, or
            one whose unit is not that of a voltage; leads of several rates.
    """
    if not channels:
        raise UnreadableFileError(f"{source} holds no channel of samples; needed an ECG")
    chosen = (
        _named(source, channels, lead) if lead is not None else _by_kind(source, channels, declared=declared)
    )
    rates = {channels[i].rate_hz for i in chosen}
    if len(rates) > 1:
        raise UnreadableFileError(
            f"{source}: leads do not share one rate ({_listed(channels, chosen)}); choose leads of one rate",
            settings=("ecg.lead",),
        )
    names = [_key(channels[i].label) for i in chosen]
    if again := sorted({name for name in names if names.count(name) > 1}):
        log.warning("%s: several channels are named %s; all are taken as ECG", source, ", ".join(again))
    left = [i for i in range(len(channels)) if i not in chosen]
    if left:
        log.warning("%s: ECG is %s; left out: %s", source, _listed(channels, chosen), _listed(channels, left))
    return chosen


def _by_kind(source: Path | str, channels: Sequence[Channel], *, declared: bool) -> list[int]:
    """Take what is named as an ECG; else the only channel that may be one."""
    kinds = [channel.kind for channel in channels]
    leads: tuple[Kind, ...] = ("ecg", "unknown") if declared else ("ecg",)
    chosen = [i for i, kind in enumerate(kinds) if kind in leads]
    if chosen:
        return chosen
    for kind in ("cardiac", "unknown"):
        candidates = [i for i, other in enumerate(kinds) if other == kind]
        if len(candidates) > 1:
            raise UnreadableFileError(
                f"{source} names no channel as an ECG, and {len(candidates)} may be one: "
                f"{_listed(channels, candidates)}; name the lead",
                settings=("ecg.lead",),
            )
        if candidates:
            if (
                len(channels) > 1
                or kind == "cardiac"
                or not _NO_NAME.fullmatch(channels[candidates[0]].label)
            ):
                log.warning(
                    f"{source}: no channel is named as an ECG; {channels[candidates[0]].described} is taken "
                    "as one, which a pulse wave must not be"
                )
            return candidates
    raise UnreadableFileError(
        f"{source} has no channel of an ECG, only {_listed(channels, range(len(channels)))}; needed a "
        "lead in mV, uV or V"
    )


def _named(source: Path | str, channels: Sequence[Channel], lead: str) -> list[int]:
    """Take the channels with these labels."""
    chosen: list[int] = []
    labels = [_key(channel.label) for channel in channels]
    whole = [i for i, label in enumerate(labels) if label == _key(lead)]
    for name in [lead] if whole else lead.split(","):
        same = [i for i, label in enumerate(labels) if label == _key(name)]
        if not same:
            raise UnreadableFileError(
                f"{source} has no lead '{name.strip()}'; it has {_listed(channels, range(len(channels)))}",
                settings=("ecg.lead",),
            )
        chosen += [i for i in same if i not in chosen]
    for channel in (channels[i] for i in chosen):
        if channel.unit.strip().lower() not in (*IN_ONE_MV, *UNSTATED):
            raise UnreadableFileError(
                f"{source}: {channel.label} is in '{channel.unit}', which is no voltage; needed a lead "
                f"in mV, uV or V among {_listed(channels, range(len(channels)))}",
                settings=("ecg.lead",),
            )
        if channel.kind == "other":
            log.warning("%s: %s is taken as an ECG, though its name says otherwise", source, channel.label)
    return sorted(chosen)


def _key(label: str) -> str:
    return " ".join(label.lower().split())


def _listed(channels: Sequence[Channel], chosen: Sequence[int]) -> str:
    text = ", ".join(channels[i].described for i in list(chosen)[:12])
    return f"{text} and {len(chosen) - 12} more" if len(chosen) > 12 else text


def in_millivolts(path: Path, samples: FloatArray, leads: Sequence[Channel]) -> tuple[FloatArray, str]:
    """Convert (n, leads) samples to mV, and return them with their unit: mV, or unknown if none is stated.

    Raises:
        UnreadableFileError: voltages and leads without a unit together, whose sizes cannot be compared.
    """
    units = [lead.unit.strip().lower() for lead in leads]
    unstated = [unit in UNSTATED for unit in units]
    if all(unstated):
        log.warning(
            f"{path} states no unit of {_listed(leads, range(len(leads)))}: times are right, amplitudes are "
            "not calibrated"
        )
        return samples, UNKNOWN_UNIT
    if any(unstated):
        raise UnreadableFileError(
            f"{path}: some leads state no unit ({_listed(leads, range(len(leads)))}); choose some that do",
            settings=("ecg.lead",),
        )
    scale = np.array([1.0 / IN_ONE_MV[unit] for unit in units])
    return (samples if (scale == 1).all() else np.asarray(samples * scale)), "mV"


def swing_of(samples: FloatArray, rate_hz: float) -> float:
    """Return the median over windows of 2 s of the range of (n,) samples; 0 if all are missing or equal."""
    width = min(len(samples), max(2, round(2 * rate_hz)))
    windows = samples[: len(samples) // width * width].reshape(-1, width)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # windows without samples
        ranges = np.fmax.reduce(windows, axis=1) - np.fmin.reduce(windows, axis=1)
    return float(np.median(ranges[ranges > 0])) if (ranges > 0).any() else 0.0
