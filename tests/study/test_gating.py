"""The gating study: scores against closed forms, numbers on real and synthetic recordings."""

import json
from pathlib import Path

import numpy as np
import pytest
from drawn_lines import x_of, y_of
from typer.testing import CliRunner

from data_synth.signals.ecg import EcgSpec, synthetic_ecg
from data_synth.signals.rhythm import RhythmSpec, beat_series
from dvf_ig.cardiac import detect_r_peaks
from dvf_ig.cli.main import app
from dvf_ig.core import PhaseState, PhaseTrack
from dvf_ig.io import BeatAnnotations, read_annotations
from dvf_ig.study.gating import (
    RISK_POINTS,
    PhaseErrors,
    match_beats,
    phase_errors,
    predictor_errors,
    rhythm_class,
    risk_coverage,
    risk_coverage_figure,
    summarise_phase,
)


@pytest.mark.parametrize("rate_hz", [100.0, 128.0, 250.0, 360.0, 1000.0])
def test_synthetic_ecg_at_any_rate(rate_hz: float) -> None:
    rng = np.random.default_rng(5)
    beats = beat_series(RhythmSpec(ectopic_share=0.05), -3.0, 63.0, rng)
    found = np.array([p.t_s for p in detect_r_peaks(synthetic_ecg(beats, 60.0, EcgSpec(rate_hz), rng))])
    truth = beats.r_peaks_s[(beats.r_peaks_s > 0.5) & (beats.r_peaks_s < 59.5)]
    hits, partner = match_beats(found, truth, 0.05)
    assert len(hits) == len(truth)
    assert len(found) <= len(truth) + 2, "only beats at the very ends may be besides"
    assert np.median(np.abs(found[partner] - truth[hits])) <= max(0.003, 0.6 / rate_hz)


def test_matching_is_one_to_one_and_prefers_the_nearer() -> None:
    truth = np.array([1.0, 2.0, 3.0])
    hits, partner = match_beats(np.array([0.9, 1.02, 2.2, 3.0]), truth, 0.15)
    assert hits.tolist() == [0, 2]
    assert partner.tolist() == [1, 3]


def annotated(beats_s: list[float], symbols: str, rhythms: tuple[tuple[float, str], ...]) -> BeatAnnotations:
    return BeatAnnotations(np.array(beats_s), tuple(symbols), rhythms)


def test_phase_error_against_a_closed_form() -> None:
    truth = annotated([0.0, 1.0, 2.0], "NNN", ((0.0, "N"), (1.0, "AFIB")))
    t = np.arange(0.05, 1.95, 0.1)
    state = np.full(len(t), int(PhaseState.LOCKED))
    state[t > 1.0] = int(PhaseState.IRREGULAR)
    ahead = PhaseTrack(t, (t + 0.03) % 1.0, np.full(len(t), 0.02), np.ones(len(t)), state)
    errors = phase_errors(ahead, truth)
    assert np.allclose(errors.error, 0.03)
    summary = summarise_phase([errors])
    assert summary.mean_percent == pytest.approx(3.0)
    assert summary.valid_share == pytest.approx((t < 1.0).mean())
    assert summary.within_2_sigma == 1.0
    assert summary.fibrillation_refused == 1.0


def test_nothing_valid_is_no_number() -> None:
    nothing = PhaseErrors(np.zeros(3), np.ones(3), np.zeros(3, dtype=bool), np.zeros(3, dtype=bool))
    summary = summarise_phase([nothing])
    assert summary.valid_share == 0.0
    assert np.isnan(summary.p95_percent)
    assert np.isnan(summary.fibrillation_refused)


def test_risk_falls_with_coverage_where_sigma_knows() -> None:
    rng = np.random.default_rng(8)
    sigma = rng.uniform(0.01, 0.1, 20_000)
    error = sigma * rng.standard_normal(len(sigma))
    every = np.ones(len(sigma), dtype=bool)
    share, p95 = risk_coverage(PhaseErrors(error, sigma, every, ~every))
    assert share[-1] == 1.0
    assert (np.diff(share) > 0).all()
    assert p95[0] < 0.3 * p95[-1]


def test_predictors_on_a_constant_and_on_bigeminy() -> None:
    steady = np.arange(40) * 0.8
    bigeminy = np.cumsum(np.tile([0.6, 1.1], 60))
    for name in ("ar8", "ewma", "last"):
        assert predictor_errors(name, steady).max() < 1e-9
    assert predictor_errors("ar8", bigeminy)[800:].mean() < 0.02
    assert predictor_errors("last", bigeminy).mean() > 0.15


def test_rhythm_class() -> None:
    t = np.arange(0.0, 100.0, 0.05)
    assert rhythm_class(annotated([1.0] * 100, "N" * 100, ((0.0, "N"),)), t) == "sinus"
    assert rhythm_class(annotated([1.0] * 100, "N" * 97 + "VVV", ((0.0, "N"),)), t) == "ectopic"
    flutters = ((0.0, "N"), (80.0, "AFIB"))
    assert rhythm_class(annotated([1.0] * 100, "N" * 100, flutters), t) == "fibrillation"


def test_annotations_of_a_real_record(data_dir: Path) -> None:
    pytest.importorskip("wfdb")
    notes = read_annotations(f"wfdb:{data_dir / 'mitdb-ds1' / '201'}")
    # PhysioNet's table for record 201: 1625 normal beats, 198 PVCs, 10:06 min of fibrillation
    assert notes.symbols.count("N") == 1625
    assert notes.symbols.count("V") == 198
    t = np.arange(0.0, 1805.5, 0.1)
    assert notes.within("AFIB", t).mean() * 1805.5 == pytest.approx(606, abs=1)


def test_gating_command_writes_what_it_prints(data_dir: Path, tmp_path: Path) -> None:
    pytest.importorskip("wfdb")
    arguments = ["study", "gating", "--records", str(data_dir / "mitdb-ds1"), "--only", "112", "--json"]
    done = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    line = json.loads(done.stdout.splitlines()[0])
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["records"] == [line]
    assert line["rhythm"] == "sinus"
    assert not line["tuning"]
    assert line["se_50"] > 0.995
    assert line["phase"]["mean_percent"] < 2.5
    assert line["phase"]["valid_share"] > 0.95
    assert (tmp_path / "out" / "risk_coverage.png").is_file()


def test_gating_command_refuses_an_empty_folder(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["study", "gating", "--records", str(tmp_path)])
    assert done.exit_code == 3
    assert "no annotated record" in done.output


def test_curves_and_dots() -> None:
    every, sigma = np.ones(1000, dtype=bool), np.linspace(0.01, 0.1, 1000)
    most = np.arange(1000) < 900
    rhythms = {
        "sinus": PhaseErrors(0.03 * every, sigma, most, ~every),
        "fibrillation": PhaseErrors(-0.02 * every, sigma, ~every, every),
    }
    lines = risk_coverage_figure(rhythms).axes[0].lines
    curve, dot, target, other = lines
    assert (x_of(curve)[0], x_of(curve)[-1]) == (2.0, 100.0)
    assert y_of(curve) == pytest.approx(np.full(RISK_POINTS, 3.0))
    assert (x_of(dot)[0], y_of(dot)[0]) == pytest.approx((90.0, 3.0))
    assert y_of(target)[0] == 8.0
    assert y_of(other) == pytest.approx(np.full(RISK_POINTS, 2.0))
