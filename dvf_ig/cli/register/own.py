"""A lab's own recordings as options of `dvf-ig register`: one option for each entry of a SESSION.yaml."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from dvf_ig.io import SessionRecordings

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", help="SESSION.yaml that names the recordings (see `dvf-ig config init`)."),
]
UltrasoundOption = Annotated[
    Path | None, typer.Option("--us", help="Tracked ultrasound, PLUS sequence (.igs.mha, .igs.nrrd).")
]
EcgOption = Annotated[
    str | None,
    typer.Option("--ecg", help="ECG as `gate` takes it (default: the one recorded with the ultrasound)."),
]
MrOption = Annotated[Path | None, typer.Option("--mr", "--cine", help="Cine series the model was made from.")]
LabelsOption = Annotated[
    Path | None,
    typer.Option("--labels", help="In place of --model: labels of the cine's end-diastole, or of all phases."),
]
OrganOption = Annotated[
    str | None, typer.Option("--organ", help="Label values inside the surface, for example 1,2,5.")
]
CavityOption = Annotated[str | None, typer.Option("--cavity", help="Label values of blood.")]
PatientOption = Annotated[
    str | None, typer.Option("--patient", help="Patient id (default: the model's, else the cine's name).")
]
ProbeOption = Annotated[
    Path | None,
    typer.Option("--probe", help="Probe calibration: JSON of `calibrate probe`, or PLUS XML."),
]
LagOption = Annotated[
    float | None, typer.Option("--lag-s", help="Latency in s: t_tracker = t_video + lag.")
]
LatencyOption = Annotated[
    Path | None, typer.Option("--latency", help="In place of --lag-s: JSON of `calibrate latency`.")
]
StartOption = Annotated[
    Path | None,
    typer.Option(
        "--start", "--init", help="Coarse mr_from_tracker (a pair: moving_from_fixed), ITK .tfm or .h5."
    ),
]
StartLandmarksOption = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        "--start-landmarks",
        metavar="MR TRACKER",
        help="The same points marked on the model and touched on the patient (.mrk.json, .fcsv).",
    ),
]
TouchedOption = Annotated[
    str | None,
    typer.Option(
        "--touched",
        metavar="POINTS[@PHASE]",
        help="Points touched all over the heart, frame tracker, at a place of the cycle (default: "
        "end-diastole). They start a registration, and check one that starts elsewhere.",
    ),
]
FanOption = Annotated[
    str | None,
    typer.Option(
        "--fan",
        metavar="COLUMN,ROW,START,STOP,ANGLE",
        help="Insonified sector: apex and radii in px, half angle in rad (default: found in the images).",
    ),
]


@dataclass(frozen=True, slots=True)
class OwnRecordings:
    """The options as they were given."""

    us: Path
    ecg: str | None = None
    rate_hz: float | None = None
    model: Path | None = None
    mr: Path | None = None
    labels: Path | None = None
    organ: str | None = None
    cavity: str | None = None
    patient: str | None = None
    probe: Path | None = None
    lag_s: float | None = None
    latency: Path | None = None
    start: Path | None = None
    landmarks: tuple[Path, Path] | None = None
    touched: str | None = None
    fan: str | None = None
    probe_name: str | None = None
    reference_name: str | None = None

    def read(self) -> "SessionRecordings":
        """Everything that the options name.

        Raises:
            typer.BadParameter: an option is missing, or two exclude each other.
            DvfIgError: a file is absent, cannot be read, or does not fit.
        """
        from dvf_ig.io import read_options

        return read_options(self._document())

    def _document(self) -> dict[str, Any]:
        """The same as the content of a SESSION.yaml."""
        self._require()
        touched, at, phase = (self.touched or "").rpartition("@")
        organ, cavity = (_values(t, o) for t, o in ((self.organ, "--organ"), (self.cavity, "--cavity")))
        return _given(
            patient_id=self.patient,
            preop=_given(
                model=self.model, mr=self.mr, labels=self.labels, organ_labels=organ, cavity_labels=cavity
            ),
            ultrasound=_given(
                file=self.us, probe_name=self.probe_name, reference_name=self.reference_name, fan=self._fan()
            ),
            ecg=None if self.ecg is None else _given(file=self.ecg, rate_hz=self.rate_hz),
            calibration=_given(
                probe=self.probe, latency=self.latency if self.lag_s is None else self.lag_s
            ),
            start=_given(
                transform=self.start,
                landmarks_mr=None if self.landmarks is None else self.landmarks[0],
                landmarks_tracker=None if self.landmarks is None else self.landmarks[1],
                touched=touched if at else self.touched,
                touched_phase=_fraction(phase) if at else None,
            ),
        )

    def _require(self) -> None:
        if self.model is not None and self.labels is not None:
            raise typer.BadParameter("give --model, or --labels from which one is built, not both")
        if self.model is None and self.labels is None:
            raise typer.BadParameter("whose heart? give --model MODEL, or --cine CINE with --labels LABELS")
        if self.probe is None:
            raise typer.BadParameter(
                "--us needs --probe FILE, the probe's calibration (dvf-ig calibrate probe … -o FILE)"
            )
        if (self.lag_s is None) == (self.latency is None):
            raise typer.BadParameter("give the latency of the video once: --lag-s SECONDS, or --latency JSON")
        if self.ecg is None and self.rate_hz is not None:
            raise typer.BadParameter("--rate is of the table that --ecg names; give --ecg, too")

    def _fan(self) -> dict[str, Any] | None:
        if self.fan is None:
            return None
        try:
            column, row, start, stop, angle = (float(part) for part in self.fan.split(","))
        except ValueError as exc:
            raise typer.BadParameter(
                f"--fan is '{self.fan}'; needed five numbers: column and row of the apex, first and last "
                "radius in px, half angle in rad"
            ) from exc
        return {"apex_px": [column, row], "start_px": start, "stop_px": stop, "half_angle_rad": angle}


def _given(**entries: Any) -> dict[str, Any] | None:
    """The entries that were given; None where none was."""
    plain = {k: str(v) if isinstance(v, Path) else v for k, v in entries.items()}
    return {k: v for k, v in plain.items() if v is not None} or None


def _values(text: str | None, option: str) -> tuple[int, ...] | None:
    from dvf_ig.cli.shell import whole_numbers

    return None if text is None else whole_numbers(text, option, "1,2,5")


def _fraction(text: str) -> float:
    try:
        return float(text)
    except ValueError as exc:
        raise typer.BadParameter(
            f"--touched: '{text}' is no place in the cycle; needed a fraction such as 0.0"
        ) from exc
