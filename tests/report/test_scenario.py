"""The preview of a scenario shows the pre-operative heart, the ultrasound and the ECG as recorded."""

import numpy as np

from dvf_ig.core import Scenario, Signal
from dvf_ig.report.scenario import ECG_S, FRAMES, PHASES, preview


def test_the_preview_shows_what_was_recorded(scenario: Scenario) -> None:
    assert scenario.ultrasound.images is not None
    axes = preview(scenario).axes
    assert len(axes) == 3 * PHASES + FRAMES + 1
    first = axes[3 * PHASES]
    np.testing.assert_array_equal(first.images[0].get_array(), scenario.ultrasound.images[0])
    trace = axes[-1].lines[0]
    assert isinstance(scenario.ecg, Signal)
    shown = scenario.ecg.t_s < scenario.ecg.start_s + ECG_S
    np.testing.assert_array_equal(trace.get_ydata(), scenario.ecg.samples[shown, 0])
    assert axes[-1].get_ylabel() == f"{scenario.ecg.leads[0]}, {scenario.ecg.unit}"
