"""All that the files of one intervention say of each other."""

from collections.abc import Iterator

from dvf_ig.core.arrays import FloatArray
from dvf_ig.intake.agreement.clocks import clock_findings
from dvf_ig.intake.agreement.cycle import HeartInImages, cycle_findings
from dvf_ig.intake.agreement.finding import Finding
from dvf_ig.intake.agreement.names import name_findings
from dvf_ig.intake.agreement.places import place_findings
from dvf_ig.intake.agreement.units import unit_findings
from dvf_ig.intake.parts import SessionParts


def disagreements(
    parts: SessionParts, peaks_s: FloatArray, seen: HeartInImages | None
) -> tuple[Finding, ...]:
    """What does not agree, of the parts that there are; of a key that is refused nothing more is said.

    Args:
        peaks_s: (k,) R peaks of the ECG.
        seen: of the heart in the images.
    """
    found: list[Finding] = []
    for one in _all(parts, peaks_s, seen):
        if not any(other.refused and other.key == one.key for other in found):
            found.append(one)
    return tuple(found)


def _all(parts: SessionParts, peaks_s: FloatArray, seen: HeartInImages | None) -> Iterator[Finding]:
    yield from unit_findings(parts)
    yield from name_findings(parts)
    yield from clock_findings(parts, peaks_s)
    yield from cycle_findings(seen)
    yield from place_findings(parts)
