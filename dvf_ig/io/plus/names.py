"""Convert between PLUS coordinate-frame names and ours.

PLUS writes "ProbeToTracker" for the matrix that takes probe coordinates to tracker coordinates; here it is
tracker_from_probe. Frame names are camel case there, lower snake case here: "StylusTip" is "stylus_tip".
"""

import re
from dataclasses import dataclass

from dvf_ig.core import InvalidInputError, PoseStream, TrackedSequence
from dvf_ig.core.space.frames import check_frame

_TRANSFORM = re.compile(r"(.+?)To([A-Z].*)")
_WORD_START = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_NOT_WORD = re.compile(r"[^0-9A-Za-z]+")


def frame_from_plus(name: str) -> str:
    """Convert a PLUS name to a frame name: "StylusTip" → "stylus_tip".

    Raises:
        InvalidInputError: nothing usable is left, for example a name that starts with a digit.
    """
    return check_frame(_NOT_WORD.sub("_", _WORD_START.sub("_", name.strip())).strip("_").lower())


def frame_to_plus(frame: str) -> str:
    """Convert a frame name to a PLUS name: "stylus_tip" → "StylusTip".

    Raises:
        InvalidInputError: the name would read back as another one ("tool_2" would become "tool2").
    """
    name = "".join(part.capitalize() for part in check_frame(frame).split("_"))
    if not name or frame_from_plus(name) != frame:
        raise InvalidInputError(
            f"frame '{frame}' has no PLUS name that reads back; rename it, for example to "
            f"'{_NOT_WORD.sub('', frame)}'"
        )
    return name


def split_transform(name: str) -> tuple[str, str] | None:
    """Split "ProbeToTracker" into ("tracker", "probe"), target first; None for other names."""
    match = _TRANSFORM.fullmatch(name)
    return (frame_from_plus(match[2]), frame_from_plus(match[1])) if match else None


def join_transform(target: str, source: str) -> str:
    """Join ("tracker", "probe") to "ProbeToTracker".

    Raises:
        InvalidInputError: the joined name would be split differently when read.
    """
    name = f"{frame_to_plus(source)}To{frame_to_plus(target)}"
    if split_transform(name) != (target, source):
        raise InvalidInputError(f"{target}_from_{source} has no PLUS name that reads back; rename a frame")
    return name


def same_sensor(one: str, other: str) -> bool:
    """Return whether two names mean one sensor: "us_sensor", "UsSensor" and "ussensor" do."""
    return _plain(one) == _plain(other)


def _recorded_as(name: str, recorded: set[str]) -> str:
    """Return the sensor's name in a recording: the equal name, else one with the same letters."""
    matches = sorted(frame for frame in recorded if same_sensor(frame, name))
    return name if name in recorded or not matches else matches[0]


def _plain(name: str) -> str:
    return _NOT_WORD.sub("", name).replace("_", "").lower()


NAME_SETTINGS = ("ultrasound.probe_name", "ultrasound.reference_name")
"""Settings that say which of a recording's frames are meant."""


@dataclass(frozen=True, slots=True)
class ProbeNames:
    """Recorded names of the probe's sensor and of the sensor or tracker that its poses are relative to.

    Attributes:
        probe: frame of the probe.
        reference: frame of the reference; None uses "reference" if recorded, else "tracker".
    """

    probe: str = "probe"
    reference: str | None = None

    @classmethod
    def from_plus(cls, probe: str | None, reference: str | None) -> "ProbeNames":
        """Build from names in PLUS's spelling ("Probe", "StylusTip") or ours; None keeps the default."""
        try:
            return cls(
                "probe" if probe is None else frame_from_plus(probe),
                None if reference is None else frame_from_plus(reference),
            )
        except InvalidInputError as exc:
            raise InvalidInputError(str(exc), settings=NAME_SETTINGS) from exc

    def stream(self, sequence: TrackedSequence, held: str) -> PoseStream:
        """Return held_from_probe over time.

        Raises:
            InvalidInputError: the sequence does not connect the two frames.
        """
        recorded = {frame for s in sequence.poses.values() for frame in (s.target, s.source)}
        target, source = (_recorded_as(name, recorded) for name in (held, self.probe))
        try:
            return sequence.stream(target, source)
        except InvalidInputError as exc:
            raise InvalidInputError(f"{exc}; name what is meant", settings=NAME_SETTINGS) from exc


USUAL_NAMES = ProbeNames()
