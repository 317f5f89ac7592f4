"""`dvf-ig config`: begin, show and check the file that describes a lab's own recordings."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .register.own import CavityOption, EcgStartOption, OrganOption, PatientOption
from .shell import (
    EcgRateOption,
    JsonFlag,
    ProbeNameOption,
    ReferenceNameOption,
    command,
    emit,
    output_file,
    warn,
    whole_numbers,
    wrote,
)

if TYPE_CHECKING:
    from dvf_ig.intake.problem import Problem, Use
    from dvf_ig.intake.schema import SessionDraft
    from dvf_ig.intake.verdict import Verdict

app = typer.Typer(
    no_args_is_help=True,
    help="A lab's own recordings as one file, SESSION.yaml, for register and replay --config: begin it, show "
    "it, check it.",
)

PARTS = {
    "preop": "heart",
    "ultrasound": "ultrasound",
    "ecg": "ECG",
    "tool": "tool",
    "calibration.probe": "probe calibration",
    "calibration.latency": "latency",
    "calibration.tip": "tool tip",
    "start": "start",
}
OPTIONS = {
    "preop": "--model FILE, or --cine FILE --labels FILE, or --surfaces DIR",
    "ecg": "--ecg edf:FILE",
    "tool": "--tool FILE",
    "calibration.probe": "--probe FILE",
    "calibration.latency": "--latency FILE or SECONDS",
    "calibration.tip": "--tip FILE",
    "start": "--start FILE, or --landmarks MODEL PATIENT, or --touched FILE",
}


USES: "tuple[Use, Use]" = ("register", "replay")


SessionArgument = Annotated[Path, typer.Argument(help="SESSION.yaml, or a scenario folder.")]


def init(
    us: Annotated[Path, typer.Option("--us", help="Tracked ultrasound (.igs.mha, .igs.nrrd).")],
    output: Annotated[Path, typer.Option("-o", "--out", callback=output_file, help="SESSION.yaml to write.")],
    ecg: Annotated[
        str | None,
        typer.Option("--ecg", help="wfdb:, edf:, csv: or trigger:FILE; not needed where --us holds it."),
    ] = None,
    rate: EcgRateOption = None,
    ecg_start: EcgStartOption = None,
    probe: Annotated[
        Path | None, typer.Option("--probe", help="Probe calibration: our JSON, or a PLUS .xml.")
    ] = None,
    latency: Annotated[
        str | None, typer.Option("--latency", help="Latency of the images: file, or seconds.")
    ] = None,
    tip: Annotated[Path | None, typer.Option("--tip", help="Tool tip: our JSON, or a PLUS .xml.")] = None,
    tool: Annotated[
        Path | None, typer.Option("--tool", help="Poses of the tool, where --us does not hold them.")
    ] = None,
    tool_name: Annotated[
        str | None, typer.Option("--tool-name", help="The tool, as the recording names it.")
    ] = None,
    model: Annotated[Path | None, typer.Option("--model", help="Model of the heart (model build).")] = None,
    cine: Annotated[
        Path | None, typer.Option("--cine", "--mr", help="4-D MR or CT: with --labels, or beside --model.")
    ] = None,
    labels: Annotated[
        Path | None, typer.Option("--labels", help="Labels, 4-D or of end-diastole alone.")
    ] = None,
    organ: OrganOption = None,
    cavity: CavityOption = None,
    surfaces: Annotated[Path | None, typer.Option("--surfaces", help="Folder of surfaces.")] = None,
    start: Annotated[Path | None, typer.Option("--start", help="Coarse mr_from_tracker (.tfm).")] = None,
    landmarks: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            "--landmarks",
            "--start-landmarks",
            metavar="MODEL PATIENT",
            help="The same points in the model and on the patient: two files.",
        ),
    ] = None,
    touched: Annotated[
        Path | None, typer.Option("--touched", help="Points touched all over the heart's surface.")
    ] = None,
    probe_name: ProbeNameOption = None,
    reference_name: ReferenceNameOption = None,
    patient: PatientOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Begin a SESSION.yaml from a lab's files: look into each, say what is missing or does not fit.

    Exits 0 when `register` could run with it. Where something is still missing, the file is written
    with commented lines for it; where a file cannot be read or does not fit, nothing is written.
    """
    with command():
        from dvf_ig.intake.draft import GivenFiles
        from dvf_ig.intake.found import found
        from dvf_ig.intake.problem import in_options
        from dvf_ig.intake.verdict import begin_session
        from dvf_ig.intake.write import session_text
        from dvf_ig.io import write_text

        given = GivenFiles(
            ultrasound=us,
            ecg=ecg,
            rate_hz=rate,
            ecg_start_s=ecg_start,
            probe=probe,
            latency=latency,
            tip=tip,
            tool=tool,
            tool_name=tool_name,
            model=model,
            mr=cine,
            labels=labels,
            organ_labels=None if organ is None else whole_numbers(organ, "--organ", "1,2,5"),
            cavity_labels=None if cavity is None else whole_numbers(cavity, "--cavity", "2,4"),
            surfaces=surfaces,
            start=start,
            landmarks=landmarks,
            touched=touched,
            probe_name=probe_name,
            reference_name=reference_name,
            patient_id=patient,
        )
        draft, verdict = begin_session(given, output)
        told = found(verdict.parts)
        wrong = [p for p in (*verdict.unreadable, *verdict.misfits) if p.concerns("register")]
        if not wrong:
            write_text(output, session_text(draft, told))
        emit(_payload(output, verdict, told), _rows(output, verdict, told, OPTIONS), as_json=as_json)
        if wrong:
            _refuse([in_options(problem.sentence) for problem in wrong])
        wrote(output)
        for problem in verdict.misfits:
            warn(f"a replay cannot use {in_options(problem.sentence)}")
        _warn_of(verdict)
        lacking = [problem.key for problem in verdict.missing if problem.concerns("register")]
        if lacking:
            _refuse([f"{output} is written, but register cannot run yet; it lacks: {', '.join(lacking)}"])


def dump(session: SessionArgument, as_json: JsonFlag = False) -> None:
    """Print the complete configuration with every default, as YAML; saved beside the files it reads back."""
    with command():
        from dvf_ig.intake.write import dump_text

        config, _ = _read(session)
        if as_json:
            emit(config.model_dump(mode="json", by_alias=True), (), as_json=True)
        else:
            sys.stdout.write(dump_text(config))


def validate(
    session: SessionArgument,
    purpose: Annotated[
        Literal["register", "replay"] | None,
        typer.Option("--for", help="What it is to be used for (default: all that it names, for register)."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Open every file of a configuration and check that all fit; name each that does not, and what to do.

    Exits 0 when all is well, else 3 after one line for each problem.
    """
    with command():
        from dvf_ig.intake.found import found
        from dvf_ig.intake.problem import in_keys
        from dvf_ig.intake.verdict import judge_session

        config, folder = _read(session)
        verdict = judge_session(config, folder, str(session))
        told = found(verdict.parts)
        if not _wrong(verdict, purpose) and verdict.parts.recorded_calibrations:
            verdict = _calibrated(verdict, config, folder, str(session))
        emit(_payload(session, verdict, told), _rows(session, verdict, told, {}), as_json=as_json)
        wrong = _wrong(verdict, purpose)
        _warn_of(verdict)
        if wrong:
            _refuse([in_keys(problem.sentence) for problem in wrong])


app.command("init")(init)
app.command("dump")(dump)
app.command("validate")(validate)


def _read(session: Path) -> "tuple[SessionDraft, Path]":
    """The configuration, and the folder at which its names of files begin."""
    from dvf_ig.intake.draft import as_draft
    from dvf_ig.intake.read import read_session_draft
    from dvf_ig.intake.scenario.read import read_scenario_session

    if session.is_dir():
        return as_draft(read_scenario_session(session)), session
    return read_session_draft(session), session.parent


def _wrong(verdict: "Verdict", purpose: "Use | None") -> "list[Problem]":
    """What keeps the files from a purpose; without one, all that does not fit."""
    wrong = list(verdict.hindrances(purpose or "register"))
    if purpose is None:
        wrong += [problem for problem in verdict.misfits if problem not in wrong]
    return wrong


def _calibrated(verdict: "Verdict", config: "SessionDraft", folder: Path, named_by: str) -> "Verdict":
    """The same with what a replay would say of calibrations that are still recordings."""
    from dvf_ig.intake.draft import complete
    from dvf_ig.intake.fit import fit_of, parts_of
    from dvf_ig.intake.problem import ProblemList
    from dvf_ig.intake.read import read_recordings
    from dvf_ig.replay.calibrations import calibrate, calibrated

    problems = ProblemList()
    with problems.about("calibration"):
        recordings = read_recordings(complete(config), folder, named_by)
        done = calibrate(recordings.scenario, seed=0)
        fit = fit_of(parts_of(replace(recordings, scenario=calibrated(recordings.scenario, done))))
        return replace(verdict, misfits=fit.misfits, warnings=fit.warnings, seen=fit.seen)
    return replace(verdict, misfits=(*verdict.misfits, *problems.found))


def _warn_of(verdict: "Verdict") -> None:
    for found in verdict.warnings:
        warn(f"{found.key}: {found.sentence}")


def _readiness(use: "Use", verdict: "Verdict") -> str:
    keys = list(dict.fromkeys(problem.key for problem in verdict.hindrances(use)))
    return "can run" if not keys else f"cannot run yet: {', '.join(keys)}"


def _refuse(sentences: Sequence[str]) -> None:
    """Print one line for each problem, and end with the exit code of bad input."""
    for sentence in sentences:
        typer.secho(f"error: {sentence}", err=True, fg=typer.colors.RED)
    raise typer.Exit(3)


def _payload(path: Path, verdict: "Verdict", told: Mapping[str, str | None]) -> dict[str, Any]:
    kinds = {"unreadable": verdict.unreadable, "misfit": verdict.misfits, "missing": verdict.missing}
    return {
        "session": str(path),
        "parts": dict(told),
        "ready": {use: not verdict.hindrances(use) for use in USES},
        "problems": [
            {"key": p.key, "kind": kind, "hinders": p.hinders, "sentence": str(p.error)}
            for kind, problems in kinds.items()
            for p in problems
        ],
        "ecg_delay": None if verdict.seen is None else verdict.seen.values(),
        "warnings": [{"key": w.key, "cause": w.cause.name, "sentence": w.sentence} for w in verdict.warnings],
    }


def _rows(
    path: Path, verdict: "Verdict", told: Mapping[str, str | None], options: Mapping[str, str]
) -> list[tuple[str, ...]]:
    """What was found, what can be done with it, and what is missing, with the option that gives it."""
    wrong = [p.key for p in (*verdict.unreadable, *verdict.misfits)]
    rows = [("session", str(path))]
    for key, label in PARTS.items():
        text = told[key] or ("cannot be used" if any(k.startswith(key) for k in wrong) else "-")
        rows.append((label, text))
    if verdict.seen is not None:
        rows.append(("ECG and images", verdict.seen.sentence))
    rows += [(use, _readiness(use, verdict)) for use in USES]
    rows += [("missing", f"{p.error} ({options.get(p.key, p.key)})") for p in verdict.missing]
    return [*rows]
