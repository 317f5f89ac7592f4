"""A recording is registered as well to the model's own surfaces as to the images it was built from."""

from dataclasses import replace

import pytest

from dvf_ig.core import Preop, Scenario
from dvf_ig.intake import cached_model
from dvf_ig.registration import target_errors_mm
from dvf_ig.replay import register_scenario


@pytest.mark.parametrize("with_mr", [False, True])
def test_a_recording_is_registered_to_a_model_alone(scenario: Scenario, *, with_mr: bool) -> None:
    """Without grey levels LC2 sees wall and blood alone: tuning seeds 101 and 102 gave 1.8 and 1.3 mm."""
    model, truth = cached_model(scenario.preop).model, scenario.truth
    assert truth is not None
    preop = Preop(scenario.preop.patient_id, mr=scenario.preop.mr if with_mr else None)
    result = register_scenario(replace(scenario, preop=preop), model=model)
    errors_mm = target_errors_mm(
        result.target_from_source, truth.mr_from_tracker[-1][1], truth.targets.points
    )
    assert result.stop.usable
    assert errors_mm.mean() < (2.0 if with_mr else 3.0)
