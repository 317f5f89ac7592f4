"""The picture of a gated recording: a strip where all is well, the worst of each state, none overlapping."""

import numpy as np

from dvf_ig.core import PhaseState, PhaseTrack
from dvf_ig.report.gating import STRIP_S, STRIPS, choose_strips, gate_png, shown_segments

T_S = np.arange(0.0, 200.0, 0.05)


def track(lost: tuple[float, float] = (102.0, 108.0)) -> PhaseTrack:
    away = (lost[0] <= T_S) & (lost[1] > T_S)
    state = np.where(away, int(PhaseState.LOST), int(PhaseState.LOCKED))
    n = len(T_S)
    return PhaseTrack(T_S, T_S % 1.0, np.full(n, 0.01), np.ones(n), state)


def test_strips_show_the_worst_and_do_not_overlap() -> None:
    chosen = choose_strips(track())
    assert 100.0 in chosen, "where the R peaks were lost"
    assert len(chosen) <= STRIPS
    assert (np.diff(chosen) >= STRIP_S).all()


def test_a_picture_needs_no_ecg() -> None:
    peaks = np.arange(0.0, 200.0, 1.0)
    assert gate_png("trigger", None, peaks, track()).startswith(b"\x89PNG")


def test_what_has_r_peaks_again_is_not_shown_as_lost() -> None:
    peaks = np.concatenate([np.arange(0.0, 101.5, 1.0), np.arange(105.0, 200.0, 1.0)])
    lost = [(begin, end) for begin, end, state in shown_segments(track(), peaks) if state is PhaseState.LOST]
    assert lost == [(102.0, 105.0)]
