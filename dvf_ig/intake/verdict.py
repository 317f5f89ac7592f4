"""Whether a session's files can be used: what cannot be read, what does not fit, what is missing."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .draft import draft_config
from .findings import Finding
from .fit import fit_of
from .heart_in_images import HeartInImages
from .parts import SessionFiles, missing_parts
from .preop import preop_label_values
from .problems import Problem, ProblemList, Use
from .schema import SessionConfig
from .session import examine


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The parts that were read, and every problem that was found.

    Attributes:
        unreadable: files that are absent, damaged, of another kind, or calibrations that were refused.
        misfits: parts that cannot be used, or not together.
        missing: parts that are not named.
        warnings, seen: as of a `Fit`.
    """

    files: SessionFiles
    unreadable: tuple[Problem, ...]
    misfits: tuple[Problem, ...]
    missing: tuple[Problem, ...]
    warnings: tuple[Finding, ...]
    seen: HeartInImages | None

    def hindrances(self, use: Use) -> tuple[Problem, ...]:
        """Problems that prevent a use; a file that cannot be read prevents every use."""
        fit = (problem for problem in (*self.misfits, *self.missing) if problem.concerns(use))
        return (*self.unreadable, *fit)


def judge_session(config: SessionConfig, folder: Path, named_by: str) -> Verdict:
    """Open every file of a configuration and check that all fit.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
    """
    return _verdict(config, *examine(config, folder, named_by))


def begin_session(given: Mapping[str, Any], output: Path) -> tuple[SessionConfig, Verdict]:
    """A configuration of the files that options name, and what is to be said of them.

    Unless the user says otherwise, all labels of an image are taken as inside the protected surface.

    Args:
        given: values of the options of `config init` by their keys (`draft_config`).
        output: the configuration's file; names in it begin at its folder.
    Raises:
        InvalidInputError: options that need another.
    """
    as_given, draft = draft_config(given), draft_config(given, output.parent)
    files, problems = examine(as_given, Path(), str(output))
    if draft.preop is not None and files.preop is not None and not draft.preop.organ_labels:
        all_labels = {"organ_labels": preop_label_values(files.preop.preop)}
        draft = draft.model_copy(update={"preop": draft.preop.model_copy(update=all_labels)})
    return draft, _verdict(as_given, files, problems)


def _verdict(config: SessionConfig, files: SessionFiles, problems: ProblemList) -> Verdict:
    """An ECG that is neither named nor in the ultrasound is missing, not unreadable."""
    absent = tuple(p for p in problems.items if p.key == "ecg" and config.ecg is None)
    fit = fit_of(files)
    wrong = ProblemList([*problems.items, *fit.misfits])
    missing = missing_parts(files, wrong)
    unreadable = tuple(p for p in problems.items if p not in absent)
    return Verdict(files, unreadable, fit.misfits, (*absent, *missing), fit.warnings, fit.seen)
