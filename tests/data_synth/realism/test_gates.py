"""The realism gates: each measured figure lies within its bounds."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import SimpleITK

from data_synth.heart.anatomy import PhantomAnatomy
from data_synth.heart.motion_report import MotionReport
from data_synth.heart.tissue import Tissue
from data_synth.realism import gates as realism
from data_synth.realism.gates import Gate, heart_gates, real_pair_gates
from data_synth.realism.motion import EARLY_SYSTOLE, beating_gates, block_matching_gates
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray


def failed(gates: list[Gate]) -> list[str]:
    return [f"{g.name}: {g.value:.4g} not in {g.low:.4g} … {g.high:.4g}" for g in gates if not g.passed]


@pytest.fixture(scope="module")
def myocardium() -> FloatArray:
    return realism.homogeneous()


@pytest.mark.parametrize("measured", [realism.speckle_gates, realism.texture_gates, realism.level_gates])
def test_homogeneous_myocardium(myocardium: FloatArray, measured: Callable[[FloatArray], list[Gate]]) -> None:
    assert failed(measured(myocardium)) == []


def test_blood_is_fully_developed_speckle_too() -> None:
    assert failed(realism.speckle_gates(realism.homogeneous(Tissue.LV_BLOOD))) == []


@pytest.mark.parametrize(
    "measured", [realism.contrast_gates, realism.attenuation_gates, realism.point_gates, block_matching_gates]
)
def test_physics(measured: Callable[[], list[Gate]]) -> None:
    assert failed(measured()) == []


def test_muscle_returns_less_where_its_wall_runs_along_the_beam() -> None:
    assert failed([realism.anisotropy_gate()]) == []


def test_speckle_follows_the_beating_wall(anatomy: PhantomAnatomy) -> None:
    assert failed(beating_gates(anatomy, EARLY_SYSTOLE["physiological"])) == []


def test_point_target_of_the_scenarios_probe() -> None:
    assert failed(realism.point_gates(SectorProbe(noise_db=-140.0))) == []


def test_slice_thickness() -> None:
    assert failed([realism.elevation_gate()]) == []


def test_scan_conversion_of_the_real_pair(data_dir: Path) -> None:
    names = ("UltrasonixCurvilinearBrightnessData", "UltrasonixCurvilinearScanConvertedData")
    polar, converted = (
        SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(data_dir / "plus-scanconv" / f"{name}.igs.mha")))
        for name in names
    )
    assert failed(real_pair_gates(polar, converted)) == []


def test_a_gate_that_is_missed_shows() -> None:
    report = MotionReport(0.6, 0.5, 0.3, 0.4, 0.15, 14.0, 13.9, 1e-3, 0.3, 1.2, 0.01)
    gates = heart_gates("physiological", report)
    assert [g.name for g in gates if not g.passed] == ["physiological: |det - 1| in the LV wall"]
    assert [g for g in heart_gates("paper5mm", replace(report, largest_lv_motion_mm=4.96)) if g.passed]
