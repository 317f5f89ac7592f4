"""Every state of the heart's pose under every event, and sequences of events that a patient brings about."""

from dataclasses import replace
from math import inf
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from followed_shape import followed_shape

from dvf_ig.core import FloatArray, PoseMotion, Rigid, Stop, Warp
from dvf_ig.registration import BeatMeasurement, PoseEstimate, RegistrationResult, TipSighting
from dvf_ig.registration.tracking.pose_estimate import INFORMATIVE_LOG_RATIO
from dvf_ig.session import (
    BeatEvaluation,
    DoubtCause,
    PoseUpdate,
    Refusal,
    Refused,
    RegistrationDecision,
    SessionHistory,
)
from dvf_ig.session import RegistrationRecord as Record
from dvf_ig.session.pose_states import (
    AGEING_MM_PER_S,
    CONFIRMING_BEATS,
    ELSEWHERE_BEATS,
    MAX_AGE_S,
    MAX_BOUND_MM,
    MAX_CONFIRMING_BEATS,
    MAX_MISSED_BEATS,
    Candidate,
    Confirmation,
    InUse,
    NoPose,
    Pose,
    Suspended,
    TipEvidence,
    Trial,
    last_used,
    suspended,
    under_test,
)
from dvf_ig.session.pose_transition import (
    CONSISTENT_LOG_RATIO,
    JUMP_MM,
    RECOVER_S,
    REFRESH_S,
    RETRY_S,
    SUSPEND_LOG_RATIO,
    SUSPEND_LOG_RATIO_ALONE,
    Action,
    BeatCompared,
    BeatMissed,
    PoseEvent,
    Registered,
    RegisterNext,
    RegistrationRefused,
    TipSeen,
    confirms,
    next_pose,
)
from dvf_ig.session.reasons import Doubt

CENTER = np.array([10.0, -20.0, 30.0])
ASKED_S, NOW_S, BEAT_S = 100.0, 103.0, 101.0
RECORD = Record(88.0, ASKED_S, NOW_S, None, None)


def pose_at(mm: float) -> Rigid:
    return Rigid("mr", "tracker", np.eye(3), np.array([mm, 0.0, 0.0]))


def at(mm: float, sigma_mm: float = 0.4) -> PoseEstimate:
    return PoseEstimate(pose_at(mm), sigma_mm**2 * np.eye(6), CENTER, sigma_mm**2 * np.eye(6))


def beat(
    log_ratio: float = 1.0,
    *,
    off_mm: float = 0.0,
    power: float = 12.0,
    begin_s: float = BEAT_S,
    similarity: float = 0.6,
    again: bool = False,
) -> BeatCompared:
    """A beat that matches best `off_mm` further along x, as precise as the pose is known."""
    information: FloatArray = np.eye(6) / 0.4**2
    measurement = BeatMeasurement(
        pose=pose_at(0.0),
        best=pose_at(off_mm),
        offset_information_mm=information @ np.array([0, 0, 0, off_mm, 0, 0]),
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
    evaluation = BeatEvaluation(
        begin_s, end_s, end_s + 0.1, end_s + 0.3, 10, measurement, True, 0.01, np.zeros((3, 3))
    )
    return BeatCompared(NOW_S, evaluation, again)


def registered(mm: float, *, beats: float = 0.0, landmarks: Rigid | None = None) -> Registered:
    return Registered(NOW_S, RECORD, at(mm), beats, landmarks)


def refused(stop: Stop = Stop.POOR_MATCH) -> RegistrationRefused:
    return RegistrationRefused(NOW_S, ASKED_S, stop)


def seen(off_mm: float) -> TipSeen:
    return TipSeen(NOW_S, TipSighting(off_mm, 0.0, 90.0, 5.0, 12))


CONFIRMED = Confirmation(99.0, 1.5)
TIP_OFF = TipEvidence(5.0, ELSEWHERE_BEATS)
IN_USE = InUse(at(0.0), PoseMotion.still(pose_at(0.0)), None, CONFIRMED)
SUSPENDED = Suspended(at(0.0), Doubt(DoubtCause.REFUSED), CONFIRMED, Trial())
FIRST = Candidate(at(0.0), RECORD, Trial(), None)
SECOND = Candidate(at(8.0), RECORD, Trial(), SUSPENDED)
LAST_BEAT = Trial(consistent=CONFIRMING_BEATS - 1)

UPDATED, WITHHELD = "pose updated", "pose withheld"
CANCEL, FORGET = "cancel", "forget landmarks"
RETRY, REFRESH = f"register at {ASKED_S + RETRY_S}", f"register at {ASKED_S + REFRESH_S}"
WAIT = f"register at {NOW_S + REFRESH_S}"
USED = "registration used"


def said(actions: tuple[Action, ...]) -> set[str]:
    """Actions in words."""
    words = set()
    for action in actions:
        match action:
            case PoseUpdate():
                words.add(WITHHELD if action.pose is None else UPDATED)
            case RegistrationDecision():
                words.add(USED if action.refused is None else action.refused.cause.name)
            case RegisterNext():
                words.add(f"register at {action.at_s}")
                words |= {CANCEL} if action.cancel_running else set()
                words |= {FORGET} if action.forget_landmarks else set()
    return words


TABLE: list[tuple[Pose, PoseEvent, type, set[str]]] = [
    (NoPose(), registered(0.0), Candidate, {"UNCONFIRMED", WAIT}),
    (NoPose(), registered(9.0, landmarks=pose_at(3.0)), NoPose, {"LANDMARKS_DISAGREE", RETRY}),
    (NoPose(), registered(3.5, landmarks=pose_at(3.0)), Candidate, {"UNCONFIRMED", WAIT}),
    (NoPose(Trial(tip=TIP_OFF)), registered(0.0), NoPose, {"TIP_ELSEWHERE", RETRY}),
    (NoPose(), refused(), NoPose, {RETRY}),
    (NoPose(), beat(), NoPose, set()),
    (NoPose(), BeatMissed(), NoPose, set()),
    (NoPose(), seen(5.0), NoPose, set()),
    # a candidate, before and after a pose was in use
    (FIRST, registered(1.0), Candidate, {"UNCONFIRMED", WAIT}),
    (FIRST, registered(9.0, landmarks=pose_at(3.0)), Candidate, {"LANDMARKS_DISAGREE", RETRY}),
    (SECOND, registered(9.0, landmarks=pose_at(3.0)), Candidate, {"UNCONFIRMED", WAIT}),
    (FIRST, refused(), Candidate, {RETRY}),
    (FIRST, beat(), Candidate, set()),
    (replace(FIRST, trial=LAST_BEAT), beat(), InUse, {UPDATED, USED, REFRESH}),
    (replace(FIRST, trial=replace(LAST_BEAT, tip=TIP_OFF)), beat(), Candidate, set()),
    (replace(FIRST, trial=replace(LAST_BEAT, needs_registration=True)), beat(), Candidate, set()),
    (replace(FIRST, trial=LAST_BEAT), beat(power=0.3), Candidate, set()),
    (FIRST, beat(CONSISTENT_LOG_RATIO + 0.1), NoPose, {"BEAT_DISAGREES", RETRY}),
    (SECOND, beat(CONSISTENT_LOG_RATIO + 0.1), Suspended, {"BEAT_DISAGREES", RETRY}),
    (SECOND, BeatMissed(), Candidate, set()),
    (FIRST, BeatMissed(), Candidate, set()),
    (FIRST, seen(5.0), Candidate, set()),
    # a pose in use
    (IN_USE, registered(1.0), InUse, {UPDATED, REFRESH}),
    (IN_USE, registered(3.0), Candidate, {WITHHELD, "MOVED", FORGET, WAIT}),
    (IN_USE, refused(), InUse, {UPDATED, RETRY}),
    (replace(IN_USE, refusals=1), refused(), Suspended, {WITHHELD, FORGET, f"register at {NOW_S}"}),
    (IN_USE, refused(Stop.PHASE_OFFSET), Suspended, {WITHHELD, FORGET, f"register at {NOW_S}"}),
    (IN_USE, beat(), InUse, {UPDATED}),
    (IN_USE, beat(SUSPEND_LOG_RATIO_ALONE - 0.1), InUse, {UPDATED}),
    (
        IN_USE,
        beat(SUSPEND_LOG_RATIO_ALONE + 0.1),
        Suspended,
        {WITHHELD, CANCEL, FORGET, f"register at {BEAT_S + 0.8 + RECOVER_S}"},
    ),
    (IN_USE, BeatMissed(), InUse, set()),
    (IN_USE, seen(5.0), InUse, set()),
    (
        replace(IN_USE, tip=TipEvidence(5.0, ELSEWHERE_BEATS - 1)),
        seen(5.0),
        Suspended,
        {WITHHELD, CANCEL, f"register at {NOW_S + RECOVER_S}"},
    ),
    (replace(IN_USE, tip=TipEvidence(5.0, ELSEWHERE_BEATS - 1)), seen(0.5), InUse, set()),
    # a suspended pose
    (SUSPENDED, registered(8.0, landmarks=pose_at(0.0)), Candidate, {"UNCONFIRMED", WAIT}),
    (replace(SUSPENDED, trial=Trial(tip=TIP_OFF)), registered(0.0), Suspended, {"TIP_ELSEWHERE", RETRY}),
    (SUSPENDED, refused(), Suspended, {RETRY}),
    (SUSPENDED, beat(), Suspended, set()),
    (replace(SUSPENDED, trial=LAST_BEAT), beat(), InUse, {UPDATED}),
    (replace(SUSPENDED, trial=LAST_BEAT), beat(CONSISTENT_LOG_RATIO + 0.1), Suspended, set()),
    (SUSPENDED, BeatMissed(), Suspended, set()),
    (SUSPENDED, seen(5.0), Suspended, set()),
]


@pytest.mark.parametrize(("pose", "event", "kind", "actions"), TABLE)
def test_the_table(pose: Pose, event: PoseEvent, kind: type, actions: set[str]) -> None:
    after, todo = next_pose(pose, event)
    assert type(after) is kind
    assert said(todo) == actions
    if isinstance(after, InUse) != isinstance(pose, InUse):
        assert {UPDATED, WITHHELD} & said(todo)


def test_the_table_has_every_state_under_every_event() -> None:
    states = (NoPose, Candidate, InUse, Suspended)
    events = (Registered, RegistrationRefused, BeatCompared, BeatMissed, TipSeen)
    assert {(type(pose), type(event)) for pose, event, *_ in TABLE} == {
        (s, e) for s in states for e in events
    }


# ------------------------------------------------------------------ sequences


def after(pose: Pose, *events: PoseEvent) -> Pose:
    for event in events:
        pose = next_pose(pose, event)[0]
    return pose


def along(pose: Pose) -> float:
    assert isinstance(pose, InUse)
    return float(pose.estimate.pose.translation_mm[0])


CONFIRMING = [beat()] * CONFIRMING_BEATS


def test_a_first_pose_is_used_once_beats_confirm_it() -> None:
    pose = after(NoPose(), registered(1.0), *CONFIRMING[1:])
    assert last_used(pose) is None
    pose = after(pose, beat())
    assert along(pose) == pytest.approx(1.0)
    assert isinstance(pose, InUse)
    assert pose.confirmation == Confirmation(NOW_S, pose.estimate.pose_bound_mm)
    assert pose.motion.at(NOW_S) is pose.estimate.pose


def test_a_contradicted_candidate_is_dropped_and_the_next_needs_more() -> None:
    pose = after(NoPose(), registered(0.0), *CONFIRMING[1:], beat(CONSISTENT_LOG_RATIO + 0.1))
    assert under_test(pose) is None
    pose = after(pose, registered(0.5), *CONFIRMING)
    assert isinstance(pose, Candidate)
    assert isinstance(after(pose, *CONFIRMING), InUse)
    for _ in range(5):
        pose = after(pose, beat(9.0), registered(0.5))
    assert isinstance(pose, Candidate)
    assert pose.trial.needed == MAX_CONFIRMING_BEATS


def test_two_beats_in_a_row_that_disagree_suspend_the_pose() -> None:
    over, under = beat(SUSPEND_LOG_RATIO + 0.1), beat(SUSPEND_LOG_RATIO - 0.1)
    assert isinstance(after(IN_USE, over, over), Suspended)
    assert isinstance(after(IN_USE, over, under, over), InUse)


def test_beats_that_agree_on_another_position_suspend_the_pose_and_name_it() -> None:
    """Each alone is within the limit: 3 mm at 0.4 mm a beat, with the pose known to 0.3 mm."""
    pose: Pose = IN_USE
    for k in range(8):
        assert isinstance(pose, InUse)
        one = beat(2.0, off_mm=3.0 - along(pose), begin_s=20.0 + k)
        measurement = replace(one.evaluation.measurement, pose=pose.estimate.pose)
        pose, actions = next_pose(
            pose, replace(one, evaluation=replace(one.evaluation, measurement=measurement))
        )
        if isinstance(pose, Suspended):
            break
    assert k > 1
    assert isinstance(pose, Suspended)
    assert pose.doubt.sentence == "heart beats since 20.0 s fit 3.0 mm from this pose"
    again = actions[-1]
    assert isinstance(again, RegisterNext)
    assert again.frames_from_s == 20.0 + k + 0.8
    assert again.start is not None
    assert again.start.translation_mm[0] == pytest.approx(3.0, abs=0.05)


def test_a_false_alarm_ends_when_beats_agree_with_the_pose_again() -> None:
    alarmed = after(IN_USE, beat(SUSPEND_LOG_RATIO_ALONE + 1.0))
    back = after(alarmed, *[beat(0.5)] * CONFIRMING_BEATS)
    assert along(back) == pytest.approx(0.0, abs=1e-9)
    assert suspended(back) is None
    # single beats cannot tell 1.8 mm from noise; together they keep a pose suspended that is as far off
    assert isinstance(after(alarmed, *[beat(2.0, off_mm=1.8)] * 4 * CONFIRMING_BEATS), Suspended)


def test_a_patient_who_moved_is_found_and_confirmed() -> None:
    assert along(after(IN_USE, beat(20.0, off_mm=8.0), registered(8.0), *CONFIRMING)) == pytest.approx(8.0)
    pose, actions = next_pose(IN_USE, registered(3.0))
    decision = next(one for one in actions if isinstance(one, RegistrationDecision))
    assert decision.registration is RECORD
    assert decision.refused == Refused(Refusal.MOVED, 3.0)
    assert "moved by 3.0 mm" in decision.refused.sentence
    last = last_used(pose)
    assert isinstance(last, Suspended)
    assert last.doubt.cause is DoubtCause.REGISTERED_ELSEWHERE
    assert along(after(pose, *CONFIRMING)) == pytest.approx(3.0)


def test_beats_and_registrations_move_the_pose_by_their_weight() -> None:
    """Equal covariances meet half-way; an older registration adds nothing if the pose is known as well."""
    assert along(after(IN_USE, registered(1.0))) == pytest.approx(0.5, abs=1e-3)
    assert along(after(IN_USE, registered(1.0, beats=20.0))) == 0.0
    moved = after(IN_USE, beat(2.0, off_mm=1.0))
    assert 0.5 < along(moved) < 0.55
    assert isinstance(moved, InUse)
    assert moved.motion.at(NOW_S).translation_mm[0] == pytest.approx(0.0, abs=1e-9)
    assert moved.motion.at(NOW_S + 60.0).translation_mm[0] == pytest.approx(along(moved))


def test_a_beat_without_information_leaves_the_pose_and_makes_it_less_certain() -> None:
    pose = after(IN_USE, beat(0.1, off_mm=0.5, power=0.3))
    assert along(pose) == 0.0
    assert isinstance(pose, InUse)
    assert pose.estimate.sigma_mm() > IN_USE.estimate.sigma_mm()
    assert pose.confirmation.missed_beats == 1


def test_refused_registrations_make_the_pose_less_certain_and_suspend_it() -> None:
    once = after(IN_USE, refused())
    assert isinstance(once, InUse)
    assert once.estimate.sigma_mm() > 1.5 * IN_USE.estimate.sigma_mm()
    assert IN_USE.confirmation.pose_bound_mm < once.confirmation.pose_bound_mm < MAX_BOUND_MM
    assert along(once) == 0.0
    assert isinstance(after(once, refused()), Suspended)
    assert isinstance(after(once, registered(0.1), refused()), InUse)
    assert isinstance(after(once, refused(), *CONFIRMING), InUse)
    # a beat whose statistic, 42, is within the limit, and beyond the one that a refusal leaves
    confirmed, far = after(NoPose(), registered(0.0), *CONFIRMING), beat(2.0, off_mm=3.21)
    assert isinstance(after(confirmed, far), InUse)
    assert isinstance(after(confirmed, refused(), far), Suspended)


def test_out_of_phase_only_a_registration_brings_the_pose_back() -> None:
    for pose in (after(IN_USE, refused(Stop.PHASE_OFFSET)), after(SECOND, refused(Stop.PHASE_OFFSET))):
        waiting = after(pose, *CONFIRMING, *CONFIRMING)
        assert not isinstance(waiting, InUse)
        assert isinstance(after(waiting, registered(0.0), *CONFIRMING), InUse)


def test_a_change_that_no_pose_explains_suspends_until_a_registration_is_usable_again() -> None:
    """The beats' best pose stays; their similarity there gets worse, and stays low."""
    pose, rng = after(IN_USE, beat()), np.random.default_rng(2)
    for k in range(50):
        similarity = (0.6 if k < 40 else 0.5) + 0.02 * rng.normal()
        pose = after(pose, beat(1.0, begin_s=0.8 * k, similarity=similarity))
        if isinstance(pose, Suspended):
            break
    assert 41 < k < 46
    assert isinstance(pose, Suspended)
    assert 30.0 < pose.doubt.since_s < 33.0
    assert "matches the model worse" in pose.doubt.sentence
    pose = after(pose, *CONFIRMING, *CONFIRMING)
    assert isinstance(pose, Suspended)
    assert isinstance(after(pose, registered(0.0), *CONFIRMING), InUse)


def test_a_registration_without_a_bound_renews_a_pose_near_it_and_weakens_one_elsewhere() -> None:
    unbounded = replace(RECORD, result=cast(RegistrationResult, SimpleNamespace(stop=Stop.UNBOUNDED)))
    assert unbounded.renews
    assert not unbounded.usable
    aged = replace(IN_USE, estimate=IN_USE.estimate.predict(40.0))
    near = after(aged, replace(registered(1.0), registration=unbounded))
    assert isinstance(near, InUse)
    assert near.estimate.pose_bound_mm == pytest.approx(IN_USE.estimate.pose_bound_mm, rel=0.05)
    elsewhere = after(IN_USE, replace(registered(JUMP_MM + 0.1), registration=unbounded))
    assert isinstance(elsewhere, InUse)
    assert elsewhere.refusals == 1
    assert elsewhere.estimate.pose_bound_mm > IN_USE.estimate.pose_bound_mm


def test_a_tool_that_is_seen_elsewhere_keeps_every_pose_from_use_until_it_is_not() -> None:
    elsewhere = [seen(5.0)] * ELSEWHERE_BEATS
    assert isinstance(after(IN_USE, *elsewhere[1:], seen(0.5), *elsewhere[1:]), InUse)
    pose = after(IN_USE, *elsewhere)
    assert isinstance(pose, Suspended)
    assert pose.doubt.sentence.startswith("ultrasound shows the tool 5.0 mm from where its tip should be")
    pose = after(pose, registered(0.0), *CONFIRMING, *CONFIRMING)
    assert isinstance(pose, Suspended)
    assert isinstance(after(pose, seen(0.5), *CONFIRMING), InUse)


def test_a_pose_comes_into_use_without_the_evidence_against_the_one_before() -> None:
    pose = after(SUSPENDED, seen(5.0), *CONFIRMING)
    assert isinstance(pose, InUse)
    assert (pose.tip, pose.refusals, pose.contradicting) == (TipEvidence(), 0, 0)
    assert pose.shift.compared == ()


def test_a_later_decision_replaces_the_one_before_in_what_the_history_says_of_a_registration() -> None:
    history, other = SessionHistory(), replace(RECORD, asked_s=0.0)
    assert history.last_registration is None
    for entry in (other, RECORD, RegistrationDecision(RECORD, Refused(Refusal.UNCONFIRMED))):
        history.append(entry)
    assert [record.refused for record in history.registrations] == [None, Refused(Refusal.UNCONFIRMED)]
    history.append(RegistrationDecision(RECORD, None))
    assert [record.refused for record in history.registrations] == [None, None]
    assert history.last_registration is not None
    assert history.last_registration.asked_s == RECORD.asked_s


# ------------------------------------------------------------------ confirmation


def test_beats_that_do_not_confirm_a_pose_are_counted_once() -> None:
    for pose in (IN_USE, SUSPENDED, SECOND):
        for event, missed in (
            (BeatMissed(), 1),
            (beat(4.0, power=0.3), 1),
            (beat(4.0, power=0.3, again=True), 0),
        ):
            last = last_used(after(pose, event))
            assert last is not None
            assert last.confirmation.missed_beats == missed
    confirmed = after(after(IN_USE, BeatMissed()), beat())
    assert isinstance(confirmed, InUse)
    assert confirmed.confirmation == Confirmation(NOW_S, confirmed.estimate.pose_bound_mm)


def test_a_confirmed_pose_lasts_five_seconds_or_three_beats() -> None:
    assert (MAX_AGE_S, MAX_MISSED_BEATS) == (5.0, 3)
    confirmation = Confirmation(10.0, pose_bound_mm=1.6)
    for missed in range(MAX_MISSED_BEATS):
        assert confirmation.missed_beats == missed
        assert confirmation.until_s == pytest.approx(15.0)
        confirmation = confirmation.missed()
    assert confirmation.until_s == confirmation.missed().until_s == -inf
    assert confirmation.confirmed_s == 10.0


def test_a_pose_whose_bound_passes_the_limit_is_withheld_earlier() -> None:
    confirmation = Confirmation(10.0, pose_bound_mm=MAX_BOUND_MM - 2.0 * AGEING_MM_PER_S)
    assert confirmation.until_s == pytest.approx(12.0)
    assert confirmation.bound_mm(12.0) == pytest.approx(MAX_BOUND_MM)
    assert confirmation.changed(MAX_BOUND_MM + 0.1).until_s == -inf
    assert Confirmation(10.0, pose_bound_mm=1.6).bound_mm(16.0) == pytest.approx(2.6)  # 10 mm a minute


def test_a_beat_confirms_only_if_it_would_have_contradicted_a_wrong_pose() -> None:
    agreeing = beat().evaluation.measurement
    assert confirms(agreeing)
    assert not confirms(replace(agreeing, wrong_pose_log_ratio=0.99 * INFORMATIVE_LOG_RATIO))
    assert not confirms(replace(agreeing, log_likelihood_ratio=1.01 * CONSISTENT_LOG_RATIO))


# ------------------------------------------------------------------ a heart that has changed its shape


def changed(mm: float, bulge_mm: float) -> PoseEstimate:
    """A pose with a shift of all walls along y."""
    coefficients = np.zeros((15, 15, 15, 4), dtype=np.float32)
    coefficients[..., 1], coefficients[..., 3] = bulge_mm, 0.1
    return replace(at(mm), shape=followed_shape(Warp("mr", np.full(3, -100.0), 17.0, coefficients)))


def y_of(pose: Pose, t_s: float) -> float:
    """Where the wall is that the model has at y = 0."""
    assert isinstance(pose, InUse)
    if pose.warp is None:
        return 0.0
    return float(pose.warp.at(t_s).at(np.zeros((1, 3)))[0][0, 1])


def test_a_pose_comes_into_use_with_its_change_of_shape_at_once() -> None:
    candidate = Candidate(changed(0.0, 2.0), RECORD, LAST_BEAT, None)
    pose, _ = next_pose(candidate, beat())
    assert y_of(pose, NOW_S) == pytest.approx(2.0, abs=1e-6)


def test_a_change_of_shape_comes_and_goes_at_a_bounded_speed() -> None:
    pose, _ = next_pose(IN_USE, Registered(NOW_S, RECORD, changed(0.0, 2.0), 0.0))
    assert isinstance(pose, InUse)
    assert pose.warp is not None
    assert [round(y_of(pose, NOW_S + t), 3) for t in (-1.0, 0.0, 0.1, 0.2, 9.0)] == [0.0, 0.0, 1.0, 2.0, 2.0]
    assert pose.motion.end_s == pose.warp.end_s
    later = replace(beat(begin_s=NOW_S + 0.1), now_s=NOW_S + 0.1)
    on_its_way, _ = next_pose(pose, later)
    assert y_of(on_its_way, NOW_S + 0.15) == pytest.approx(1.5, abs=1e-3)
    back, _ = next_pose(pose, replace(registered(0.0), now_s=NOW_S + 4.0))
    assert [round(y_of(back, NOW_S + 4.0 + t), 3) for t in (0.0, 0.1, 0.3)] == [2.0, 1.0, 0.0]
    done, _ = next_pose(back, replace(beat(begin_s=NOW_S + 5.0), now_s=NOW_S + 6.0))
    assert isinstance(done, InUse)
    assert done.warp is None


def test_a_warp_that_is_reached_holds_the_uncertainty_of_its_registration() -> None:
    pose, _ = next_pose(IN_USE, Registered(NOW_S, RECORD, changed(0.0, 2.0), 0.0))
    assert isinstance(pose, InUse)
    estimate = pose.estimate
    np.testing.assert_array_equal(pose.covariance_mm2(NOW_S), estimate.total_mm2)
    np.testing.assert_array_equal(pose.covariance_mm2(NOW_S + 9.0), estimate.covariance_mm2)
    np.testing.assert_array_equal(IN_USE.covariance_mm2(NOW_S + 9.0), IN_USE.estimate.total_mm2)


def test_walls_stay_where_a_registration_saw_them_when_its_pose_is_fused() -> None:
    """The fused pose lies between both; the warp makes up for it."""
    pose, _ = next_pose(IN_USE, Registered(NOW_S, RECORD, changed(2.0, 1.0), 0.0))
    assert isinstance(pose, InUse)
    fused = pose.estimate.pose.translation_mm[0]
    assert 0.2 < fused < 1.8
    assert pose.warp is not None
    tracker = np.zeros((1, 3))
    end = pose.warp.at(NOW_S + 9.0)
    place = pose.estimate.pose.apply_array(tracker)
    np.testing.assert_allclose((place - end.at(place)[0])[0], [2.0, -1.0, 0.0], atol=1e-4)


def test_a_suspended_pose_comes_back_with_its_change_of_shape() -> None:
    pose, _ = next_pose(replace(SUSPENDED, estimate=changed(0.0, 2.0), trial=LAST_BEAT), beat())
    assert y_of(pose, NOW_S) == pytest.approx(2.0, abs=1e-6)
