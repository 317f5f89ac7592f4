"""A scenario folder as a session's configuration: the same files, by their names in the folder."""

from pathlib import Path

from dvf_ig.intake.ecg_name import split_ecg
from dvf_ig.intake.scenario.layout import CONFIG, TRUTH, ScenarioConfig
from dvf_ig.intake.schema import (
    CalibrationConfig,
    EcgConfig,
    LatencyConfig,
    NWireConfig,
    PivotConfig,
    PreopConfig,
    SessionConfig,
    StartConfig,
    ToolConfig,
    UltrasoundConfig,
)
from dvf_ig.io.file_within import path_within


def session_of_scenario(config: ScenarioConfig, folder: Path, *, truth: bool = True) -> SessionConfig:
    """The configuration of a scenario folder.

    Args:
        folder: is looked into for files that a scenario may lack.
        truth: name its truth where it has one.
    Raises:
        UnreadableFileError: the name of its phase times is none of a file in the folder.
    """
    files, preop = config.files, config.preop
    timing = path_within(folder, preop.timing, folder / CONFIG)
    return SessionConfig(
        name=config.name,
        preset=config.preset,
        seed=config.seed,
        patient_id=config.patient_id,
        preop=PreopConfig(
            mr=preop.mr,
            labels=preop.labels,
            label_names=preop.label_names,
            organ_labels=preop.organ_labels,
            surfaces_folder=preop.surfaces_folder if preop.surfaces else None,
            surfaces=preop.surfaces,
            surface=preop.surface,
            timing=preop.timing if timing.is_file() else None,
        ),
        ultrasound=UltrasoundConfig(
            file=files.ultrasound,
            fan=config.fan,
        ),
        ecg=EcgConfig(file=files.ecg if split_ecg(files.ecg).prefix else f"csv:{files.ecg}"),
        tool=ToolConfig(file=files.tool),
        calibration=CalibrationConfig(
            probe=NWireConfig(
                phantom="nwire",
                file=files.nwire,
                device_set=files.nwire_device_set,
                points=files.nwire_points,
            ),
            latency=LatencyConfig(
                tracker=files.latency_tracker, video=files.latency_video, lines=files.latency_lines
            ),
            tip=PivotConfig(pivot=files.pivot),
        ),
        start=StartConfig(
            transform=files.start,
            landmarks_mr=files.landmarks_mr,
            landmarks_tracker=files.landmarks_tracker,
        ),
        truth=TRUTH if truth and (folder / TRUTH).is_dir() else None,
    )
