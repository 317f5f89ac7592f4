"""An ECG among what PLUS sends: a STRING, or a field beside an image or a transform, with numbers in it.

With it may stand `<Name>Timestamp` (time of its first sample) and `<Name>Leads` (their names; samples then
alternate between leads), as in a recorded sequence (`dvf_ig.io.plus.ecg_field`).
"""

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.io import limits
from dvf_ig.live.igtl import Message, Text
from dvf_ig.session import EcgSamples

from .batches import BatchClock
from .values import plausible

LONGEST = 100_000
"""Values in one batch."""
LONGEST_S = 5.0
"""A batch is sent as it is taken: one this long is none."""


class EcgField:
    """Takes messages and gives the samples in them.

    Args:
        name: of the field or of the STRING's device.
        rate_hz: samples a second.
    """

    def __init__(self, name: str, rate_hz: float) -> None:
        self._name, self._clock = name, BatchClock(rate_hz)
        self._longest = round(LONGEST_S * rate_hz)
        self._last: tuple[str, str | None] | None = None

    def samples(self, message: Message, seen_s: float, offset_s: float) -> EcgSamples | None:
        """The samples of a message; None where it has none, or those of the message before.

        Args:
            seen_s: the message's stamp by the session's clock.
            offset_s: the peer's clock less the session's.
        Raises:
            InvalidInputError: a value or a time that is no number.
        """
        text = message.fields.get(self._name)
        if text is None and isinstance(message.content, Text) and message.device == self._name[:20]:
            text = message.content.text
        if not text:
            return None
        given = message.fields.get(f"{self._name}Timestamp")
        if (text, given) == self._last and given is not None:
            return None
        self._last = (text, given)
        leads = len((message.fields.get(f"{self._name}Leads") or "one").split())
        values = _numbers(text, leads)
        if len(values) > self._longest:
            raise InvalidInputError(
                f"an ECG batch has {len(values)} samples a lead; needed at most {LONGEST_S:g} s of them: "
                "check its rate"
            )
        first_s = self._clock.first_s(len(values), seen_s)
        if given is not None:
            first_s = _number(given) - offset_s
        if not abs(first_s) <= limits.TIME_S:
            raise InvalidInputError(f"{self._name}Timestamp is '{given}'; needed seconds")
        return EcgSamples(first_s, values)


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
