"""Samples in PLUS messages: a STRING, or a field of an image or a transform, that holds numbers.

It may be accompanied by `<Name>Timestamp` (time of its first sample) and `<Name>Leads` (names of its
channels; samples then alternate between them), as in a recorded sequence (`dvf_ig.io.plus.ecg_field`).
"""

from collections.abc import Callable

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


class SampleField:
    """Reader of the samples in messages.

    Args:
        name: name of the field or of the STRING's device.
        choose: returns the columns to use of channels with these names, or raises InvalidInputError.
    """

    def __init__(self, name: str, choose: Callable[[list[str]], list[int]]) -> None:
        self.name = name
        self._choose = choose
        self._labels: list[str] = []
        self._chosen: list[int] = []
        self._last: tuple[str, str | None] | None = None

    def batch(self, message: Message, offset_s: float) -> tuple[float | None, FloatArray] | None:
        """Return the time of a message's first sample, if stated, and its (n, channels) samples.

        None if it has none, or repeats the previous ones.

        Args:
            offset_s: the peer's clock minus the session's.
        Raises:
            InvalidInputError: a value or a time that is not a number, or channels that `choose` refuses.
        """
        text = message.fields.get(self.name)
        if text is None and isinstance(message.content, Text) and message.device == self.name[:20]:
            text = message.content.text
        if not text:
            return None
        stamp = message.fields.get(f"{self.name}Timestamp")
        if (text, stamp) == self._last and stamp is not None:
            return None
        self._last = (text, stamp)
        labels = (message.fields.get(f"{self.name}Leads") or "").split() or [""]
        values = self._numbers(text, len(labels))[:, self._columns(labels)]
        if stamp is None:
            return None, values
        first_s = self._number(stamp) - offset_s
        if not abs(first_s) <= limits.TIME_S:
            raise InvalidInputError(f"{self.name}Timestamp is '{stamp}'; needed seconds")
        return first_s, values

    def _columns(self, labels: list[str]) -> list[int]:
        """Choose the channels, again if their names change."""
        if labels != self._labels:
            self._chosen = self._choose(labels)
            self._labels = labels
        return self._chosen

    def _numbers(self, text: str, channels: int) -> FloatArray:
        """Parse (n, channels) values."""
        parts = text.replace(",", " ").replace(";", " ").split()
        if not parts or len(parts) > LONGEST or len(parts) % channels:
            raise InvalidInputError(
                f"a batch of the field {self.name} has {len(parts)} values of {channels} channels"
            )
        return plausible(np.array([self._number(part) for part in parts]).reshape(-1, channels))

    def _number(self, text: str) -> float:
        try:
            return float(text)
        except ValueError as exc:
            raise InvalidInputError(f"the field {self.name} holds '{text[:20]}'; needed numbers") from exc


class EcgField:
    """Reader of the ECG samples in messages.

    Args:
        name: name of the field or of the STRING's device.
        rate_hz: samples a second.
        lead: names of the leads, separated by commas; None takes all but those that are named as something
            else.
    """

    def __init__(self, name: str, rate_hz: float, lead: str | None = None) -> None:
        self._lead, self._clock = lead, BatchClock(rate_hz)
        self._field = SampleField(name, self._leads)
        self._longest = round(LONGEST_S * rate_hz)

    def samples(self, message: Message, seen_s: float, offset_s: float) -> EcgSamples | None:
        """Return the samples of a message; None if it has none, or repeats the previous ones.

        Args:
            seen_s: the message's stamp by the session's clock.
            offset_s: the peer's clock minus the session's.
        Raises:
            InvalidInputError: as `SampleField.batch`, or more samples than LONGEST_S holds.
        """
        batch = self._field.batch(message, offset_s)
        if batch is None:
            return None
        stated_s, values = batch
        if len(values) > self._longest:
            raise InvalidInputError(
                f"an ECG batch has {len(values)} samples a lead; needed at most {LONGEST_S:g} s of them: "
                "check its rate"
            )
        first_s = self._clock.first_s(len(values), seen_s)
        return EcgSamples(first_s if stated_s is None else stated_s, values)

    def _leads(self, labels: list[str]) -> list[int]:
        channels = [Channel(label) for label in labels]
        return choose_leads(f"the field {self._field.name}", channels, self._lead, declared=True)
