"""Whether a session's files can be used: what cannot be read, what does not fit, what is missing."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dvf_ig.intake.agreement.cycle import HeartInImages
from dvf_ig.intake.agreement.finding import Finding
from dvf_ig.intake.draft import GivenFiles
from dvf_ig.intake.examine import examine
from dvf_ig.intake.fit import fit_of
from dvf_ig.intake.fit_heart import preop_label_values
from dvf_ig.intake.missing import missing_parts
from dvf_ig.intake.named_files import named_files
from dvf_ig.intake.parts import SessionParts
from dvf_ig.intake.problem import Problem, Use
from dvf_ig.intake.schema import SessionDraft

FILE_OF = {"preop.organ_labels": "preop.labels", "preop.surface": "preop.surfaces_folder"}
"""Of keys that say what is in a file."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The parts that were read, and every problem that was found.

    Attributes:
        unreadable: files that are absent, damaged, of another kind, or calibrations that were refused.
        misfits: parts that cannot be used, or not together.
        missing: parts that are not named.
        warnings, seen: as of a `Fit`.
    """

    parts: SessionParts
    unreadable: tuple[Problem, ...]
    misfits: tuple[Problem, ...]
    missing: tuple[Problem, ...]
    warnings: tuple[Finding, ...]
    seen: HeartInImages | None

    def hindrances(self, use: Use) -> tuple[Problem, ...]:
        """What keeps these files from a use; a file that cannot be read hinders every use."""
        fit = (problem for problem in (*self.misfits, *self.missing) if problem.concerns(use))
        return (*self.unreadable, *fit)


def judge_session(config: SessionDraft, folder: Path, named_by: str) -> Verdict:
    """Open every file of a configuration and check that all fit.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
    """
    parts, unreadable = examine(config, folder, named_by)
    return _verdict(config, folder, parts, unreadable)


def begin_session(given: GivenFiles, output: Path) -> tuple[SessionDraft, Verdict]:
    """A configuration of the files that a user named, and what is to be said of them.

    Unless the user says otherwise, all labels of an image are taken as inside the protected surface.

    Args:
        output: the configuration's file; names in it begin at its folder.
    Raises:
        InvalidInputError: files that are of no use without another.
    """
    as_given, draft = given.draft(), given.draft(output.parent)
    parts, unreadable = examine(as_given, Path(), str(output))
    if draft.preop is not None and parts.preop is not None and not draft.preop.organ_labels:
        all_labels = {"organ_labels": preop_label_values(parts.preop.preop)}
        draft = draft.model_copy(update={"preop": draft.preop.model_copy(update=all_labels)})
    return draft, _verdict(as_given, Path(), parts, unreadable)


def _verdict(
    config: SessionDraft, folder: Path, parts: SessionParts, problems: tuple[Problem, ...]
) -> Verdict:
    """An ECG that is neither named nor in the ultrasound is missing, not unreadable."""
    absent = tuple(p for p in problems if p.key == "ecg" and config.ecg is None)
    files = {key: folder / name for key, name in named_files(config)}
    fit = fit_of(parts)
    misfits = tuple(_with_file(problem, files) for problem in fit.misfits)
    missing = (*absent, *missing_parts(parts, (*problems, *misfits)))
    unreadable = tuple(p for p in problems if p not in absent)
    return Verdict(parts, unreadable, misfits, missing, fit.warnings, fit.seen)


def _with_file(problem: Problem, files: Mapping[str, Path]) -> Problem:
    """The same with the name of the file that it is about, where there is one."""
    key = problem.key
    of_file = next((k for k in (key, f"{key}.file", FILE_OF.get(key)) if k in files), None)
    if of_file is None:
        return problem
    told = type(problem.error)(f"{files[of_file]}: {problem.error}")
    return Problem(of_file if of_file.startswith(key) else key, told, problem.hinders)
