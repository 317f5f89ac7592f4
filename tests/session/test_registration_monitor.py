"""A pose must agree with touched landmarks at first, and with every heart beat afterwards."""

from dataclasses import replace

import numpy as np
import pytest
from dvf_ig.session.pose.registration_monitor import (
    CONFIRMING_BEATS,
    CONSISTENT_LOG_RATIO,
    ELSEWHERE_BEATS,
    SUSPEND_LOG_RATIO,
    SUSPEND_LOG_RATIO_ALONE,
    RegistrationMonitor,
)

from dvf_ig.core import Rigid, Stop
from dvf_ig.registration import BeatMeasurement, PoseEstimate, TipSighting
from dvf_ig.session import BeatEvaluation
from dvf_ig.session.reasons import Refusal, Refused

CENTER = np.array([10.0, -20.0, 30.0])


def at(mm: float, sigma_mm: float = 0.4) -> PoseEstimate:
    pose = Rigid("mr", "tracker", np.eye(3), np.array([mm, 0.0, 0.0]))
    return PoseEstimate(pose, sigma_mm**2 * np.eye(6), CENTER, sigma_mm**2 * np.eye(6))


def measured(
    log_ratio: float,
    *,
    off_mm: float = 0.0,
    power: float = 12.0,
    begin_s: float = 0.0,
    similarity: float = 0.6,
) -> BeatEvaluation:
    """A beat that matches best `off_mm` further along x, as precise as the pose is known."""
    information = np.eye(6) / 0.4**2
    offset = np.array([0, 0, 0, off_mm, 0, 0])
    pose = at(0.0).pose
    measurement = BeatMeasurement(
        pose=pose,
        best=at(off_mm).pose,
        offset_information_mm=information @ offset,
        information=information,
        similarity=0.5,
        best_similarity=similarity,
        log_likelihood_ratio=log_ratio,
        wrong_pose_log_ratio=power,
        moved_mm=off_mm,
        overlap=1.0,
        evaluations=1,
    )
    end_s = begin_s + 0.8
    return BeatEvaluation(
        begin_s, end_s, end_s + 0.1, end_s + 0.3, 10, measurement, True, 0.01, np.zeros((3, 3))
    )


def in_use(mm: float = 0.0) -> RegistrationMonitor:
    monitor, refused = RegistrationMonitor(CENTER, landmarks=None).after_registration(at(mm), 0)
    assert refused == Refused(Refusal.UNCONFIRMED)
    for _ in range(CONFIRMING_BEATS):
        assert monitor.in_use is None
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is not None
    return monitor


def along(monitor: RegistrationMonitor) -> float:
    assert monitor.in_use is not None
    return float(monitor.in_use.pose.translation_mm[0])


def test_a_first_pose_is_used_once_beats_confirm_it() -> None:
    assert along(in_use(1.0)) == pytest.approx(1.0)


def test_a_contradicted_registration_is_dropped_and_the_next_needs_more() -> None:
    monitor, _ = RegistrationMonitor(CENTER, landmarks=None).after_registration(at(0.0), 0)
    for log_ratio in (1.0, 1.0, CONSISTENT_LOG_RATIO + 0.1):
        monitor = monitor.after_beat(measured(log_ratio))
    assert monitor.under_test is None
    monitor, _ = monitor.after_registration(at(0.5), 0)
    for _ in range(2 * CONFIRMING_BEATS):
        assert monitor.in_use is None
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is not None
    assert monitor.needed_beats == CONFIRMING_BEATS


@pytest.mark.parametrize("landmarks", [None, at(3.0).pose])
def test_landmarks_are_compared_where_there_are_any(landmarks: Rigid | None) -> None:
    monitor, refused = RegistrationMonitor(CENTER, landmarks).after_registration(at(9.0), 0)
    assert refused is not None
    assert (monitor.pending is None) == (landmarks is not None)
    assert (refused.cause is Refusal.LANDMARKS_DISAGREE) == (landmarks is not None)
    assert ("6.0 mm" in refused.sentence) == (landmarks is not None)


def test_landmarks_are_not_compared_again_after_a_patient_moved() -> None:
    monitor, _ = RegistrationMonitor(CENTER, landmarks=at(0.0).pose).after_registration(at(0.5), 0)
    for _ in range(CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    monitor, refused = monitor.after_beat(measured(20.0)).after_registration(at(9.0), 0)
    assert refused == Refused(Refusal.UNCONFIRMED)
    assert monitor.pending is not None


def test_a_beat_that_disagrees_much_suspends_the_pose_at_once() -> None:
    monitor = in_use().after_beat(measured(SUSPEND_LOG_RATIO_ALONE + 0.1))
    assert monitor.in_use is None
    assert monitor.under_test is not None
    assert monitor.under_test.pose.translation_mm[0] == pytest.approx(0.0, abs=1e-9)
    assert in_use().after_beat(measured(SUSPEND_LOG_RATIO_ALONE - 0.1)).in_use is not None


def test_two_beats_in_a_row_that_disagree_suspend_the_pose() -> None:
    over, under = measured(SUSPEND_LOG_RATIO + 0.1), measured(SUSPEND_LOG_RATIO - 0.1)
    assert in_use().after_beat(over).after_beat(over).in_use is None
    assert in_use().after_beat(over).after_beat(under).after_beat(over).in_use is not None


def test_beats_that_agree_on_another_place_suspend_the_pose_and_say_since_when() -> None:
    """Each alone is within the limit: 3 mm at 0.4 mm a beat, with the pose known to 0.3 mm."""
    monitor = in_use()
    for k in range(8):
        held = monitor.in_use
        if held is None:
            break
        beat = measured(2.0, off_mm=3.0 - along(monitor), begin_s=20.0 + k)
        monitor = monitor.after_beat(replace(beat, measurement=replace(beat.measurement, pose=held.pose)))
    assert k > 1
    assert monitor.doubt is not None
    assert monitor.doubt.sentence == "heart beats since 20.0 s fit 3.0 mm from this pose"
    assert monitor.doubt.pose is not None
    assert monitor.doubt.pose.translation_mm[0] == pytest.approx(3.0, abs=0.05)


def test_a_false_alarm_ends_when_beats_agree_with_the_pose_again() -> None:
    monitor = in_use().after_beat(measured(SUSPEND_LOG_RATIO_ALONE + 1.0))
    for _ in range(CONFIRMING_BEATS):
        assert monitor.in_use is None
        monitor = monitor.after_beat(measured(0.5))
    assert along(monitor) == pytest.approx(0.0, abs=1e-9)
    assert monitor.doubt is None


def test_beats_that_fit_another_place_do_not_bring_the_pose_back() -> None:
    """Single beats cannot tell 1.8 mm from noise; together they keep a pose suspended that is so far off."""
    monitor = in_use().after_beat(measured(SUSPEND_LOG_RATIO_ALONE + 1.0))
    for _ in range(4 * CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(2.0, off_mm=1.8))
    assert monitor.in_use is None


def test_a_patient_who_moved_is_found_and_confirmed() -> None:
    suspended = in_use().after_beat(measured(20.0, off_mm=8.0))
    monitor, refused = suspended.after_registration(at(8.0), 0)
    assert refused == Refused(Refusal.UNCONFIRMED)
    for _ in range(CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert along(monitor) == pytest.approx(8.0)


def test_a_registration_elsewhere_suspends_the_pose_until_confirmed() -> None:
    monitor, refused = in_use().after_registration(at(3.0), 0)
    assert refused is not None
    assert refused.cause is Refusal.MOVED
    assert "moved by 3.0 mm" in refused.sentence
    assert monitor.in_use is None
    for _ in range(CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert along(monitor) == pytest.approx(3.0)


def test_beats_and_registrations_move_the_pose_by_their_weight() -> None:
    """Equal covariances meet half-way; an older registration adds nothing where the pose is known as well."""
    monitor = RegistrationMonitor(CENTER, None, estimate=at(0.0), suspended=False)
    now, refused = monitor.after_registration(at(1.0), 0)
    assert refused is None
    assert along(now) == pytest.approx(0.5, abs=1e-3)
    assert along(monitor.after_registration(at(1.0), 20)[0]) == 0.0
    assert 0.5 < along(monitor.after_beat(measured(2.0, off_mm=1.0))) < 0.55


def test_beats_without_information_neither_confirm_a_pose_nor_move_it() -> None:
    pending, _ = RegistrationMonitor(CENTER, landmarks=None).after_registration(at(0.0), 0)
    assert pending.after_beat(measured(0.1, power=0.3)).consistent_beats == 0
    monitor = in_use()
    after = monitor.after_beat(measured(0.1, off_mm=0.5, power=0.3))
    assert along(after) == along(monitor)
    assert after.in_use is not None
    assert monitor.in_use is not None
    assert after.in_use.sigma_mm() > monitor.in_use.sigma_mm()


def test_one_refused_registration_makes_the_pose_less_certain_and_two_in_a_row_suspend_it() -> None:
    monitor = in_use()
    once = monitor.after_refusal(Stop.POOR_MATCH)
    assert once.in_use is not None
    assert monitor.in_use is not None
    assert once.in_use.sigma_mm() > 1.0 > monitor.in_use.sigma_mm()
    assert along(once) == along(monitor)
    twice = once.after_refusal(Stop.DISAGREEMENT)
    assert twice.in_use is None


def test_after_a_refused_registration_less_suffices_to_suspend_the_pose() -> None:
    """A beat whose statistic, 42, lies within the limit, and within it no more once less is asked for."""
    far = measured(2.0, off_mm=3.21)
    assert in_use().after_beat(far).in_use is not None
    assert in_use().after_refusal(Stop.POOR_MATCH).after_beat(far).in_use is None


def test_a_usable_registration_between_two_refused_ones_forgives_the_first() -> None:
    once = in_use().after_refusal(Stop.POOR_MATCH)
    again, refused = once.after_registration(at(0.1), 0)
    assert refused is None
    assert again.after_refusal(Stop.POOR_MATCH).in_use is not None


def test_beats_bring_a_pose_back_that_refused_registrations_had_suspended() -> None:
    monitor = in_use().after_refusal(Stop.POOR_MATCH).after_refusal(Stop.POOR_MATCH)
    for _ in range(CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is not None


def test_a_change_that_no_pose_explains_suspends_until_a_registration_is_usable_again() -> None:
    """The beats' best pose stays; what they match there gets worse, and stays so."""
    monitor, rng = in_use(), np.random.default_rng(2)
    for k in range(40):
        monitor = monitor.after_beat(measured(1.0, begin_s=0.8 * k, similarity=0.6 + 0.02 * rng.normal()))
        assert monitor.in_use is not None
    for k in range(40, 50):
        monitor = monitor.after_beat(measured(1.0, begin_s=0.8 * k, similarity=0.5 + 0.02 * rng.normal()))
        if monitor.in_use is None:
            break
    assert 41 < k < 46
    assert monitor.doubt is not None
    assert 30.0 < monitor.doubt.since_s < 33.0
    assert "matches the model worse" in monitor.doubt.sentence
    for _ in range(2 * CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is None
    monitor, _ = monitor.after_registration(at(0.0), 0)
    for _ in range(CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is not None


def test_where_ecg_and_images_disagree_only_a_registration_brings_the_pose_back() -> None:
    monitor = in_use().after_refusal(Stop.PHASE_OFFSET)
    for _ in range(2 * CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is None
    monitor, _ = monitor.after_registration(at(0.0), 0)
    for _ in range(CONFIRMING_BEATS):
        monitor = monitor.after_beat(measured(1.0))
    assert monitor.in_use is not None


def test_a_refused_registration_changes_nothing_before_there_is_a_pose() -> None:
    monitor = RegistrationMonitor(CENTER, landmarks=None)
    assert monitor.after_refusal(Stop.POOR_MATCH).in_use is None


def sighted(off_mm: float) -> TipSighting:
    return TipSighting(off_mm, 0.0, 90.0, 5.0, 12)


def elsewhere(monitor: RegistrationMonitor, off_mm: float) -> RegistrationMonitor:
    for _ in range(ELSEWHERE_BEATS):
        assert monitor.tip_off_mm is None
        monitor = monitor.after_tip(sighted(off_mm))
    return monitor


def test_a_tool_that_is_seen_elsewhere_takes_the_pose_away_until_it_is_not() -> None:
    monitor = in_use()
    assert monitor.after_tip(sighted(1.0)).in_use is not None
    assert monitor.after_tip(sighted(5.0)).in_use is not None
    suspended = elsewhere(monitor, 5.0)
    assert suspended.in_use is None
    assert suspended.doubt is not None
    assert suspended.doubt.sentence.startswith(
        "ultrasound shows the tool 5.0 mm from where its tip should be"
    )
    # neither a registration nor beats bring a pose back
    after, refused = suspended.after_registration(at(0.0), 0)
    assert refused == Refused(Refusal.TIP_ELSEWHERE, 5.0)
    for _ in range(2 * CONFIRMING_BEATS):
        after = after.after_beat(measured(1.0))
    assert after.in_use is None
    recovered = after.after_tip(sighted(0.5))
    for _ in range(CONFIRMING_BEATS):
        recovered = recovered.after_beat(measured(1.0))
    assert recovered.in_use is not None


def test_single_sightings_elsewhere_do_not_count() -> None:
    monitor = in_use()
    for off_mm in [5.0] * (ELSEWHERE_BEATS - 1) + [0.5] + [5.0] * (ELSEWHERE_BEATS - 1):
        monitor = monitor.after_tip(sighted(off_mm))
    assert monitor.in_use is not None


def test_a_first_pose_is_refused_while_the_tool_is_seen_elsewhere() -> None:
    unposed = elsewhere(RegistrationMonitor(CENTER, landmarks=None), 4.0)
    monitor, refused = unposed.after_registration(at(0.0), 0)
    assert refused == Refused(Refusal.TIP_ELSEWHERE, 4.0)
    assert monitor.pending is None
