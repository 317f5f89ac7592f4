"""PLUS coordinate-frame names and ours.

PLUS writes "ProbeToTracker" for the matrix that takes probe coordinates to tracker coordinates; here it is
tracker_from_probe. Frame names are camel case there, lower snake case here: "StylusTip" is "stylus_tip".
"""

import re
from dataclasses import dataclass

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.recordings.sequence import TrackedSequence
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.frames import check_frame

_TRANSFORM = re.compile(r"(.+?)To([A-Z].*)")
_WORD_START = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_NOT_WORD = re.compile(r"[^0-9A-Za-z]+")


def frame_from_plus(name: str) -> str:
    """ "StylusTip" → "stylus_tip".

    Raises:
        InvalidInputError: nothing usable is left, for example a name that starts with a digit.
    """
    return check_frame(_NOT_WORD.sub("_", _WORD_START.sub("_", name.strip())).strip("_").lower())


def frame_to_plus(frame: str) -> str:
    """ "stylus_tip" → "StylusTip".

    Raises:
        InvalidInputError: the name would come back as another one ("tool_2" would be read as "tool2").
    """
    name = "".join(part.capitalize() for part in check_frame(frame).split("_"))
    if not name or frame_from_plus(name) != frame:
        raise InvalidInputError(
            f"frame '{frame}' has no PLUS name that reads back; rename it, for example to "
            f"'{_NOT_WORD.sub('', frame)}'"
        )
    return name


def split_transform(name: str) -> tuple[str, str] | None:
    """ "ProbeToTracker" → ("tracker", "probe"), target first; None where the name is no transform's."""
    match = _TRANSFORM.fullmatch(name)
    return (frame_from_plus(match[2]), frame_from_plus(match[1])) if match else None


def join_transform(target: str, source: str) -> str:
    """("tracker", "probe") → "ProbeToTracker".

    Raises:
        InvalidInputError: the joined name would be split elsewhere when read.
    """
    name = f"{frame_to_plus(source)}To{frame_to_plus(target)}"
    if split_transform(name) != (target, source):
        raise InvalidInputError(f"{target}_from_{source} has no PLUS name that reads back; rename a frame")
    return name


def same_sensor(one: str, other: str) -> bool:
    """Whether two names are one sensor's: "us_sensor", "UsSensor" and "ussensor" are."""
    return _plain(one) == _plain(other)


def _recorded_as(name: str, recorded: set[str]) -> str:
    """The same sensor's name in a recording, which goes by the letters where no name is equal."""
    alike = sorted(frame for frame in recorded if same_sensor(frame, name))
    return name if name in recorded or not alike else alike[0]


def _plain(name: str) -> str:
    return _NOT_WORD.sub("", name).replace("_", "").lower()


NAME_SETTINGS = ("ultrasound.probe_name", "ultrasound.reference_name")
"""Settings that say which of a recording's frames are meant."""


@dataclass(frozen=True, slots=True)
class ProbeNames:
    """What a recording calls the probe's sensor and the sensor or tracker that its poses are relative to.

    Attributes:
        probe: frame of the probe.
        reference: frame of the reference; None takes "reference" where it is recorded, else "tracker".
    """

    probe: str = "probe"
    reference: str | None = None

    @classmethod
    def from_plus(cls, probe: str | None, reference: str | None) -> "ProbeNames":
        """From names as PLUS writes them ("Probe", "StylusTip") or as here; None keeps the default."""
        try:
            return cls(
                "probe" if probe is None else frame_from_plus(probe),
                None if reference is None else frame_from_plus(reference),
            )
        except InvalidInputError as exc:
            raise InvalidInputError(str(exc), settings=NAME_SETTINGS) from exc

    def stream(self, sequence: TrackedSequence, held: str) -> PoseStream:
        """held_from_probe over time.

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
