"""The page of a replay: what its figures draw, what they leave out without ground truth, and the verdict."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_lines import x_of, y_of
from matplotlib.figure import Figure

from dvf_ig.report.plane_overlay import AnatomyPlane, PlaneOverlay
from dvf_ig.report.replay import (
    BeatTrace,
    BreathLoop,
    EcgStrip,
    RegistrationMark,
    ReplayPage,
    SupervisorTrace,
    TickTrace,
    replay_html,
)
from dvf_ig.report.replay.figures import (
    breathing_figure,
    distance_histogram,
    ecg_figure,
    force_figure,
    overlay_figure,
    phase_error_figure,
    pose_figure,
    supervisor_figure,
)

T_S = np.arange(4000) / 1000.0
VALID = T_S >= 1.0


def ticks() -> TickTrace:
    wave = np.sin(2 * np.pi * T_S)
    return TickTrace(
        t_s=T_S,
        valid=VALID,
        phase_valid=T_S >= 0.5,
        force_n=0.3 * np.abs(wave) * VALID,
        distance_mm=np.where(VALID, 3 * wave, np.nan),
        true_force_n=0.3 * np.abs(wave),
        true_distance_mm=3 * wave + 0.1,
        phase_error_percent=wave,
    )


def overlay() -> PlaneOverlay:
    """The surface at 10 mm below the top at the start, at 20 mm registered; pixels of 1 mm by 0.5 mm."""
    y_mm = np.mgrid[:80, :60][0] * 0.5 + 0.25

    def anatomy(surface_mm: float) -> AnatomyPlane:
        return AnatomyPlane(y_mm / 40.0, surface_mm - y_mm, None, ("R", "L", "A", "P"))

    return PlaneOverlay(
        name="frame 3",
        plane="axial",
        event_s=2.5,
        model_phase=0.4,
        image=np.zeros((80, 60), np.uint8),
        pixel_mm=(1.0, 0.5),
        start=anatomy(10.0),
        registered=anatomy(20.0),
    )


def page() -> ReplayPage:
    return ReplayPage(
        scenario="toy <1>",
        patient_id="nobody",
        version="0",
        estimates=[("tool tip", "(0, 0, 0) mm", "0.1 mm")],
        registrations=[RegistrationMark(1.0, True, "converged"), RegistrationMark(3.0, True, "converged")],
        no_force=None,
        without_force_s=0.0,
        lost=None,
        warnings=[],
        overlays=[overlay(), overlay()],
        beats=BeatTrace(
            decided_s=np.array([1.0, 2.0, 3.0]),
            in_use=np.array([False, True, True]),
            log_likelihood_ratio=np.array([1.0, 2.0, 9.0]),
            tre_mm=np.array([0.5, 0.6, 0.7]),
            limit=7.0,
            suspended_s=((3.0, 4.0),),
        ),
        breath=None,
        ticks=ticks(),
        supervisor=SupervisorTrace(
            T_S,
            np.where(T_S < 1.0, np.inf, 0.5),
            np.minimum(5.0, 6.0 - T_S),
            ((3.0, 4.0, "3 beats missed"),),
            (("ok", "#1f6fb4", VALID), ("no pose", "#888888", ~VALID)),
        ),
        ecg=EcgStrip(
            label="II, mV",
            ecg_t_s=T_S,
            ecg=np.cos(T_S),
            r_peaks_s=np.array([1.0, 2.0]),
            t_s=T_S,
            phase=T_S % 1.0,
            phase_valid=VALID,
            true_phase=T_S % 1.0,
        ),
    )


def breath() -> BreathLoop:
    """A circle of radius 5 mm about ρ = 0.5, with two beats that miss it by 1 mm."""
    turn = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    rising = np.sin(turn) < 0.0
    return BreathLoop(
        surrogate="pressure",
        rho=np.array([0.5, 0.5]),
        displacement_mm=np.array([-4.0, 4.0]),
        residual_mm=np.array([1.0, -1.0]),
        sigma_mm=np.array([0.5, 0.4]),
        inspiration=np.array([True, False]),
        course_rho=0.5 + 0.5 * np.cos(turn),
        course_mm=5.0 * np.sin(turn),
        course_inspiration=rising,
        true_mm=5.2 * np.sin(turn),
        breaths=12,
        held_out_mm=0.7,
    )


DRAWN = ("breathing", "ecg", "force", "overlay", "phase_error", "pose", "supervisor")


@pytest.fixture
def undrawn(blank_pictures: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a test of the page's words: other tests draw the same figures."""
    for name in ("distance_histogram", *(f"{one}_figure" for one in DRAWN)):
        monkeypatch.setattr(f"dvf_ig.report.replay.figures.{name}", lambda *_: Figure())


@pytest.mark.usefixtures("blank_pictures")
def test_a_breath_is_a_closed_loop_with_its_beats_and_what_they_miss() -> None:
    upper, lower = breathing_figure(breath()).axes
    lines = {str(line.get_label()): line for line in upper.get_lines()}
    rising, falling, truth = (
        lines[name] for name in ("model, inspiration", "model, expiration", "ground truth")
    )
    assert y_of(truth)[0] == y_of(truth)[-1]
    drawn = [np.isfinite(y_of(line)) for line in (rising, falling)]
    assert (drawn[0] | drawn[1]).all()
    assert (drawn[0] & drawn[1]).sum() == 2  # where the two branches meet
    assert y_of(lines["heart beat, inspiration"]).tolist() == [-4.0]
    assert [y_of(line).tolist() for line in lower.get_lines() if line.get_marker() == "v"] == [[-1.0]]
    assert "Breathing" not in replay_html(page())
    assert "Breathing: the heart" in replay_html(replace(page(), breath=breath()))


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("error", ["", "0.1 mm"])
def test_errors_have_a_column_only_where_the_truth_is_known(error: str) -> None:
    text = replay_html(replace(page(), estimates=[("tool tip", "(0, 0, 0) mm", error)]))
    assert ("error against the ground truth" in text) == bool(error)


def test_the_page_holds_every_figure_and_is_self_contained() -> None:
    text = replay_html(page())
    assert text.count("data:image/png;base64,") == 7
    assert "Replay of toy &lt;1&gt;" in text
    assert "<td>tool tip</td><td>(0, 0, 0) mm</td><td>0.1 mm</td>" in text
    assert "verdict good'>Registered to the end; force could be given from the first pose on" in text


@pytest.mark.usefixtures("blank_pictures")
def test_without_ground_truth_and_registration_there_is_less() -> None:
    bare = replace(
        ticks(), true_force_n=None, true_distance_mm=None, phase_error_percent=None, valid=T_S < 0.0
    )
    lone = replace(page(), registrations=[], overlays=[], beats=None, ticks=bare)
    text = replay_html(lone)
    assert text.count("data:image/png;base64,") == 4
    assert "Not registered, no force was given: the recording is too short to register" in text


LOST = "from 17.3 s on 3 heart beats in a row did not confirm the pose"


@pytest.mark.parametrize(
    ("usable", "lost", "verdict"),
    [
        (
            (True, False),
            None,
            "warn'>Registered, but the last registration was refused: &lt;why&gt;; no force for",
        ),
        (
            (True, True),
            LOST,
            f"warn'>Registered, but lost before the end: {LOST}; no force for 12.7 s of the",
        ),
        ((True, True), None, "good'>Registered to the end; no force for 12.7 s"),
        ((False, False), None, "bad'>Not registered, no force was given: &lt;why&gt;"),
    ],
)
@pytest.mark.usefixtures("undrawn")
def test_the_banner_is_amber_where_the_pose_was_lost(
    usable: tuple[bool, bool], lost: str | None, verdict: str
) -> None:
    marks = [RegistrationMark(float(k), good, "<why>") for k, good in enumerate(usable)]
    shown = replace(page(), registrations=marks, lost=lost, without_force_s=12.7)
    assert f"verdict {verdict}" in replay_html(shown)


def test_the_supervisors_picture_draws_the_rule_that_acted() -> None:
    _, lower = supervisor_figure(page().supervisor).axes
    np.testing.assert_array_equal(y_of(lower.lines[1]), np.minimum(5.0, 6.0 - T_S)[::5])
    assert [text.get_text() for text in lower.texts] == ["3 beats missed"]


def test_surfaces_are_drawn_where_the_distance_is_zero() -> None:
    figure = overlay_figure([overlay()])
    assert figure is not None
    for axis in figure.axes:
        start, found = (np.concatenate([p.vertices for p in c.get_paths()]) for c in axis.collections)
        assert start[:, 1] == pytest.approx(10.0)
        assert found[:, 1] == pytest.approx(20.0)
    assert overlay_figure([]) is None


def test_labels_tint_the_ultrasound_and_are_named() -> None:
    labels = np.zeros((80, 60), np.uint8)
    labels[20:40] = 5
    names = ((5, "atrial_wall"), (6, "la_blood"))
    figure = overlay_figure([replace(overlay(), labels=labels, label_names=names), overlay()])
    assert figure is not None
    assert len(figure.axes) == 6
    assert [text.get_text() for text in figure.legends[0].get_texts()][2:] == ["atrial wall"]
    tint = np.asarray(figure.axes[4].images[1].get_array())
    assert tint[30, 10, 3] > 0.0
    assert not tint[10, :, 3].any()
    assert len(figure.axes[5].images) == 1


def test_beats_are_told_apart_by_use() -> None:
    given = page()
    figure = pose_figure(given.beats, given.registrations, (0.0, 4.0))
    assert figure is not None
    upper, lower = figure.axes
    assert [x_of(line).tolist() for line in upper.lines[:2]] == [[2.0, 3.0], [1.0]]
    assert [y_of(line).tolist() for line in lower.lines[:2]] == [[2.0, 9.0], [1.0]]
    assert y_of(lower.lines[2])[0] == 7.0
    assert pose_figure(None, given.registrations, (0.0, 4.0)) is None


def test_phase_error_is_shown_where_phase_is_valid() -> None:
    figure = phase_error_figure(ticks())
    assert figure is not None
    shown = y_of(figure.axes[0].lines[0])
    np.testing.assert_array_equal(np.isfinite(shown), T_S >= 0.5)
    (refused,) = figure.axes[0].patches
    corners = refused.get_path().vertices
    corners = refused.get_patch_transform().transform(corners)
    assert (corners[:, 0].min(), corners[:, 0].max()) == (0.0, 1.0)


def test_force_and_distance_are_the_ticks() -> None:
    upper, lower = force_figure(ticks()).axes
    truth, estimate = upper.lines
    np.testing.assert_array_equal(y_of(estimate), ticks().force_n[::5])
    np.testing.assert_array_equal(y_of(truth), 0.3 * np.abs(np.sin(2 * np.pi * T_S))[::5])
    np.testing.assert_array_equal(y_of(lower.lines[1]), ticks().distance_mm[::5])


def test_the_histogram_counts_valid_ticks() -> None:
    axis = distance_histogram(ticks()).axes[0]
    assert sum(patch.get_height() for patch in axis.patches[:60]) == VALID.sum()  # type: ignore[attr-defined]


def test_r_peaks_lie_on_the_ecg() -> None:
    upper, lower = ecg_figure(page().ecg).axes
    x, y = upper.lines[1].get_data()
    assert y == pytest.approx(np.cos(x), abs=1e-6)
    np.testing.assert_array_equal(y_of(lower.lines[0]), T_S % 1.0)


def test_a_trigger_is_drawn_as_pulses() -> None:
    pulses = np.array([0.5, 1.3])
    upper, _ = ecg_figure(replace(page().ecg, label="trigger", ecg_t_s=pulses, ecg=None)).axes
    (lines,) = upper.collections
    assert [np.asarray(path.vertices)[0, 0] for path in lines.get_paths()] == pulses.tolist()
    assert upper.get_ylabel() == "trigger"
