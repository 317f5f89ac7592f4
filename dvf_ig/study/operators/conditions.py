"""Conditions of the operators' tasks: whether the force is felt, and what is wrong with it."""

from dataclasses import dataclass, replace

NO_HAPTICS = "visual only"
HAPTICS = "visual + haptic"


@dataclass(frozen=True, slots=True)
class Condition:
    """One way to do a task.

    Attributes:
        name: in tables.
        haptic: the device's motors are on.
        beating: the heart beats; else it stands still at end-diastole.
        noise: factor on the operator's errors of depth.
        attends: the operator takes felt force for what it says of depth.
        registration_mm: error of the registration, a shift in a direction drawn by the operator's seed.
        phase_error: of the fixture's phase, in cycles.
        lag_s: from a force to its effect, unknown to the servo.
        wrong_organ: the fixture is another person's heart, centred on this one's.
    """

    name: str
    haptic: bool = True
    beating: bool = True
    noise: float = 1.0
    attends: bool = True
    registration_mm: float = 0.0
    phase_error: float = 0.0
    lag_s: float = 0.0
    wrong_organ: bool = False


STILL, BEATING = "still heart", "beating heart"
MONO_NOISE = 2.0
"""Depth is seen so much worse with one eye: assumed."""

CUTTING = tuple(
    Condition(f"{heart}, {name}", haptic=name == HAPTICS, beating=heart == BEATING)
    for heart in (STILL, BEATING)
    for name in (NO_HAPTICS, HAPTICS)
)
DISSECTION = tuple(
    Condition(f"{view}, {name}", haptic=name == HAPTICS, beating=False, noise=noise)
    for view, noise in (("mono", MONO_NOISE), ("stereo", 1.0))
    for name in (NO_HAPTICS, HAPTICS)
)
TRACKING = tuple(Condition(f"manual, {name}", haptic=name == HAPTICS) for name in (NO_HAPTICS, HAPTICS))

_REFERENCE = Condition(HAPTICS)
ABLATIONS = (
    Condition(NO_HAPTICS, haptic=False),
    _REFERENCE,
    replace(_REFERENCE, name="force not attended to", attends=False),
    Condition("doubled depth noise, visual only", haptic=False, noise=2.0),
    replace(_REFERENCE, name="doubled depth noise", noise=2.0),
    *(
        replace(_REFERENCE, name=f"registration error {mm} mm", registration_mm=float(mm))
        for mm in (1, 2, 3)
    ),
    *(
        replace(_REFERENCE, name=f"phase error {percent} %", phase_error=percent / 100)
        for percent in (5, 10, 50)
    ),
    *(replace(_REFERENCE, name=f"unknown lag {ms} ms", lag_s=ms / 1000) for ms in (5, 20, 40)),
    replace(_REFERENCE, name="wrong organ", wrong_organ=True),
)
"""Of cutting on the beating heart; the first two are its conditions."""
