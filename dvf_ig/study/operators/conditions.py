"""Conditions of the operators' tasks: whether the force is felt, and what is wrong with it."""

from dataclasses import dataclass, replace

NO_HAPTICS = "visual only"
HAPTICS = "visual + haptic"
UNATTENDED = "haptic, not attended to"
"""The force moves the hand, and the operator makes nothing of it: what the fixture does by itself."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One way to do a task.

    Attributes:
        name: in tables.
        haptic: the device's motors are on.
        beating: the heart beats; else it stands still at end-diastole.
        noise: factor on the operator's errors of depth.
        attends: the operator takes felt force for what it says of depth.
        foresight: factor on the share of the beat that the operator foresees.
        force_noise: factor on the errors of felt force, and on the least force that is felt.
        registration_mm: error of the registration, a shift in a direction drawn by the operator's seed.
        phase_error: of the fixture's phase, in cycles.
        lag_s: from a force to its effect; lag_known: the servo is told of it.
        wrong_organ: the fixture is another person's heart, centred on this one's.
    """

    name: str
    haptic: bool = True
    beating: bool = True
    noise: float = 1.0
    attends: bool = True
    foresight: float = 1.0
    force_noise: float = 1.0
    registration_mm: float = 0.0
    phase_error: float = 0.0
    lag_s: float = 0.0
    lag_known: bool = False
    wrong_organ: bool = False


STILL, BEATING = "still heart", "beating heart"
MONO, STEREO = "mono", "stereo"
MONO_NOISE = 2.0
"""Depth is seen so much worse with one eye: assumed."""


def _three(prefix: str, common: Condition) -> tuple[Condition, ...]:
    """Without force, with it, and with it while the operator makes nothing of it."""
    return (
        replace(common, name=f"{prefix}{NO_HAPTICS}", haptic=False),
        replace(common, name=f"{prefix}{HAPTICS}"),
        replace(common, name=f"{prefix}{UNATTENDED}", attends=False),
    )


TASKS = {
    "cutting": (
        *_three(f"{STILL}, ", Condition("", beating=False)),
        *_three(f"{BEATING}, ", Condition("")),
    ),
    "dissection": (
        *_three(f"{MONO}, ", Condition("", beating=False, noise=MONO_NOISE)),
        *_three(f"{STEREO}, ", Condition("", beating=False)),
    ),
    "tracking": _three("manual, ", Condition("")),
}
"""Conditions of each task."""

_REFERENCE = Condition(HAPTICS)
ABLATIONS = (
    *_three("", _REFERENCE),
    Condition("doubled depth noise, visual only", haptic=False, noise=2.0),
    replace(_REFERENCE, name="doubled depth noise", noise=2.0),
    replace(_REFERENCE, name="force felt 3 times as badly", force_noise=3.0),
    Condition("beat not foreseen, visual only", haptic=False, foresight=0.0),
    replace(_REFERENCE, name="beat not foreseen", foresight=0.0),
    *(replace(_REFERENCE, name=f"registration error {mm} mm", registration_mm=float(mm)) for mm in (1, 2, 3)),
    *(
        replace(_REFERENCE, name=f"phase error {percent} %", phase_error=percent / 100)
        for percent in (5, 10, 50)
    ),
    *(replace(_REFERENCE, name=f"unknown lag {ms} ms", lag_s=ms / 1000) for ms in (5, 10, 20)),
    replace(_REFERENCE, name="known lag 20 ms", lag_s=0.02, lag_known=True),
    replace(_REFERENCE, name="wrong organ", wrong_organ=True),
)
"""Of cutting on the beating heart; the first three are its conditions."""
