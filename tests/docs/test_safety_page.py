"""The safety page states the hazards, states and limits that the supervisor has."""

import re
from pathlib import Path

from dvf_ig.guidance import HAZARD_RULES, Response, SupervisorState
from dvf_ig.guidance.supervision import supervisor
from dvf_ig.kernels.servo.layout import CLAMPS

PAGE = (Path(__file__).resolve().parents[2] / "dvf_ig/docs/theory/safety.md").read_text(encoding="utf-8")
FORCE = {
    Response.WARN: "given in full, with a warning",
    Response.SLOW: f"at most {supervisor.SLOW_SLEW_N_PER_S:g} N/s",
    Response.WALLS: f"guidance fades in {supervisor.FADE_S * 1000:g} ms, walls become those of the worst "
    "phase; without a wall all fades",
    Response.FADE: f"fades in {supervisor.FADE_S * 1000:g} ms",
    Response.FAST_FADE: f"fades in {supervisor.FAST_FADE_S * 1000:g} ms",
    Response.NO_FORCE: "zero at once",
}


def test_the_hazard_table_is_the_code_s() -> None:
    rows = re.findall(r"^\| `([A-Z_]+)` \| (.+) \| (.+) \| (.+) \|$", PAGE, re.MULTILINE)
    expected = [
        (str(hazard.name), rule.sentence, FORCE[rule.response], rule.latch.value)
        for hazard, rule in HAZARD_RULES.items()
    ]
    assert rows == expected


def test_every_state_has_its_row_and_its_place_in_the_diagram() -> None:
    diagram = PAGE.split("```")[1]
    for state in SupervisorState:
        assert f"\n| {state.name} | " in PAGE
        assert state.name in diagram


def test_the_limits_are_the_code_s() -> None:
    text = " ".join(PAGE.split())
    for stated in (
        f"stiffness × {supervisor.SLEW_SPEED_M_S:g} m/s",
        f"asks for {supervisor.REARM_BELOW_N:g} N or more",
        f"more than {supervisor.REARM_AGE_S:g} s old",
        f"raised cosine over {supervisor.REARM_RISE_S:g} s",
        f"latch after {supervisor.LATCH_AFTER_S:g} s share one second",
        f"within {supervisor.CLAMPS_WITHIN_S:g} s latch",
    ):
        assert stated in text
    assert CLAMPS == 10
    assert "ten within" in text
