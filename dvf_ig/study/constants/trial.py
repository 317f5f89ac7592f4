"""One trial: tuning cases registered with one constant larger or smaller than it is."""

from dataclasses import dataclass

from dvf_ig.core import DvfIgError
from dvf_ig.study.trials import Line, Settings

from .listing import Constant, registration_constants
from .subjects import PREPARING, Case, Subject, cases_of, subject_of
from .varied import varied

FACTORS = (0.7, 1.3)


@dataclass(frozen=True, slots=True)
class Variation:
    """What one trial changes: `constant` by `factor`, or nothing."""

    subject: Subject
    constant: Constant | None = None
    factor: float = 1.0


def variations() -> list[Variation]:
    """Of every trial: for each subject none at first, then its constants, each smaller and larger."""
    constants = registration_constants()
    return [
        variation
        for subject in Subject
        for variation in (
            Variation(subject),
            *(
                Variation(subject, constant, factor)
                for constant in constants
                if subject_of(constant) is subject
                for factor in FACTORS
            ),
        )
    ]


def constant_trial(settings: Settings, number: int) -> Line:
    """Register the tuning cases with one constant changed.

    Args:
        settings: `hearts`, how many tuning hearts, or brains.
        number: place in `variations`.
    """
    variation = variations()[number]
    cases = cases_of(variation.subject, settings["hearts"])
    constant, line = variation.constant, {"subject": variation.subject, "factor": variation.factor}
    if constant is None:
        return {**line, "constant": "", **_measured(cases, anew=False)}
    with varied(constant, variation.factor) as value:
        found = _measured(cases, anew=constant.label.startswith(PREPARING))
    return {**line, "constant": constant.label, "value": value, **found}


def _measured(cases: tuple[Case, ...], *, anew: bool) -> Line:
    """Mean errors of all cases, and how many poses were refused."""
    errors: list[float | None] = []
    refused = 0
    for case in cases:
        try:
            result = case.register(anew)
        except DvfIgError:
            errors.append(None)
            refused += 1
            continue
        errors.append(case.error_mm(result.target_from_source))
        refused += not result.stop.usable
    return {"tre_mm": errors, "refused_n": refused}
