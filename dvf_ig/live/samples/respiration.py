"""Breathing in a live session: a channel in PLUS messages, or a stream of the Lab Streaming Layer.

A tracked marker on the chest comes as the other poses do (`dvf_ig.live.events`).
"""

import time
from collections.abc import Callable

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.io.ecg.leads import Channel
from dvf_ig.io.respiration import choose_channel
from dvf_ig.live.igtl import Message
from dvf_ig.session import RespirationSample

from .field import SampleField
from .lsl import LslStream

NAME_IT = "name it as live.respiration.channel"


class BreathField:
    """Reader of the samples of breathing in messages.

    Args:
        name: name of the field or of the STRING's device.
        rate_hz: samples a second of messages that hold several.
        channel: name of the channel; None takes the only one that is named as breathing is.
    """

    def __init__(self, name: str, rate_hz: float | None = None, channel: str | None = None) -> None:
        def choose(labels: list[str]) -> list[int]:
            return [choose_channel(f"the field {name}", tuple(labels), channel, NAME_IT)]

        self._field, self._rate_hz = SampleField(name, choose), rate_hz

    def samples(self, message: Message, seen_s: float, offset_s: float) -> list[RespirationSample]:
        """Return the samples of a message, the last of which was taken at `seen_s` unless it states times.

        Args:
            seen_s: the message's stamp by the session's clock.
            offset_s: the peer's clock minus the session's.
        Raises:
            InvalidInputError: as `SampleField.batch`; several samples, and no rate is known.
        """
        batch = self._field.batch(message, offset_s)
        if batch is None:
            return []
        first_s, values = batch
        if len(values) > 1 and self._rate_hz is None:
            raise InvalidInputError(
                f"a message of the field {self._field.name} has {len(values)} samples; state how many are "
                "taken a second as live.respiration.rate_hz"
            )
        step_s = 0.0 if self._rate_hz is None else 1.0 / self._rate_hz
        if first_s is None:
            first_s = seen_s - (len(values) - 1) * step_s
        return finite_samples(first_s + step_s * np.arange(len(values), dtype=np.float64), values)


class LslBreath:
    """Reader of a stream of breathing.

    Args:
        name: name of the stream.
        channel: label of its channel; None takes the only one that is named as breathing is.
        tell, clock: as of `LslStream`.
    Raises:
        MissingDependencyError: pylsl, or the library that it needs, is absent.
    """

    def __init__(
        self,
        name: str,
        channel: str | None,
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        def choose(channels: list[Channel], _: str) -> list[int]:
            labels = tuple(one.label for one in channels)
            return [choose_channel(f"the LSL stream '{name}'", labels, channel, NAME_IT)]

        self._stream = LslStream(name, choose, tell, clock)

    def read(self) -> list[RespirationSample]:
        """Return samples since the last call; none while there is no such stream."""
        samples = self._stream.read()
        return [] if samples is None else finite_samples(*samples)


def finite_samples(t_s: FloatArray, values: FloatArray) -> list[RespirationSample]:
    """Make events of (n,) times and (n, channels) values; missing values are left out."""
    finite = np.isfinite(values).all(axis=1)
    return [
        RespirationSample(t, value) for t, value in zip(t_s[finite].tolist(), values[finite], strict=True)
    ]
