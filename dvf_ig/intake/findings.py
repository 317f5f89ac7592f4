"""Disagreements of two files that cannot both be true, or hardly ever are: cause, key and numbers."""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from dvf_ig.core.errors import InvalidInputError

from .problems import Problem, Use


class Rule(NamedTuple):
    """Consequence of a cause.

    Attributes:
        refused: whether files with it cannot be used; else it is a warning.
        sentence: with names for the numbers.
        settings: keys that correct it.
    """

    refused: bool
    sentence: str
    settings: tuple[str, ...] = ()


class Disagreement(Enum):
    """Each value says what is wrong and what to do."""

    HEART_NOT_IN_MM = Rule(
        True,
        "the heart is {mm:.3g} mm long; a heart has 60 to 200 mm: its file is in another unit than mm (m, cm "
        "or inches?) or of something else; export it again in mm",
    )
    HEART_OF_UNUSUAL_SIZE = Rule(
        False,
        "the heart is {mm:.0f} mm long; a heart has 60 to 200 mm: check that the file is in mm, and that its "
        "labels or surfaces are those of the heart",
    )
    POSES_NOT_IN_MM = Rule(
        True,
        "every position of {stream} lies within {mm:.2g} mm of the origin, where no marker can be: the poses "
        "are in m, not mm; export them again in mm",
    )
    POSES_OUT_OF_REACH = Rule(
        True,
        "{stream} reaches {mm:.3g} mm; no tracker measures further than {most:g} mm: the poses are in "
        "another unit than mm, or damaged; export them again in mm",
    )
    STAMPS_NOT_IN_S = Rule(
        True,
        "{what} has one sample in {s:.3g} s; needed {least:g} to {most:g} s: its time stamps are in another "
        "unit (ms?); export them again in s",
    )
    TOOL_STILL = Rule(
        False,
        "{stream} moves by {mm:.2g} mm in the whole recording: the tool lies still, its pose is frozen, or "
        "it is in m; check that this is the recording of the tool at work",
    )
    HEART_DOES_NOT_BEAT = Rule(
        True,
        "the heart is the same in every phase: it does not beat, so that fixtures stand still while the "
        "patient's heart moves; build the model from every phase (model build --surfaces DIR, --labels "
        "SERIES, or --image CINE with the labels of one phase)",
    )
    TOOL_IS_PROBE = Rule(
        True, "its poses are those of the ultrasound probe, number for number; give the poses of the tool"
    )
    PROBE_AND_TOOL_EXCHANGED = Rule(
        True,
        "at this start {share:.0%} of the images' area is at the heart, by the tool's poses {other:.0%}: "
        "probe and tool look exchanged; exchange their names, here or in the recording itself",
        ("ultrasound.probe_name", "tool.name"),
    )
    TOOL_IS_PIVOT = Rule(
        True,
        "its poses are those of the pivot calibration, number for number; give the poses of the tool at work",
    )
    TIP_OUT_OF_REACH = Rule(
        True,
        "the tip lies {mm:.3g} mm from the tool's marker; no tool is longer than {most:g} mm: it is in "
        "another unit than mm; calibrate it again (dvf-ig calibrate pivot)",
    )
    TIP_NOT_IN_MM = Rule(
        True,
        "the tip lies {mm:.2g} mm from the tool's marker, where no tool ends: it is in m, not mm; calibrate "
        "it again (dvf-ig calibrate pivot)",
    )
    TIP_NEAR_MARKER = Rule(
        False, "the tip lies {mm:.2g} mm from the tool's marker: check that it was not calibrated in m"
    )
    IMAGE_FAR_FROM_PROBE = Rule(
        False,
        "the middle of the image lies {mm:.0f} mm from the probe's marker; check that the calibration is of "
        "this probe, and in mm",
    )
    OTHER_IMAGE_MAP = Rule(
        False,
        "the recording holds its own {name}, which places the image {mm:.3g} mm from where this calibration "
        "does; the calibration is used: check that it is the newer one, of this probe, depth and orientation",
    )
    OTHER_PATIENT = Rule(
        False,
        "the surfaces are of patient '{named}' by the names of their files, the session is of '{patient}'; "
        "check that this is one patient",
    )
    MR_IS_LABELS = Rule(
        True, "the grey levels (mr) and the labels are the same image; give the MR or CT itself as mr"
    )
    LABELS_ABSENT = Rule(
        False, "the labels {values} are named, but no voxel of any phase has them; check the values"
    )
    LANDMARKS_ARE_THE_SAME = Rule(
        True,
        "the points touched on the patient have the very coordinates of those on the model: both names lead "
        "to one set; give the points as the tracker measured them",
    )
    LANDMARKS_NOT_IN_MM = Rule(
        True, "by how far these landmarks are apart they are in {unit}, not mm; export them again in mm"
    )
    NAMES_EXCHANGED = Rule(
        True,
        "the landmarks fit the marked ones to {given:.0f} mm RMS as they are named, and to {mm:.1f} mm with "
        "{names} exchanged: the names are on each other's points in one of the two files; correct them",
    )
    LANDMARKS_OFF_HEART = Rule(
        True,
        "the landmarks marked on the model lie {mm:.0f} mm from the heart, all of them; mark them on this "
        "heart, in mm and LPS",
    )
    LANDMARKS_BESIDE_HEART = Rule(
        False,
        "a quarter of the landmarks marked on the model lie {mm:.0f} mm or more from its surfaces: the model "
        "is of another patient or scan than the images that they were marked in, or lacks the parts that "
        "they are on; check whose model this is",
    )
    INVERSE_START = Rule(
        True,
        "at this start {share:.0%} of the images' area is at the heart, with its inverse {other:.0%}: it is "
        "tracker_from_mr; give mr_from_tracker",
    )
    INVERSE_POSES = Rule(
        True,
        "by the poses as recorded {share:.0%} of the images' area is at the heart at this start, by their "
        "inverses {other:.0%}: the sequence holds probe_from_tracker under the name tracker_from_probe; "
        "export them again",
    )
    INVERSE_PROBE = Rule(
        True,
        "with this calibration {share:.0%} of the images' area is at the heart at this start, with its "
        "inverse {other:.0%}: it is image_from_probe; give probe_from_image",
    )
    START_FLIPPED = Rule(
        True,
        "at this start {share:.0%} of the images' area is at the heart, with x and y reversed {other:.0%}: "
        "the start is in RAS where it says LPS, or the reverse; write it again",
    )
    IMAGES_OFF_HEART = Rule(
        True,
        "at this start no image comes nearer to the heart than {mm:.0f} mm: the start is of another day, "
        "another tracker or reference, or the inverse; find it again",
    )
    TOOL_OFF_HEART = Rule(
        True,
        "at this start the tool's tip comes no nearer to the heart than {mm:.0f} mm: its poses are of "
        "another tracker, reference, day or unit than the ultrasound's, or the tip is wrong; record both "
        "together",
    )
    TOOL_FAR_FROM_HEART = Rule(
        False,
        "at this start the tool's tip comes no nearer to the heart than {mm:.0f} mm, where no fixture acts; "
        "check that this is the recording of the tool at work",
    )
    ECG_OF_ANOTHER_RATE = Rule(
        False,
        "the heart beats {bpm:.0f} times a minute by the ECG, {model_bpm:.0f} times by the model; check the "
        "ECG's sampling rate, and that both are of one patient",
    )
    ECG_OF_ANOTHER_RECORDING = Rule(
        True,
        "the heart in the images does not beat as this ECG says, at any delay: by the images' own cyclic "
        "motion it beats about {bpm:.0f} times a minute, at other times than the R peaks; the ECG is of "
        "another recording: give the one that was recorded with these images",
    )
    ECG_CLOCK_WRONG = Rule(
        True,
        "by the images' own cyclic motion the times of the ECG are {share:.0%} too {which}; check its "
        "sampling rate",
        ("ecg.rate_hz",),
    )
    LATENCY_SIGN = Rule(
        True,
        "by the images' own cyclic motion they are {ms:.0f} ms off, twice this latency: its sign is wrong "
        "(time of tracker = time of video + latency, negative if the tracker leads), or the ECG is off by as "
        "much",
    )
    LATENCY_SIGN_UNLIKELY = Rule(
        False,
        "the images change with the probe's motion as if the latency were the reverse of {ms:+.0f} ms: its "
        "sign seems wrong (time of tracker = time of video + latency, negative if the tracker leads)",
    )
    CINE_ORDER = Rule(
        True,
        "{order}, and by the images' own cyclic motion the ECG is {ms:.0f} ms {which}: the phases "
        "are not in the order from one R peak to the next; put the cine in that order and build the model "
        "again",
    )
    CINE_ORDER_UNUSUAL = Rule(
        False, "{order}; check that the cine's phases are in the order from one R peak to the next"
    )
    MR_OF_OTHER_ORDER = Rule(
        True,
        "the grey levels (mr) change most {share:.0%} of a cycle {which} than the model moves most: their "
        "phases are in another order than the model's; give the cine that the model was built from",
    )
    MODEL_OF_OTHER_CINE = Rule(
        True,
        "the model was built from another cine than these grey levels (mr), so that it may be another "
        "patient's; give the model of this cine, or say that both are of one patient",
        ("patient_id",),
    )
    ECG_LATE = Rule(
        True,
        "by the images' own cyclic motion the ECG is {ms:.0f} ms {which}: it is of another recording, or its "
        "times or the latency of the images are off; if it is of this recording, correct its times",
        ("ecg.start_s",),
    )
    ECG_PERHAPS_LATE = Rule(
        False,
        "by the images' own cyclic motion the ECG seems to be {ms:.0f} ms {which}; check that it is of this "
        "recording, its clock and the latency of the images",
    )
    ECG_DRIFTS = Rule(
        False,
        "by the images' own cyclic motion the ECG's clock drifts from theirs by {ms:.0f} ms within the "
        "recording; record both on one clock",
    )
    LITTLE_COMMON_TIME = Rule(
        False,
        "ECG and {what} share {share:.0%} of the time of the {what}; outside it no phase is known: check the "
        "clocks, and that the whole recordings were copied",
    )
    RECORD_ENDS_EARLY = Rule(
        False,
        "the live session's record was not finished, because its program was killed or its disk was full: "
        "what came after {s:.1f} s is not in it",
    )
    RECORD_LACKS_MESSAGES = Rule(
        False,
        "the live session's record lacks {count:.0f} messages, which came faster than the disk took them: "
        "answers after the first of them may differ from those that were given",
    )


@dataclass(frozen=True, slots=True)
class Finding:
    """One disagreement.

    Attributes:
        cause: of it.
        key: of the configuration, to be corrected.
        sentence: what a user reads.
        concerned: as `Problem.hinders`.
    """

    cause: Disagreement
    key: str
    sentence: str
    concerned: Use = "register"

    @property
    def problem(self) -> Problem:
        """The finding as a problem that prevents a use."""
        error = InvalidInputError(self.sentence, key=self.key, settings=self.cause.value.settings)
        return Problem(self.key, error, self.concerned)

    def concerns(self, use: Use) -> bool:
        """Whether it matters to a use; what matters to a registration matters to a replay."""
        return self.concerned in ("register", use)

    @property
    def refused(self) -> bool:
        """Whether files with it cannot be used; else it is a warning."""
        return self.cause.value.refused


def finding(cause: Disagreement, key: str, use: Use = "register", **numbers: float | str) -> Finding:
    """A finding with its numbers in its sentence."""
    return Finding(cause, key, cause.value.sentence.format(**numbers), use)
