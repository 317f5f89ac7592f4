"""The section `live` of a session.yaml: who sends, under which names, and where the ECG comes from.

live:
  host: 127.0.0.1                     # where PLUS or 3D Slicer is; as a server, the address to listen at
  port: 18944
  role: client                        # or server
  allow: []                           # addresses of peers that a server takes, in addition to this machine
  probe: ProbeToTracker               # device names, as PLUS or Slicer sends them
  tool: ToolToTracker
  reference: ReferenceToTracker       # leave out where poses are relative to what is to stand still
  image: Image_Tracker
  image_orientation: MF               # how the images come, if not as the probe was calibrated
  calibrated_orientation: MF          # only for a calibration that does not state it
  ecg: {field: EcgData, rate_hz: 500} # or {lsl: STREAM, rate_hz: 500}, or {tail: FILE.csv, rate_hz: 500}
  # ecg.lead: II                      # names of leads, separated by commas; default: all named as an ECG
  respiration: {marker: ChestToTracker}  # or {field: Pressure}, or {lsl: STREAM}
  # respiration.channel: pressure     # of a field or stream with several
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.io.calibration_files import read_image_orientation
from dvf_ig.io.yaml_config import KIND, Section

DeviceName = Annotated[str, Field(strict=True, min_length=1, max_length=64)]
Leads = Annotated[str, Field(strict=True, min_length=1)]
"""Names of leads, separated by commas, in place of those that are named as an ECG."""
RateHz = Annotated[float, Field(strict=True, ge=50.0, le=100_000.0)]
Orientation = Literal["MF", "UF", "MN", "UN"]


class EcgFieldConfig(Section):
    """An ECG among the frame fields or strings that PLUS sends, with the time of its last sample."""

    field: DeviceName = "EcgData"
    rate_hz: RateHz
    lead: Leads | None = None


class EcgStreamConfig(Section):
    """An ECG of the Lab Streaming Layer, by its stream's name."""

    lsl: DeviceName
    rate_hz: RateHz
    lead: Leads | None = None


class EcgTailConfig(Section):
    """An ECG in a file that grows: CSV with a line a sample, or EDF."""

    tail: Annotated[str, Field(strict=True, min_length=1)]
    rate_hz: RateHz
    lead: Leads | None = None


def _kind_of(*names: str) -> Callable[[Any], str]:
    """Kind of a section: the first of these keys that it states, else "field"."""

    def kind(value: Any) -> str:
        keys = set(value) if isinstance(value, dict) else set(getattr(value, "model_fields_set", ()))
        return KIND + next((name for name in names if name in keys), "field")

    return kind


EcgLive = Annotated[
    Annotated[EcgFieldConfig, Tag(f"{KIND}field")]
    | Annotated[EcgStreamConfig, Tag(f"{KIND}lsl")]
    | Annotated[EcgTailConfig, Tag(f"{KIND}tail")],
    Discriminator(_kind_of("lsl", "tail")),
]


BreathRateHz = Annotated[float, Field(strict=True, ge=2.0, le=100_000.0)]
"""Slower samples do not show a breath."""
Channel = Annotated[str, Field(strict=True, min_length=1)]
"""Name of a channel in place of the only one that is named as breathing is."""


class BreathMarkerConfig(Section):
    """A tracked marker on the chest, by its transform."""

    marker: DeviceName


class BreathFieldConfig(Section):
    """A channel of a ventilator or monitor among the frame fields or strings that PLUS sends.

    `rate_hz` spaces the samples of a message that holds several; the last was taken when it was stamped.
    """

    field: DeviceName
    rate_hz: BreathRateHz | None = None
    channel: Channel | None = None


class BreathStreamConfig(Section):
    """A channel of the Lab Streaming Layer, by its stream's name; its samples are stamped one by one."""

    lsl: DeviceName
    channel: Channel | None = None


BreathLive = Annotated[
    Annotated[BreathFieldConfig, Tag(f"{KIND}field")]
    | Annotated[BreathStreamConfig, Tag(f"{KIND}lsl")]
    | Annotated[BreathMarkerConfig, Tag(f"{KIND}marker")],
    Discriminator(_kind_of("lsl", "marker")),
]


class LiveConfig(Section):
    """Who sends what; see the module."""

    host: Annotated[str, Field(strict=True, min_length=1)] = "127.0.0.1"
    port: Annotated[int, Field(strict=True, ge=0, le=65535)] = 18944
    role: Literal["client", "server"] = "client"
    allow: tuple[str, ...] = ()
    probe: DeviceName = "ProbeToTracker"
    tool: DeviceName = "ToolToTracker"
    reference: DeviceName | None = None
    image: DeviceName = "Image_Tracker"
    image_orientation: Orientation = "MF"
    calibrated_orientation: Orientation | None = None
    ecg: EcgLive
    respiration: BreathLive | None = None

    @property
    def used_orientation(self) -> Orientation:
        """Orientation to which images are turned: the one that the probe was calibrated with."""
        return self.calibrated_orientation or "MF"


def require_orientation(live: LiveConfig, probe: object, folder: Path) -> None:
    """Compare the orientation of the images that the probe was calibrated with, with what `live` states.

    Args:
        live: who sends what.
        probe: file of the calibration; anything else is read from images that are turned to MF.
        folder: folder to which the file is relative.
    Raises:
        InvalidInputError: they differ, or neither states one and the images come in another one than MF.
    """
    key, stated = "live.calibrated_orientation", live.calibrated_orientation
    source = probe if isinstance(probe, str) else "a phantom's sweep"
    calibrated = read_image_orientation(folder / probe) if isinstance(probe, str) else "MF"
    if None not in (calibrated, stated) and stated != calibrated:
        raise InvalidInputError(
            f"{key} is {stated}, but calibration.probe ({source}) holds for images in {calibrated}: they "
            f"would be mirrored; remove {key}",
            key=key,
        )
    if calibrated is None and stated is None and live.image_orientation != "MF":
        raise InvalidInputError(
            f"images come in {live.image_orientation} (live.image_orientation), and {source} does not state "
            f"which images it calibrates; calibrate the probe again, or state {key}",
            key=key,
        )
