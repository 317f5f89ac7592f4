"""Prepare a session wrongly in each of thirteen ways, and replay it in spite of what is named.

A way is named if the check of the files (`config validate`) or the search for the cause of a refused
registration (`register`) says what is wrong. A session whose files are refused is replayed all the same:
the last line of defence is that no force is given while guidance is more than 5 mm off (hazard_s). `valid_s`
is the time with a valid pose and phase, `force_s` that in which a force was given.

    dvf-ig study preparation --seeds 1 --seed 8101 -o study
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from data_synth.heart.heart_spec import HeartSpec
from data_synth.scenario.presets import ScenarioSpec
from data_synth.scenario.recording import phantom_scenario
from dvf_ig.core import DvfIgError, DvfModel, Landmarks, Points, PoseStream, Rigid, Scenario, VolumeSeries
from dvf_ig.intake.calibrations import calibrate, calibrated
from dvf_ig.intake.fit import fit_of
from dvf_ig.intake.model_cache import cached_model
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.replay import result_of, run_replay
from dvf_ig.replay.registration import explain_refusal, prepare_registration
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials
from dvf_ig.study.options import option, seed_option, seeds_option

OTHERS = 1000
"""Another patient's recordings are of a seed so much higher."""


@dataclass(frozen=True, kw_only=True)
class PreparationSettings:
    """Options of the study."""

    seconds: float = option("Length of each intervention.", 30.0)
    seeds: int = seeds_option(1)
    seed: int = seed_option(8101)


class Recorded(NamedTuple):
    """A session, and recordings that do not belong to it.

    Attributes:
        right: calibrated and prepared as it should be.
        other: the recordings of another patient.
        other_day: calibrations of the same probe on another day.
    """

    right: Scenario
    other: Scenario
    other_day: Scenario


class Way(NamedTuple):
    """A way of preparing a session wrongly.

    Attributes:
        prepare: makes it of what was recorded.
        named: pattern of the sentence that names the cause.
    """

    prepare: Callable[[Recorded], Scenario]
    named: str


@lru_cache(maxsize=1)
def _recorded(seed: int, seconds: float) -> Recorded:
    spec = ScenarioSpec(seconds=seconds, seed=seed, heart=HeartSpec("varied"))
    right, other, other_day = (
        phantom_scenario(one)
        for one in (spec, replace(spec, seed=seed + OTHERS), replace(spec, preset="wrong-calibration"))
    )
    right, other, other_day = (calibrated(one, calibrate(one, 0)) for one in (right, other, other_day))
    return Recorded(right, other, other_day)


def _exchanged(recorded: Recorded) -> Scenario:
    """Probe and tool, each by the other's poses."""
    right = recorded.right
    probe, tool = right.ultrasound.stream("tracker", "probe"), _tool(right)
    rotations, shifts_mm, seen = tool.at_many(right.ultrasound.t_s)
    swapped = replace(probe, rotations=rotations, translations_mm=shifts_mm, valid=seen)
    return replace(_with_probe(right, swapped), tool=replace(probe, source="tool"))


def _probe_as_tool(recorded: Recorded) -> Scenario:
    return replace(
        recorded.right, tool=replace(recorded.right.ultrasound.stream("tracker", "probe"), source="tool")
    )


def _other_heart(recorded: Recorded) -> Scenario:
    right = recorded.right
    return replace(right, preop=replace(recorded.other.preop, patient_id=right.preop.patient_id))


def _other_ecg(recorded: Recorded) -> Scenario:
    return replace(recorded.right, ecg=recorded.other.ecg)


def _names(recorded: Recorded) -> Scenario:
    first, second, *others = _touched(recorded.right).names
    return _with_touched(recorded, Landmarks((second, first, *others), _touched(recorded.right).points))


def _metres(recorded: Recorded) -> Scenario:
    at = _touched(recorded.right)
    return _with_touched(recorded, Landmarks(at.names, Points(at.frame, 1e-3 * at.points.xyz_mm)))


def _inverse(recorded: Recorded) -> Scenario:
    probe = recorded.right.ultrasound.stream("tracker", "probe")
    turned = np.swapaxes(probe.rotations, 1, 2)
    shifts_mm = -np.einsum("nij,nj->ni", turned, probe.translations_mm)
    return _with_probe(recorded.right, replace(probe, rotations=turned, translations_mm=shifts_mm))


def _mirrored(recorded: Recorded) -> Scenario:
    recording = recorded.right.ultrasound
    assert recording.images is not None
    images = np.ascontiguousarray(np.flip(recording.images, axis=2))
    return replace(recorded.right, ultrasound=replace(recording, images=images), fan=None)


def _lag_sign(recorded: Recorded) -> Scenario:
    lag_s = recorded.right.latency
    assert isinstance(lag_s, float)
    return replace(recorded.right, latency=-lag_s)


def _other_day(recorded: Recorded) -> Scenario:
    return replace(recorded.right, probe=recorded.other_day.probe)


def _other_day_alone(recorded: Recorded) -> Scenario:
    """Without touched landmarks to contradict it."""
    return replace(_other_day(recorded), landmarks_mr=None, landmarks_tracker=None)


def _ras(recorded: Recorded) -> Scenario:
    start = recorded.right.start
    assert start is not None
    flip = np.diag([-1.0, -1.0, 1.0])
    return replace(
        recorded.right, start=Rigid("mr", "tracker", flip @ start.rotation, flip @ start.translation_mm)
    )


def _late_cine(recorded: Recorded) -> Scenario:
    """The cine's phases from a third of the cycle on."""
    preop = recorded.right.preop
    return replace(recorded.right, preop=replace(preop, mr=_rolled(preop.mr), labels=_rolled(preop.labels)))


def _still_heart(recorded: Recorded) -> Scenario:
    """The cine's first phase as every phase."""
    preop = recorded.right.preop
    return replace(recorded.right, preop=replace(preop, mr=_still(preop.mr), labels=_still(preop.labels)))


WAYS: dict[str, Way] = {
    "as it should be": Way(lambda recorded: recorded.right, r"$^"),
    "probe and tool exchanged": Way(_exchanged, "probe and tool look exchanged"),
    "the probe as tool": Way(_probe_as_tool, "those of the ultrasound probe"),
    "another patient's heart": Way(_other_heart, "another patient|of another cine"),
    "another patient's ECG": Way(_other_ecg, "of another recording"),
    "names of landmarks exchanged": Way(_names, "exchanged: the names"),
    "landmarks in m": Way(_metres, "in m, not mm"),
    "poses inverted": Way(_inverse, "probe_from_tracker"),
    "images mirrored": Way(_mirrored, "mirrored left to right"),
    "the latency's sign reversed": Way(_lag_sign, "sign"),
    "another day's probe calibration": Way(_other_day, "of another day or probe"),
    "the same without landmarks": Way(_other_day_alone, "of another day or probe"),
    "a start in RAS": Way(_ras, "RAS"),
    "a cine from another phase on": Way(_late_cine, "cine|phase"),
    "a heart that does not beat": Way(_still_heart, "does not beat"),
}
"""The first is not a wrong one; that of another day's calibration is tried twice."""


def _touched(scenario: Scenario) -> Landmarks:
    assert scenario.landmarks_tracker is not None
    return scenario.landmarks_tracker


def _with_touched(recorded: Recorded, at: Landmarks) -> Scenario:
    return replace(recorded.right, landmarks_tracker=at)


def _tool(scenario: Scenario) -> PoseStream:
    assert scenario.tool is not None
    return scenario.tool


def _with_probe(scenario: Scenario, probe: PoseStream) -> Scenario:
    return replace(scenario, ultrasound=replace(scenario.ultrasound, poses={probe.name: probe}))


def _rolled(series: VolumeSeries | None) -> VolumeSeries | None:
    if series is None:
        return None
    return replace(series, values=np.roll(series.values, len(series.values) // 3, axis=0))


def _still(series: VolumeSeries | None) -> VolumeSeries | None:
    if series is None:
        return None
    return replace(series, values=np.repeat(series.values[:1], len(series.values), axis=0))


def preparation_trial(settings: Settings, number: int) -> Line:
    """Prepare and replay one session.

    Args:
        settings: `seconds`.
        number: of seed and way, those of one seed one after the other.
    """
    seed, place = divmod(number, len(WAYS))
    name, way = list(WAYS.items())[place]
    scenario = way.prepare(_recorded(seed, settings["seconds"]))
    model = cached_model(scenario.preop).model
    said = list(_sentences(scenario, model))
    sentence = next((one for one in said if re.search(way.named, one)), "")
    line = {
        "way": name,
        "scenario_seed": seed,
        "named": bool(sentence),
        "cause": sentence or (said or [""])[0],
    }
    try:
        replay = run_replay(scenario, model=model)
    except DvfIgError as error:
        nothing = {"valid_s": 0.0, "force_s": 0.0, "hazard_s": 0.0, "tre_mm": None}
        return {**line, **nothing, "ended": str(error)}
    result, tick_s = result_of(replay), settings["seconds"] / len(replay.ticks)
    tre = result["tre_mm"]
    return {
        **line,
        "valid_s": tick_s * result["valid_ticks"],
        "force_s": tick_s * int(replay.ticks.force_n.any(axis=1).sum()),
        "hazard_s": result["hazard_s"],
        "tre_mm": None if tre is None else tre["median"],
        "ended": result["no_force"] or "",
    }


def _sentences(scenario: Scenario, model: DvfModel) -> Iterator[str]:
    """All that is said of a session before it is replayed."""
    fit = fit_of(SessionFiles.of(scenario, model))
    yield from (problem.sentence for problem in fit.misfits)
    yield from (finding.sentence for finding in fit.warnings)
    try:
        prepared = prepare_registration(scenario, model=model)
        result = prepared.register()
        if not result.stop.usable:
            yield explain_refusal(prepared, result) or result.sentence
            yield result.sentence
    except DvfIgError as error:
        yield str(error)


def run(settings: PreparationSettings, driver: Driver) -> Result:
    """Replay every way on every seed."""
    fields = {"seconds": settings.seconds, "ways": list(WAYS)}
    numbers = range(settings.seed * len(WAYS), (settings.seed + settings.seeds) * len(WAYS))
    lines = driver.trials(Trials("preparation", fields, preparation_trial), numbers, group_size=len(WAYS))
    summary = {**fields, "seed": settings.seed, "seeds": settings.seeds, "rows": lines}
    return Result(summary, _table(lines), {"summary.json": summary})


def _table(lines: Sequence[Line]) -> Rows:
    head = ("prepared", "seeds", "named", "valid s", "force s", "hazard s", "TRE mm", "cause")
    return [head, *(_row(name, [line for line in lines if line.get("way") == name]) for name in WAYS)]


def _row(name: str, lines: Sequence[Line]) -> tuple[str, ...]:
    """Largest values over the seeds, and the cause that the first one names."""
    if not lines:
        return (name, "0", *("",) * 6)
    errors = [line["tre_mm"] for line in lines if line["tre_mm"] is not None]
    return (
        name,
        str(len(lines)),
        str(sum(line["named"] for line in lines)),
        *(f"{max(line[key] for line in lines):.1f}" for key in ("valid_s", "force_s", "hazard_s")),
        f"{max(errors):.1f}" if errors else "",
        str(lines[0]["cause"])[:70],
    )


STUDY = Study(PreparationSettings, run)
