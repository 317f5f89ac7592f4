"""An ECG of the Lab Streaming Layer (pylsl, optional); its stamps are converted to this machine's clock."""

import importlib
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from dvf_ig.core.errors import MissingDependencyError, install_extra
from dvf_ig.session import EcgSamples

from .batches import plausible

FIND_WITHIN_S = 5.0
CORRECT_EVERY_S = 5.0
MOST_SAMPLES = 1 << 16
GAP_SAMPLES = 1.5
"""Distance of stamps, in samples, from which they are a gap that starts a new batch."""


class LslEcg:
    """Reader of a stream, found by its name and searched again when it is lost.

    Args:
        name: name of the stream.
        rate_hz: samples a second.
        channels: channels that are leads; empty takes all.
        tell: called with messages about problems.
    Raises:
        MissingDependencyError: pylsl, or the library that it needs, is absent.
    """

    def __init__(
        self,
        name: str,
        rate_hz: float,
        channels: Sequence[int],
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._lsl = _pylsl()
        self._name, self._rate_hz, self._channels = name, rate_hz, list(channels)
        self._tell, self._clock = tell, clock
        self._inlet: Any = None
        self._correction_s, self._corrected_s = 0.0, float("-inf")

    def read(self) -> list[EcgSamples]:
        """Return samples since the last call; none while there is no such stream."""
        if self._inlet is None:
            self._find()
            return []
        try:
            if self._clock() - self._corrected_s > CORRECT_EVERY_S:
                self._correction_s, self._corrected_s = self._inlet.time_correction(2.0), self._clock()
            rows, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=MOST_SAMPLES)
        except (self._lsl.util.LostError, self._lsl.util.TimeoutError):
            self._tell(f"the LSL stream '{self._name}' is lost; searching for it again")
            self._inlet = None
            return []
        if not stamps:
            return []
        values = plausible(np.array(rows, dtype=np.float64))
        if self._channels:
            values = values[:, self._channels]
        offset_s = self._clock() - self._lsl.local_clock() + self._correction_s
        return batches(np.array(stamps) + offset_s, values, self._rate_hz)

    def _find(self) -> None:
        streams = self._lsl.resolve_byprop("name", self._name, 1, FIND_WITHIN_S)
        if not streams:
            self._tell(f"no LSL stream is named '{self._name}' yet")
            return
        info = streams[0]
        if max(self._channels, default=0) >= info.channel_count():
            self._tell(f"the LSL stream '{self._name}' has {info.channel_count()} channels")
            return
        self._inlet, self._corrected_s = self._lsl.StreamInlet(info, recover=False), float("-inf")


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
            f"an ECG of the Lab Streaming Layer needs pylsl and liblsl; {install_extra('lsl')}, "
            f"or let PLUS send the ECG as field data ({str(exc).splitlines()[0]})"
        ) from exc
