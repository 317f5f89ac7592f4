"""ECG in PLUS messages: a STRING, or a field of an image or a transform, that holds numbers.

It may be accompanied by `<Name>Timestamp` (time of its first sample) and `<Name>Leads` (their names; samples
then alternate between leads), as in a recorded sequence (`dvf_ig.io.plus.ecg_field`).
"""

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.io import limits
from dvf_ig.io.ecg.leads import Channel, choose_leads
from dvf_ig.live.igtl import Message, Text
from dvf_ig.session import EcgSamples

from .batches import BatchClock, plausible

LONGEST = 100_000
"""Largest number of values in one batch."""
LONGEST_S = 5.0
"""Largest duration of a batch, which is sent as it is acquired."""


class EcgField:
    """Reader of the ECG samples in messages.

    Args:
        name: name of the field or of the STRING's device.
        rate_hz: samples a second.
        lead: names of the leads, separated by commas; None takes all but those that are named as something
            else.
    """

    def __init__(self, name: str, rate_hz: float, lead: str | None = None) -> None:
        self._name, self._lead, self._clock = name, lead, BatchClock(rate_hz)
        self._labels: list[str] = []
        self._chosen: list[int] = []
        self._longest = round(LONGEST_S * rate_hz)
        self._last: tuple[str, str | None] | None = None

    def samples(self, message: Message, seen_s: float, offset_s: float) -> EcgSamples | None:
        """Return the samples of a message; None if it has none, or repeats the previous ones.

        Args:
            seen_s: the message's stamp by the session's clock.
            offset_s: the peer's clock minus the session's.
        Raises:
            InvalidInputError: a value or a time that is not a number, or leads of which none is an ECG.
        """
        text = message.fields.get(self._name)
        if text is None and isinstance(message.content, Text) and message.device == self._name[:20]:
            text = message.content.text
        if not text:
            return None
        stamp = message.fields.get(f"{self._name}Timestamp")
        if (text, stamp) == self._last and stamp is not None:
            return None
        self._last = (text, stamp)
        labels = (message.fields.get(f"{self._name}Leads") or "").split() or [""]
        values = _numbers(text, len(labels))[:, self._leads(labels)]
        if len(values) > self._longest:
            raise InvalidInputError(
                f"an ECG batch has {len(values)} samples a lead; needed at most {LONGEST_S:g} s of them: "
                "check its rate"
            )
        first_s = self._clock.first_s(len(values), seen_s)
        if stamp is not None:
            first_s = _number(stamp) - offset_s
        if not abs(first_s) <= limits.TIME_S:
            raise InvalidInputError(f"{self._name}Timestamp is '{stamp}'; needed seconds")
        return EcgSamples(first_s, values)

    def _leads(self, labels: list[str]) -> list[int]:
        """Choose the leads, again if their names change."""
        if labels != self._labels:
            channels = [Channel(label) for label in labels]
            self._chosen = choose_leads(f"the field {self._name}", channels, self._lead, declared=True)
            self._labels = labels
        return self._chosen


def _numbers(text: str, leads: int) -> FloatArray:
    """(n, leads)"""
    parts = text.replace(",", " ").replace(";", " ").split()
    if not parts or len(parts) > LONGEST or len(parts) % leads:
        raise InvalidInputError(f"an ECG batch has {len(parts)} values of {leads} leads")
    return plausible(np.array([_number(part) for part in parts]).reshape(-1, leads))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as exc:
        raise InvalidInputError(f"an ECG field holds '{text[:20]}'; needed numbers") from exc
