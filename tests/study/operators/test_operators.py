"""Operators on a small beating ball: the force keeps them out; what is wrong with it leads them astray."""

from dataclasses import replace

import numpy as np
import pytest
from toy_sphere import sphere

from data_synth.operator.contact import MovingSurface
from data_synth.operator.contact_sites import Site
from dvf_ig.core import CycleTiming, FloatArray, InvalidInputError, SurfaceSeries, ToolTruth
from dvf_ig.guidance import Evaluator, Gaussian, Sigmoid
from dvf_ig.preop import ModelOptions, model_from_surfaces
from dvf_ig.study.operators import lesion, paper, pellets
from dvf_ig.study.operators.closed_loop import (
    ABLATIONS,
    HAPTICS,
    NO_HAPTICS,
    TASKS,
    UNATTENDED,
    Condition,
    OperatingHeart,
    Trace,
    learnt_force,
    moving_line,
)
from dvf_ig.study.operators.figure import Compared, Curve, Interval, OperatorsFigure, Panel, operators_figure
from dvf_ig.study.operators.lesion import ablate, distance_to_line, lesion_measures
from dvf_ig.study.operators.pellets import (
    count_excursions,
    cut,
    cutting_measures,
    dissect,
    dissection_measures,
    pellet_trial,
)
from dvf_ig.study.operators.study import assumptions
from dvf_ig.study.operators.summary import difference, summarise_operators
from dvf_ig.study.operators.tables import operators_subjects, paper_table, training_tables
from dvf_ig.study.operators.tasks import (
    track,
    tracking_measures,
)

CENTER = np.array([10.0, -5.0, 3.0])
RADIUS_MM = 45.0


class Ball:
    """Drawn back by up to 3 mm once a cycle."""

    def __init__(self) -> None:
        self.unit, self.surface_triangles = sphere(1.0, 4)

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return np.asarray(CENTER + self.unit * (RADIUS_MM - 3.0 * np.sin(np.pi * model_phase) ** 2))


@pytest.fixture(scope="module")
def heart() -> OperatingHeart:
    ball = Ball()
    timing = CycleTiming.uniform(8, 0.6)
    vertices = np.stack([ball.surface_vertices(phase) for phase in timing.fractions])
    series = SurfaceSeries("EPICARDIAL", "mr", vertices, ball.surface_triangles, timing, "ball")
    model = model_from_surfaces(series, options=ModelOptions(knot_spacing_mm=6.0, margin_mm=18.0))
    return OperatingHeart(MovingSurface.of(ball), model)


@pytest.fixture(scope="module")
def cuts(heart: OperatingHeart) -> dict[str, list[dict[str, float]]]:
    """Two operators push three pellets into the beating ball."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pellets, "PELLETS", 3)
        wanted = (*ABLATIONS[:3], Condition("shifted", registration_mm=3.0))
        return {c.name: [cutting_measures(cut(heart, c, seed)) for seed in (1, 2)] for c in wanted}


def test_the_force_keeps_pellets_at_their_depth(cuts: dict[str, list[dict[str, float]]]) -> None:
    for without, felt, unattended in zip(cuts[NO_HAPTICS], cuts[HAPTICS], cuts[UNATTENDED], strict=True):
        assert without["largest_force_n"] == 0.0
        assert felt["pellets"] == 3.0
        assert 0.1 < felt["largest_force_n"] <= 0.6
        assert felt["largest_excess_mm"] < 0.6
        assert unattended["depth_rms_mm"] < without["depth_rms_mm"]
        assert felt["withheld_s"] == 0.0
    rms = {name: np.mean([one["depth_rms_mm"] for one in both]) for name, both in cuts.items()}
    assert rms[HAPTICS] < 0.6 * rms[NO_HAPTICS]
    deepest = {name: max(one["largest_excess_mm"] for one in both) for name, both in cuts.items()}
    assert deepest["shifted"] > deepest[HAPTICS] + 1.0, "a shifted fixture lets them in"


def test_guidance_helps_a_hand_to_follow_the_beat(heart: OperatingHeart) -> None:
    normal = np.array([0.6, -0.64, 0.48])
    place = Site(CENTER + RADIUS_MM * normal, normal, np.array([0.0, 0.6, 0.8]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.study.operators.tasks.CYCLES", 8)
        alone, helped = (tracking_measures(track(heart, place, c, 3)) for c in TASKS["tracking"][:2])
    assert helped["mean_mm"] < 0.5 * alone["mean_mm"]
    assert alone["largest_force_n"] == 0.0


def test_a_lesion_stays_near_its_beating_line_and_clear_of_the_oesophagus(heart: OperatingHeart) -> None:
    """The path is the surface's own motion to 0.1 mm; the model of the oesophagus is the tube to 0.1 mm."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lesion, "LESION_MM", 8.0)
        alone, helped = (lesion_measures(ablate(heart, c, 1)) for c in TASKS["lesion"][::2])
        normal = np.array([0.6, -0.64, 0.48])
        site = Site(CENTER + RADIUS_MM * normal, normal, np.array([0.0, 0.6, 0.8]))
        line = moving_line(heart.truth, site, 8.0, 0.0)
        tube = lesion.tube_behind(line.places_mm, site)
        drawn = line.points(float(heart.model.timing.fractions[heart.model.ed_phase]))
        guide, wall = lesion.lesion_fixtures(heart.model, drawn, tube.model(heart.model.patient_id))
    assert helped["line_mm"] < 0.7 * alone["line_mm"]
    assert helped["tube_mm"] >= max(lesion.MARGIN_MM, alone["tube_mm"])
    assert helped["within_margin_s"] == 0.0
    assert alone["largest_force_n"] == 0.0
    assert guide.path is not None
    for phase in (0.0, 0.3, 0.5):
        assert distance_to_line(guide.path.at(phase), line.points(phase)).max() < 0.1
    assert min(tube.distance_mm(places).min() for places in line.places_mm) == pytest.approx(4.0, abs=0.05)
    assert wall.structure is not None
    places = site.point_mm - np.array([[5.0], [6.5], [8.0]]) * normal
    found = Evaluator(wall.structure, wall.law).force(places, 0.2).distance_mm
    np.testing.assert_allclose(-found, tube.distance_mm(places), atol=0.1)


def test_a_scenario_s_lesion_is_where_its_tool_slides() -> None:
    """On a small ball that beats: the line on its surface, the tube GAP_MM behind it at end-systole."""
    vertices, triangles = sphere(RADIUS_MM, 3, CENTER)
    beating = np.stack([vertices, CENTER + (RADIUS_MM - 3.0) / RADIUS_MM * (vertices - CENTER)])
    timing = CycleTiming(np.array([0.0, 0.5]), 0.8)
    surface = SurfaceSeries("EPICARDIAL", "mr", beating, triangles, timing, "ball")
    angle, none = np.linspace(-0.3, 0.3, 41), np.zeros(41)
    slide = CENTER + (RADIUS_MM - 1.0) * np.column_stack([np.cos(angle), np.sin(angle), none])
    tool = ToolTruth(np.arange(41.0), slide, none, none, none + 1.0, np.zeros((41, 3)))
    guide, wall = lesion.scenario_fixtures(tool, surface).fixtures
    assert guide.path is not None
    assert wall.structure is not None
    drawn = guide.path.points_mm[0]
    np.testing.assert_allclose(np.linalg.norm(drawn - CENTER, axis=1), RADIUS_MM, atol=0.3)
    assert np.linalg.norm(drawn[-1] - drawn[0]) == pytest.approx(lesion.LESION_MM, abs=2.0)
    tube = Evaluator(wall.structure, wall.law)
    nearest = max(tube.force(points, 0.0).distance_mm.max() for points in guide.path.points_mm)
    assert -nearest == pytest.approx(lesion.GAP_MM, abs=0.4)
    with pytest.raises(InvalidInputError, match="does not touch"):
        lesion.scenario_fixtures(replace(tool, distance_mm=none - 1.0), surface)


def test_pellets_are_removed_through_the_fulcrum(heart: OperatingHeart) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pellets, "PELLETS", 2)
        loop, task = pellet_trial(heart, "dissection", TASKS["dissection"][4], 1)
        trace = dissect(heart, TASKS["dissection"][4], 1)
    measures = dissection_measures(trace)
    assert loop.fulcrum is not None
    assert loop.fulcrum.lever(task.pellets.target_mm(0)) == pytest.approx(140.0 / 190.0)
    assert measures["pellets"] == 2.0
    assert measures["time_s"] < 2 * (8.0 + 4.0)


def test_a_pushed_pellet_is_left_at_its_deepest_and_only_where_it_is(heart: OperatingHeart) -> None:
    """The rules alone, with a tip put by hand."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pellets, "PELLETS", 2)
        loop, task = pellet_trial(heart, "cutting", Condition("", beating=False), 3)
    aside = task.pellets.target_mm(1) if np.linalg.norm(
        task.pellets.target_mm(1) - task.pellets.target_mm(0)
    ) > pellets.BESIDE_MM else loop.start_mm  # fmt: skip

    def at(above_mm: float, number: int = 0) -> float:
        place = task.pellets.target_mm(number) + above_mm * task.pellets.sites[number].normal
        return task(0.0, place, 0.0).stage

    task(0.0, aside, 0.0)
    assert task.done == 0, "elsewhere nothing is pushed"
    assert at(9.5) == 1.0, "within reach, not yet touched"
    assert task.done == 0, "above the surface without having touched it"
    assert [at(2.0), at(-1.0), at(6.0)] == [1.0, 1.0, 1.0]
    assert at(9.0) == 0.0, "drawn back"
    assert task.done == 1
    at(2.0, 1)
    assert at(9.0, 1) == -1.0, "the last ends the task"


def test_a_line_rides_on_the_surface_at_its_depth(heart: OperatingHeart) -> None:
    normal = np.array([0.6, -0.64, 0.48])
    site = Site(CENTER + RADIUS_MM * normal, normal, np.array([0.0, 0.6, 0.8]))
    line = moving_line(heart.truth, site, 10.0, 5.0)
    assert line.length_mm == 10.0
    for phase in (0.0, 0.3, 0.77):
        place = line.at(4.3, phase)
        radius = RADIUS_MM - 3.0 * np.sin(np.pi * phase) ** 2 - 5.0
        assert np.linalg.norm(place - CENTER) == pytest.approx(radius, abs=0.12), "facets lie inside the ball"
        moved = (line.at(4.3, phase + 1e-3) - line.at(4.3, phase - 1e-3)) / 2e-3
        np.testing.assert_allclose(line.rate_mm(4.3, phase), moved, atol=0.2)
    assert line.tangent(3.0) @ site.slide == pytest.approx(1.0, abs=0.15)


def test_a_known_force_says_where_the_target_is() -> None:
    wall = learnt_force(Sigmoid(2.0, 0.6, 5.0), 5.0)
    assert wall.read(0.3)[0] == pytest.approx(0.0, abs=1e-3), "half of the cap at the guarded depth"
    assert wall.read(0.3)[1] == pytest.approx(4.0 / (2.0 * 0.6), rel=0.01)
    deeper = learnt_force(Sigmoid(2.0, 0.6), -1.0)
    assert deeper.read(0.3)[0] == pytest.approx(1.0, abs=1e-3)
    pull = learnt_force(Gaussian(1.5, 0.5), 0.0)
    assert pull.read(0.6 * (1.0 - np.exp(-1.0)))[0] == pytest.approx(1.5, abs=0.01)


def test_excursions_are_counted_once_each() -> None:
    depth = np.array([0.0, 1.1, 0.95, 1.2, 0.7, 1.05, 0.0])
    assert count_excursions(depth, 1.0) == 2
    assert count_excursions(depth, 2.0) == 0
    assert count_excursions(np.array([1.5, 1.5]), 1.0) == 1


def test_measures_of_pellets_are_those_of_their_deepest_places() -> None:
    stage = np.array([0.0, 1.0, 1.0, 2.0, 2.0, 0.0])
    depth = np.array([-8.0, 4.0, 4.5, 6.5, 5.0, -3.0])
    trace = Trace(np.arange(6) / 100, np.zeros((6, 3)), np.full(6, 0.2), depth, stage, 0.0)
    measures = cutting_measures(trace)
    assert measures["depth_mean_mm"] == pytest.approx(5.5)
    assert measures["depth_sd_mm"] == pytest.approx(np.std([4.5, 6.5], ddof=1))
    assert measures["depth_rms_mm"] == pytest.approx(np.sqrt((0.25 + 2.25) / 2))
    assert (measures["largest_excess_mm"], measures["perforations"]) == (1.5, 1.0)
    assert measures["time_s"] == pytest.approx(0.06)


def lines_of(changes: list[float]) -> list[dict[str, dict[str, float]]]:
    return [{"without": {"errors": 5.0}, "with": {"errors": 5.0 + change}} for change in changes]


def test_a_paired_difference_has_its_effect_size() -> None:
    found = difference("errors", "with", "without", lines_of([-1.0, -2.0, -3.0, -2.0]))
    assert found.mean.value == pytest.approx(-2.0)
    assert found.relative == pytest.approx(-0.4)
    assert found.effect_size.value == pytest.approx(-2.0 / np.std([1, 2, 3, 2], ddof=1))
    assert (found.better, found.of) == (4, 4)
    assert found.mean.low is not None
    assert found.mean.high is not None
    assert found.mean.low < -2.0 < found.mean.high < 0.0
    assert difference("errors", "with", "without", lines_of([1.0] * 4)).effect_size.value is None


def test_a_summary_pairs_each_condition_with_its_own_heart() -> None:
    measures = ("depth_mean_mm", "depth_sd_mm", "depth_rms_mm", "perforations")
    one = {c.name: dict.fromkeys(measures, float(k)) for k, c in enumerate(TASKS["cutting"])}
    found = summarise_operators("cutting", [{"seed": 1, "conditions": one}, {"seed": 2, "refused": "no"}])
    assert (found.operators, found.failed) == (1, 1)
    pairs = {(d.condition, d.reference) for d in found.differences}
    assert len(pairs) == 4
    assert all(condition.split(",")[0] == reference.split(",")[0] for condition, reference in pairs)
    assert {d.mean.value for d in found.differences if d.condition.endswith(UNATTENDED)} == {2.0}


def test_assumptions_are_told() -> None:
    for task in TASKS:
        told = " ".join(assumptions(task))
        assert "no person took part" in told
        assert "0.12 kg" in told


def test_the_paper_s_rows_give_its_means_and_not_those_it_misprints() -> None:
    with_mm, without_mm = paper.depth_rms_mm()
    assert (round(with_mm, 2), round(without_mm, 2)) == (0.38, 1.64)
    with_s, without_s = paper.DISSECTION_S.mean(axis=(0, 2))
    assert (round(with_s, 1), round(without_s)) == (52.2, 94)
    assert round(1 - with_s / without_s, 2) == 0.44
    assert paper.SIGHT_S.mean(axis=0).round(1).tolist() == [42.3, 70.1, 37.6, 65.8]
    for task in TASKS:
        assert {c.name for c in TASKS[task]} <= set(paper.figures_of(task))
    assert paper.figures_of("dissection")["mono, visual only"] == "70.1 s; 93.7 s"


def test_tables_give_the_paper_s_own_statistics() -> None:
    """p < .001 for the variation of Table I, .008 of Table III, .026 of Table IV; no difference of sight."""
    rows = {kind: {row[0]: row[1:] for row in paper_table(kind, {}, "here")} for kind in ("I", "III", "IV")}
    assert rows["I"]["p: same mean, same variation"][1] == "< .001"
    assert rows["I"]["RMS about 5 mm"][:2] == ("0.38", "1.64")
    assert (rows["III"]["p of the force"][0], rows["III"]["less with force"][0]) == (".008", "44 %")
    assert rows["IV"]["p: force over both, sight"][0] == ".026"
    assert float(rows["IV"]["p: force over both, sight"][2]) > 0.3


def test_tables_put_operators_and_persons_beside_the_paper_s() -> None:
    measures = {"depth_mean_mm": 4.9, "depth_sd_mm": 0.3, "time_s": 50.0}
    names = [f"{group}, {arm}" for group in ("mono", "stereo", "still") for arm in (HAPTICS, NO_HAPTICS)]
    lines = [{"conditions": dict.fromkeys(names, measures)}, {"refused": "no"}]
    assert operators_subjects("cutting", lines, "still")["I"]["operator 1"].tolist() == [[4.9, 0.3]] * 2
    subjects = operators_subjects("dissection", lines)
    assert subjects["IV"]["operator 1"].tolist() == [50.0] * 4
    assert paper_table("III", subjects["III"], "operators")[1][3:] == ("operator 1", "50.0", "50.0")

    def trial(person: str, arm: str, sight: str = "mono") -> dict[str, object]:
        common = {"person": person, "task": "cutting", "condition": f"{sight}, {arm}", "complete": True}
        return {**common, "pellet_depths_mm": [4.0, 6.0] if arm == NO_HAPTICS else [4.9, 5.1]}

    played = [trial("anna", HAPTICS), trial("anna", NO_HAPTICS), trial("berta", HAPTICS)]
    table = training_tables("cutting", played)
    assert table[1][3:] == ("anna, mono", "5.00 ± 0.14", "5.00 ± 1.41")
    assert not any("berta" in cell for row in table for cell in row), "only one arm"


def test_the_figure_says_that_operators_are_simulated() -> None:
    curve = Curve(0, np.arange(5) / 10, np.linspace(4, 6, 5))
    shown = OperatorsFigure(
        title="2 simulated operators: cutting",
        note="assumed",
        courses=[("one", [curve, Curve(None, curve.t_s, curve.depth_mm)])],
        ordinate="depth, mm",
        depth_limits_mm=(2.0, 8.0),
        forbidden_mm=5.0,
        kinds=(NO_HAPTICS, HAPTICS),
        panels=[Panel("error", [Compared("all", np.array([[1.0, 2.0], [0.5, 0.4]]))], [(0.3, "paper")])],
        ablations=[Interval("phase", 1.0, 0.8, 1.3)],
        ablation_label="error, mm",
    )
    figure = operators_figure(shown)
    assert "simulated operators" in figure.get_suptitle()
    assert len(figure.axes) == 3
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_ydata(), curve.depth_mm)
