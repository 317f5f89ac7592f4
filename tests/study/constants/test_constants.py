"""The table of constants: complete, and a constant that is varied is varied wherever it is used."""

import sys

from dvf_ig.registration.data import RegistrationOptions
from dvf_ig.registration.evidence import checks
from dvf_ig.study.constants.listing import registration_constants
from dvf_ig.study.constants.table import table_markdown
from dvf_ig.study.constants.varied import varied

CONSTANTS = {constant.label: constant for constant in registration_constants()}


def test_numbers_options_and_parts_of_values_are_listed_with_what_they_do() -> None:
    patch = CONSTANTS["data.RegistrationOptions.patch_mm"]
    assert (patch.value, patch.purpose) == (13.0, "edge of an LC2 patch.")
    assert CONSTANTS["lc2.lc2.PATCHES_PER_OBSERVATION"].value == 6.0
    assert "lc2.optimise.MAX_REJECTED" in CONSTANTS
    assert CONSTANTS["refine.FINE.cap_mm"].value == 2.0
    assert "101" in CONSTANTS["session.heart.MR_SMOOTHING_MM"].chosen_on
    assert not any(label.endswith("_") for label in CONSTANTS)


def test_a_varied_constant_is_another_wherever_it_was_imported_and_the_old_one_afterwards() -> None:
    constant = CONSTANTS["pose_chart.DISTINCT_MM"]
    importing = sys.modules["dvf_ig.registration.judge"]
    with varied(constant, 0.7) as value:
        assert value == importing.DISTINCT_MM == sys.modules[constant.module].DISTINCT_MM
        assert value == 0.7 * constant.value
    assert constant.value == importing.DISTINCT_MM


def test_a_varied_option_is_the_default_of_new_values() -> None:
    with varied(CONSTANTS["data.RegistrationOptions.starts"], 1.3) as value:
        assert RegistrationOptions().starts == value == 16
    assert RegistrationOptions().starts == 12


def test_limits_that_another_module_uses_follow() -> None:
    registering = sys.modules["dvf_ig.session.ultrasound.frame_registration"]
    with varied(CONSTANTS["evidence.checks.SLICE_LIMITS.z_score"], 1.3) as value:
        assert registering.SLICE_LIMITS.z_score == checks.SLICE_LIMITS.z_score == value
    assert registering.SLICE_LIMITS is checks.SLICE_LIMITS


def test_whole_numbers_stay_whole_and_change_by_one_at_least() -> None:
    constant = CONSTANTS["refine.FINE.steps"]
    with varied(constant, 0.7) as less:
        assert less == 21
    with varied(constant, 1.3) as more:
        assert more == 39
    with varied(CONSTANTS["volumes.SEARCH.candidates"], 0.7) as less:
        assert less == 1


def test_the_table_tells_what_a_change_does() -> None:
    constant = CONSTANTS["refine.FINE.cap_mm"]
    same = {"constant": "", "factor": 1.0, "tre_mm": [1.0, 2.0, 3.0], "refused_n": 0}
    more = {"constant": constant.label, "factor": 1.3, "tre_mm": [1.5, 2.5, None], "refused_n": 1}
    row = table_markdown([constant], [same, more]).splitlines()[-1]
    assert row.startswith("| `refine.FINE.cap_mm` | 2 |")
    assert row.endswith("|  | +0.00 mm, max 2.5; +1 refused |")
