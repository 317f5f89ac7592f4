"""A lab's own recordings as options of `dvf-ig register`: one option for each entry of a SESSION.yaml."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.agreement import require_agreement

from .kinds import START

if TYPE_CHECKING:
    from dvf_ig.intake.preop import PreopFiles
    from dvf_ig.intake.read import SessionRecordings

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
EcgStartOption = Annotated[
    float | None,
    typer.Option(
        "--ecg-start", help="When its first sample was taken, s on the tracker's clock (default: the file's)."
    ),
]
MrOption = Annotated[Path | None, typer.Option("--mr", "--cine", help="Cine series the model was made from.")]
LabelsOption = Annotated[
    Path | None,
    typer.Option(
        "--labels", help="In place of --model: labels of the cine's end-diastole, or of all phases."
    ),
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
LagOption = Annotated[float | None, typer.Option("--lag-s", help="Latency in s: t_tracker = t_video + lag.")]
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

OPTION_OF = {
    "preop.model": "--model",
    "preop.mr": "--mr",
    "preop.labels": "--labels",
    "preop.organ_labels": "--organ",
    "patient_id": "--patient",
    "ultrasound": "--us",
    "ultrasound.file": "--us",
    "ultrasound.fan": "--fan",
    "ecg": "--ecg",
    "ecg.file": "--ecg",
    "ecg.rate_hz": "--rate",
    "ecg.start_s": "--ecg-start",
    "calibration.probe": "--probe",
    "start.transform": "--start",
    "start.landmarks_mr": "--start-landmarks",
    "start.landmarks_tracker": "--start-landmarks",
    "start.touched": "--touched",
}
"""The option for each key of a SESSION.yaml; that of the latency is one of two."""


def read_recordings(us: Path | None, options: Mapping[str, Any]) -> "SessionRecordings":
    """Everything that the options name.

    Args:
        us: the ultrasound.
        options: by their names on the command line; None where they were not given.
    Raises:
        typer.BadParameter: an option is missing, or two exclude each other.
        DvfIgError: a file is absent, cannot be read, or does not fit; told by the options.
    """
    from dvf_ig.core import DvfIgError
    from dvf_ig.intake.read import read_options

    _require_enough(options)
    try:
        return require_agreement(read_options(document_of(us, options)), "register")
    except DvfIgError as error:
        raise type(error)(_by_options(str(error), options)) from error


def _by_options(sentence: str, options: Mapping[str, Any]) -> str:
    """A sentence with the options in place of the keys that it names."""
    latency = "--latency" if options["--lag-s"] is None else "--lag-s"
    sentence = sentence.removeprefix("options: ")
    for key, option in {**OPTION_OF, "calibration.latency": latency}.items():
        sentence = sentence.replace(f"({key})", f"({option})")
        if sentence.startswith(f"{key}: "):
            sentence = f"{option}: {sentence.removeprefix(f'{key}: ')}"
    return sentence


def read_heart(options: Mapping[str, Any]) -> "PreopFiles":
    """The pre-operative heart that the options name."""
    from dvf_ig.intake.preop import read_heart_options

    return read_heart_options(_heart(options) or {}, options["--patient"])


def _heart(options: Mapping[str, Any]) -> dict[str, Any] | None:
    return _given(
        model=options["--model"],
        mr=options["--mr"],
        labels=options["--labels"],
        organ_labels=_values(options["--organ"], "--organ"),
        cavity_labels=_values(options["--cavity"], "--cavity"),
    )


def document_of(us: Path | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """The same as the content of a SESSION.yaml."""
    landmarks = options["--start-landmarks"] or (None, None)
    latency = options["--latency"] if options["--lag-s"] is None else options["--lag-s"]
    return (
        _given(
            patient_id=options["--patient"],
            preop=_heart(options),
            ultrasound=_given(
                file=us,
                probe_name=options["--probe-name"],
                reference_name=options["--reference-name"],
                fan=_fan(options["--fan"]),
            ),
            ecg=_given(file=options["--ecg"], rate_hz=options["--rate"], start_s=options["--ecg-start"]),
            calibration=_given(probe=options["--probe"], latency=latency),
            start=_given(
                transform=options["--start"],
                landmarks_mr=landmarks[0],
                landmarks_tracker=landmarks[1],
                **_touched(options["--touched"]),
            ),
        )
        or {}
    )


def require_heart(options: Mapping[str, Any]) -> None:
    """Raise typer.BadParameter unless the options name one heart."""
    if options["--model"] is not None and options["--labels"] is not None:
        raise typer.BadParameter("give --model, or --labels from which one is built, not both")
    if options["--model"] is None and options["--labels"] is None:
        raise typer.BadParameter("whose heart? give --model MODEL, or --cine CINE with --labels LABELS")
    for option in ("--organ", "--cavity"):
        if options["--labels"] is None and options[option] is not None:
            raise typer.BadParameter(f"{option} says which of --labels are meant; a model knows its own")


def _require_enough(options: Mapping[str, Any]) -> None:
    require_heart(options)
    if options["--probe"] is None:
        raise typer.BadParameter(
            "--us needs --probe FILE, the probe's calibration (dvf-ig calibrate probe … -o FILE)"
        )
    if (options["--lag-s"] is None) == (options["--latency"] is None):
        raise typer.BadParameter("give the latency of the video once: --lag-s SECONDS, or --latency JSON")
    if str(options["--latency"]).lstrip("-").replace(".", "", 1).isdigit():
        raise typer.BadParameter("--latency names a JSON of `calibrate latency`; give seconds as --lag-s")
    for option in ("--rate", "--ecg-start"):
        if options["--ecg"] is None and options[option] is not None:
            raise typer.BadParameter(f"{option} is of the recording that --ecg names; give --ecg, too")
    if all(options[option] is None for option in START):
        raise typer.BadParameter(
            "--us needs a start: --start FILE.tfm, --start-landmarks MR TRACKER, or --touched POINTS"
        )


def _touched(text: str | None) -> dict[str, Any]:
    """POINTS or POINTS@PHASE; an @ may also be part of a file's name."""
    file, at, phase = (text or "").rpartition("@")
    if not at or Path(text or "").is_file():
        return {"touched": text}
    if not file:
        raise typer.BadParameter(f"--touched is '{text}'; needed a file of points before @")
    try:
        place = float(phase)
    except ValueError:
        place = -1.0
    if not 0.0 <= place < 1.0:
        raise typer.BadParameter(
            f"--touched: '{phase}' is no place in the cycle; needed a fraction from 0 to below 1"
        )
    return {"touched": file, "touched_phase": place}


def _fan(text: str | None) -> dict[str, Any] | None:
    if text is None:
        return None
    try:
        column, row, start, stop, angle = (float(part) for part in text.split(","))
    except ValueError as exc:
        raise typer.BadParameter(
            f"--fan is '{text}'; needed five numbers: column and row of the apex, first and last radius in "
            "px, half angle in rad"
        ) from exc
    return {"apex_px": [column, row], "start_px": start, "stop_px": stop, "half_angle_rad": angle}


def _given(**entries: Any) -> dict[str, Any] | None:
    """The entries that were given; None where none was."""
    plain = {k: str(v) if isinstance(v, Path) else v for k, v in entries.items()}
    return {k: v for k, v in plain.items() if v is not None} or None


def _values(text: str | None, option: str) -> tuple[int, ...] | None:
    from dvf_ig.cli.shell import whole_numbers

    return None if text is None else whole_numbers(text, option, "1,2,5")
