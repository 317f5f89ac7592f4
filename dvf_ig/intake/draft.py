"""A session's configuration that may still lack parts, as `config init` begins one and users go on."""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.intake.ecg_name import split_ecg
from dvf_ig.intake.schema import (
    SessionConfig,
    SessionDraft,
)
from dvf_ig.io.yaml_config import validated


def as_draft(config: SessionConfig) -> SessionDraft:
    """A complete configuration as one that need not be."""
    return SessionDraft.model_validate(config.model_dump(by_alias=True))


def complete(draft: SessionDraft) -> SessionConfig:
    """The same configuration, of which nothing that a registration needs is missing."""
    return SessionConfig.model_validate(draft.model_dump(by_alias=True))


@dataclass(frozen=True, slots=True)
class GivenFiles:
    """A lab's files, as a user names them from the working directory.

    Attributes:
        ultrasound: tracked images; the only file that is needed to begin with.
        ecg: as `gate` takes it, for example `edf:FILE`; `rate_hz` of a table without times; `ecg_start_s` is
            when its first sample was taken on the tracker's clock.
        probe, tip: what `calibrate -o` wrote, JSON or PLUS XML.
        latency: such a file, or seconds.
        tool: poses; `tool_name` as the recording names it.
        model, mr, labels, surfaces: the pre-operative heart; `organ_labels` inside the protected surface, of
            which `cavity_labels` are blood.
        start: mr_from_tracker; `landmarks` in the model and on the patient; `touched` points.
    """

    ultrasound: Path
    ecg: str | None = None
    rate_hz: float | None = None
    ecg_start_s: float | None = None
    probe: Path | None = None
    latency: str | None = None
    tip: Path | None = None
    tool: Path | None = None
    tool_name: str | None = None
    model: Path | None = None
    mr: Path | None = None
    labels: Path | None = None
    organ_labels: tuple[int, ...] | None = None
    cavity_labels: tuple[int, ...] | None = None
    surfaces: Path | None = None
    start: Path | None = None
    landmarks: tuple[Path, Path] | None = None
    touched: Path | None = None
    probe_name: str | None = None
    reference_name: str | None = None
    patient_id: str | None = None

    def draft(self, folder: Path | None = None) -> SessionDraft:
        """The configuration whose names of files begin at `folder`; None leaves them as the user gave them.

        Raises:
            InvalidInputError: a cine without labels, a rate without an ECG, or an empty name.
        """
        for option, value in (("--rate", self.rate_hz), ("--ecg-start", self.ecg_start_s)):
            if value is not None and self.ecg is None:
                raise InvalidInputError(f"{option} is of the recording that --ecg names; give --ecg, too")
        for option, values in (("--organ", self.organ_labels), ("--cavity", self.cavity_labels)):
            if values is not None and self.labels is None:
                raise InvalidInputError(f"{option} says what labels mean; give --labels, too")
        if self.mr is not None and (self.model, self.labels, self.surfaces) == (None, None, None):
            raise InvalidInputError(
                f"{self.mr} shows the heart but not where its surface is; give --labels LABELS (of "
                "end-diastole at least), or --model MODEL"
            )

        def name(path: Path | None) -> str | None:
            return None if path is None else _relative(path, folder)

        heart = {"model": self.model, "mr": self.mr, "labels": self.labels, "surfaces_folder": self.surfaces}
        files: dict[str, Any] = {key: name(path) for key, path in heart.items() if path is not None}
        meaning = {"organ_labels": self.organ_labels, "cavity_labels": self.cavity_labels}
        files |= {key: values for key, values in meaning.items() if values is not None}
        tool = self.tool if self.tool is not None or self.tool_name is None else self.ultrasound
        names = {"probe_name": self.probe_name, "reference_name": self.reference_name}
        of_ecg = {"rate_hz": self.rate_hz, "start_s": self.ecg_start_s}
        ecg = None if self.ecg is None else {"file": _spec(self.ecg, folder), **of_ecg}
        mr_points, patient_points = self.landmarks or (None, None)
        document = {
            "patient_id": self.patient_id,
            "preop": files or None,
            "ultrasound": {"file": name(self.ultrasound), **names},
            "ecg": ecg,
            "tool": None if tool is None else {"file": name(tool), "name": self.tool_name},
            "calibration": {
                "probe": name(self.probe),
                "latency": None if self.latency is None else _seconds_or_name(self.latency, folder),
                "tip": name(self.tip),
            },
            "start": {
                "transform": name(self.start),
                "landmarks_mr": name(mr_points),
                "landmarks_tracker": name(patient_points),
                "touched": name(self.touched),
            },
        }
        return validated(SessionDraft, document, Path("options"))


def _relative(path: Path, folder: Path | None) -> str:
    """Its name from a folder, with / between its parts wherever it was made."""
    if folder is None:
        return str(path)
    return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()


def _spec(spec: str, folder: Path | None) -> str:
    parts = split_ecg(spec)
    return f"{parts.prefix}{_relative(Path(parts.name), folder)}{parts.field}"


def _seconds_or_name(text: str, folder: Path | None) -> float | str:
    try:
        seconds = float(text)
    except ValueError:
        return _relative(Path(text), folder)
    return seconds if math.isfinite(seconds) else _relative(Path(text), folder)
