"""Streams of the Lab Streaming Layer (pylsl, optional); stamps are converted to this machine's clock."""

import importlib
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError, MissingDependencyError, install_extra
from dvf_ig.io.ecg.leads import Channel, choose_leads
from dvf_ig.session import EcgSamples

from .batches import plausible

FIND_WITHIN_S = 5.0
CORRECT_EVERY_S = 5.0
MOST_SAMPLES = 1 << 16
ECG_TYPES = ("ECG", "EKG")
GAP_SAMPLES = 1.5
"""Distance of stamps, in samples, from which they are a gap that starts a new batch."""


class LslStream:
    """Reader of a stream, found by its name and searched again when it is lost.

    Args:
        name: name of the stream.
        choose: returns the columns to use of these channels of a stream of this type, or raises
            InvalidInputError.
        tell: called with messages about problems.
    Raises:
        MissingDependencyError: pylsl, or the library that it needs, is absent.
    """

    def __init__(
        self,
        name: str,
        choose: Callable[[list[Channel], str], list[int]],
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._lsl = _pylsl()
        self._name, self._choose = name, choose
        self._tell, self._clock = tell, clock
        self._inlet: Any = None
        self._chosen: list[int] = []
        self._correction_s, self._corrected_s = 0.0, float("-inf")

    def read(self) -> tuple[FloatArray, FloatArray] | None:
        """Return (n,) stamps and (n, channels) samples since the last call; None without any."""
        if self._inlet is None:
            self._find()
            return None
        try:
            if self._clock() - self._corrected_s > CORRECT_EVERY_S:
                self._correction_s, self._corrected_s = self._inlet.time_correction(2.0), self._clock()
            rows, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=MOST_SAMPLES)
        except (self._lsl.util.LostError, self._lsl.util.TimeoutError):
            self._tell(f"the LSL stream '{self._name}' is lost; searching for it again")
            self._inlet = None
            return None
        if not stamps:
            return None
        values = plausible(np.array(rows, dtype=np.float64)[:, self._chosen])
        offset_s = self._clock() - self._lsl.local_clock() + self._correction_s
        return np.array(stamps) + offset_s, values

    def _find(self) -> None:
        streams = self._lsl.resolve_byprop("name", self._name, 1, FIND_WITHIN_S)
        if not streams:
            self._tell(f"no LSL stream is named '{self._name}' yet")
            return
        inlet = self._lsl.StreamInlet(streams[0], recover=False)
        try:
            info = inlet.info(FIND_WITHIN_S)
            self._chosen = self._choose(_channels(info), info.type())
        except (self._lsl.util.LostError, self._lsl.util.TimeoutError):
            self._tell(f"the LSL stream '{self._name}' does not describe itself; searching for it again")
        except InvalidInputError as error:
            self._tell(str(error))
        else:
            self._inlet, self._corrected_s = inlet, float("-inf")


class LslEcg:
    """Reader of an ECG stream.

    Args:
        name, tell, clock: as of `LslStream`.
        rate_hz: samples a second.
        lead: labels of the leads, separated by commas; None takes those that are named as an ECG, or every
            channel without a telling label if the stream's type is ECG.
    Raises:
        MissingDependencyError: pylsl, or the library that it needs, is absent.
    """

    def __init__(
        self,
        name: str,
        rate_hz: float,
        lead: str | None,
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        def choose(channels: list[Channel], kind: str) -> list[int]:
            return choose_leads(
                f"the LSL stream '{name}'", channels, lead, declared=kind.upper() in ECG_TYPES
            )

        self._stream, self._rate_hz = LslStream(name, choose, tell, clock), rate_hz

    def read(self) -> list[EcgSamples]:
        """Return samples since the last call; none while there is no such stream."""
        samples = self._stream.read()
        return [] if samples is None else batches(*samples, self._rate_hz)


def _channels(info: Any) -> list[Channel]:
    """Read label and unit of each channel; those without a label are counted from 1."""
    channels, element = list[Channel](), info.desc().child("channels").child("channel")
    for number in range(1, info.channel_count() + 1):
        label = element.child_value("label") or f"channel {number}"
        channels.append(Channel(label, element.child_value("unit")))
        element = element.next_sibling("channel")
    return channels


def batches(t_s: Any, values: Any, rate_hz: float) -> list[EcgSamples]:
    """Split samples into evenly sampled batches.

    Args:
        t_s: (n,) stamps; values: (n, leads).
    """
    cuts = np.flatnonzero(np.diff(t_s) > GAP_SAMPLES / rate_hz) + 1
    edges = [0, *cuts.tolist(), len(t_s)]
    return [EcgSamples(float(t_s[a]), values[a:b]) for a, b in pairwise(edges)]


def _pylsl() -> Any:
    try:
        return importlib.import_module("pylsl")
    except (ImportError, RuntimeError) as exc:
        raise MissingDependencyError(
            f"a stream of the Lab Streaming Layer needs pylsl and liblsl; {install_extra('lsl')}, "
            f"or let PLUS send it as field data ({str(exc).splitlines()[0]})"
        ) from exc
