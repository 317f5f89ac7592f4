"""Make interventions, replay each from raw streams to force, and score it: TRE, force, and hazard_s.

hazard_s is the time in which a force was given while guidance was more than 5 mm off: the pose, or where a
change of shape is followed, the wall at the tool. The table shows the largest over the seeds. The unit is the
seed: it draws patient and noise, and with `--heart varied` the heart too; the share of pose updates within
their bound has an interval over resampled seeds. What holds from SETTLED_S on, when the motion in breathing
has been learnt, has columns of its own in sessions that last longer, and so has what is served before that,
at end-expiration; with calm among the presets, also the settled TRE relative to that of the same seed without
breathing. With `--cines` the pre-operative images are real short-axis cines, and the hearts those of the
experts' labels.

    dvf-ig study replay --preset lost-ultrasound --seeds 10 -o study
    dvf-ig study replay --preset calm --heart varied --seconds 40 --seeds 20 --seed 7101 -o study
    dvf-ig study replay --preset calm --preset ventilated --preset breathing --seconds 80 --seeds 10 -o study
    dvf-ig study replay --preset unrecorded-breathing --seconds 60 --seeds 10 -o study
    dvf-ig study replay --preset calm --cines acdc --voxel-mm 1.5,1.5,10 --seeds 3 -o study
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np

from data_synth import PRESETS, CineHeart, HeartSpec, MotionPreset, ScenarioSpec, preset_name
from data_synth.scenario.recording import cine_scenario, phantom_scenario
from dvf_ig.core import BoolArray, InvalidInputError, Scenario, VolumeSeries
from dvf_ig.intake.model_cache import cached_model
from dvf_ig.replay import Replay, result_of, run_replay
from dvf_ig.replay.result.errors import true_contact
from dvf_ig.replay.result.pose import bounded_rms_mm
from dvf_ig.replay.result.score import CONTACT_MM, pose_errors_mm
from dvf_ig.session.pose_states import ELSEWHERE_BEATS
from dvf_ig.study.cines import VOXEL_HELP, labelled_cines, read_labelled_cine
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials
from dvf_ig.study.options import option, seed_option, seeds_option
from dvf_ig.study.statistics import Estimate, estimate_text, median_of, number_text, share_over_hearts


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """Options of the study."""

    preset: tuple[str, ...] = option("One preset; may be repeated (default: all).", ())
    motion: MotionPreset = option("How far the heart moves.", "paper5mm")
    heart: Literal["standard", "varied"] = option("One heart for all seeds, or another for each.", "standard")
    cines: Path | None = option("Folder of patients as for `study cines`, whose hearts are replayed.", None)
    voxel_mm: tuple[float, float, float] | None = option(VOXEL_HELP, None)
    seconds: float = option("Length of each intervention.", 60.0)
    seeds: int = seeds_option(10)
    seed: int = seed_option(1)


SETTLED_S = 60.0
EVERY = 10
"""Ticks from one that is scored to the next in a part of a replay."""


@dataclass(frozen=True, slots=True)
class PartScore:
    """A part of a replay, while a pose is in use.

    Attributes:
        tre_median_mm, tre_p95_mm: over targets and ticks.
        served_share: of the ticks in contact.
        bound_coverage: share of ticks at which the stated bound covers the RMS error that it refers to
            (`bounded_rms_mm`).
        error_per_sigma: RMS of that error over half of the bound.
    """

    tre_median_mm: float
    tre_p95_mm: float
    served_share: float
    bound_coverage: float
    error_per_sigma: float


@dataclass(frozen=True, slots=True)
class PresetSummary:
    """One preset over its seeds.

    Attributes:
        preset: its name; patient: of the cine, None for phantoms.
        seeds: replays; refused: those that ended in an error.
        guided: replays that gave a force at any time; the numbers below are over these, medians unless said.
        tre_median_mm, tre_worst_mm: median TRE of each replay: their median and their largest.
        force_error_n: median error in contact.
        wall_rms_mm: RMS error of the wall's place at the tool: median; wall_far_off_s: largest time with a
            force on one more than 3 mm off.
        valid_share: of the ticks.
        served_share: of the ticks in contact; served_known_share: of those where the model knows the heart.
        hazard_s: largest time with a force more than 5 mm off; hazard_longest_s: at a stretch.
        withheld_s: time in which the pose was suspended or unconfirmed.
        latched_s: time in which the operator had to re-arm.
        tip_seen: replays in which images showed the tool's tip; tip_elsewhere: of them
            for so long away from its expected position that no pose was used.
        pose_updates: updates of poses in use; pose_bound_mm: median over seeds of the median stated bound.
        pose_bound_covers: share of these updates whose RMS error over the heart is within the stated bound.
        settled: from SETTLED_S on, medians of its fields; None if no replay lasts longer.
        settled_p95_worst_mm: largest of the settled p95.
        over_calm: median over seeds of the settled median TRE over that of the same seed's calm replay.
        gate: of the breathing heart before forces follow the breath, if they ever do; medians.
        gate_p95_worst_mm: largest of its p95.
    """

    preset: str
    patient: str | None
    seeds: int
    refused: int
    guided: int
    tre_median_mm: float | None
    tre_worst_mm: float | None
    force_error_n: float | None
    wall_rms_mm: float | None
    wall_far_off_s: float | None
    valid_share: float | None
    served_share: float | None
    served_known_share: float | None
    hazard_s: float | None
    hazard_longest_s: float | None
    withheld_s: float | None
    latched_s: float | None
    tip_seen: int
    tip_elsewhere: int
    pose_updates: int
    pose_bound_mm: float | None
    pose_bound_covers: Estimate
    settled: PartScore | None
    settled_p95_worst_mm: float | None
    over_calm: float | None
    gate: PartScore | None
    gate_p95_worst_mm: float | None


Kind = tuple[str, str | None]
"""Preset, and patient of a cine or None for a phantom."""


def summarise_replays(lines: Sequence[Line], kinds: Sequence[Kind]) -> list[PresetSummary]:
    """A summary of each kind, in the order in which `trial_of` numbers them."""
    of_kind = {
        kind: [line for line in lines if line["seed"] % len(kinds) == place]
        for place, kind in enumerate(kinds)
    }
    calm_mm = {
        (line["scenario_seed"], patient): line["settled"]["tre_median_mm"]
        for (preset, patient), calm in of_kind.items()
        for line in calm
        if preset == "calm" and line.get("settled")
    }
    return [_summary(kind, of_kind[kind], calm_mm) for kind in kinds]


def _summary(
    kind: Kind, lines: Sequence[Line], calm_mm: Mapping[tuple[int, str | None], float]
) -> PresetSummary:
    scored = [line for line in lines if "refused" not in line]
    tre = [line["tre_mm"]["median"] for line in scored if line["tre_mm"]]
    bounds = [line["pose_bound_mm"] for line in scored if line["pose_bound_mm"]]
    return PresetSummary(
        preset=kind[0],
        patient=kind[1],
        seeds=len(lines),
        refused=len(lines) - len(scored),
        guided=len(tre),
        tre_median_mm=median_of(tre),
        tre_worst_mm=max(tre, default=None),
        force_error_n=median_of([x["force_error_n"]["median"] for x in scored if x["force_error_n"]]),
        wall_rms_mm=median_of([x["surface_error_mm"]["rms"] for x in scored if x["surface_error_mm"]]),
        wall_far_off_s=max(
            (x["surface_error_mm"]["force_far_off_s"] for x in scored if x["surface_error_mm"]), default=None
        ),
        valid_share=median_of([x["valid_ticks"] / x["ticks"] for x in scored]),
        served_share=median_of([x["contact"]["served_share"] for x in scored if x["contact"]]),
        served_known_share=median_of([x["contact"]["served_known_share"] for x in scored if x["contact"]]),
        hazard_s=max((x["hazard_s"] for x in scored), default=None),
        hazard_longest_s=max((x["hazard_longest_s"] for x in scored), default=None),
        withheld_s=median_of([x["withheld_s"] for x in scored]),
        latched_s=median_of([x["supervisor"]["latched_s"] for x in scored]),
        tip_seen=sum(x["tip_in_image"] is not None for x in scored),
        tip_elsewhere=sum(
            x["tip_in_image"] is not None and x["tip_in_image"]["elsewhere_beats"] >= ELSEWHERE_BEATS
            for x in scored
        ),
        pose_updates=sum(bound["updates"] for bound in bounds),
        pose_bound_mm=median_of([bound["median"] for bound in bounds]),
        pose_bound_covers=share_over_hearts([_held(bound) for bound in bounds]),
        settled=_median_score(scored, "settled"),
        settled_p95_worst_mm=_worst_p95_mm(scored, "settled"),
        over_calm=median_of(
            [
                x["settled"]["tre_median_mm"] / calm_mm[x["scenario_seed"], kind[1]]
                for x in scored
                if x["settled"] is not None and (x["scenario_seed"], kind[1]) in calm_mm
            ]
        ),
        gate=_median_score(scored, "gate"),
        gate_p95_worst_mm=_worst_p95_mm(scored, "gate"),
    )


def _median_score(lines: Sequence[Line], part: str) -> PartScore | None:
    scores = [line[part] for line in lines if line[part] is not None]
    if not scores:
        return None
    return PartScore(
        **{field.name: float(np.median([x[field.name] for x in scores])) for field in fields(PartScore)}
    )


def _worst_p95_mm(lines: Sequence[Line], part: str) -> float | None:
    return max((line[part]["tre_p95_mm"] for line in lines if line[part] is not None), default=None)


def settled_part(replay: Replay) -> PartScore | None:
    """Score a replay from SETTLED_S on; None if it is shorter, or no pose is in use then."""
    return _part(replay, replay.ticks.t_s >= SETTLED_S)


def gate_part(replay: Replay) -> PartScore | None:
    """Score a replay of a breathing heart before forces follow the breath; None if there was no pose then."""
    truth, t_s = replay.scenario.truth, replay.ticks.t_s
    if truth is None or truth.breathing is None or not replay.poses:
        return None
    learnt_s = [record.from_s for record in replay.history.breathing if record.breaths is not None]
    return _part(replay, (t_s >= replay.poses[0][0]) & (t_s < min(learnt_s, default=np.inf)))


def _part(replay: Replay, chosen: BoolArray) -> PartScore | None:
    """Score (n,) chosen ticks; None if no pose is in use in any of them."""
    ticks, truth = replay.ticks, replay.scenario.truth
    used = np.flatnonzero(chosen & ticks.valid)[::EVERY]
    contact = chosen & (true_contact(replay)[0] >= CONTACT_MM)
    if truth is None or not len(used):
        return None
    errors_mm = pose_errors_mm(ticks.mr_from_tracker[used], ticks.t_s[used], truth)
    rms_mm, bound_mm = bounded_rms_mm(replay, truth, used), ticks.pose_bound_mm[used]
    served = ticks.guided & ticks.force_n.any(axis=1)
    return PartScore(
        tre_median_mm=float(np.median(errors_mm)),
        tre_p95_mm=float(np.percentile(errors_mm, 95)),
        served_share=float(served[contact].mean()) if contact.any() else 0.0,
        bound_coverage=float((rms_mm <= bound_mm).mean()),
        error_per_sigma=float(np.sqrt(((rms_mm / (0.5 * bound_mm)) ** 2).mean())),
    )


def _held(bound: Mapping[str, float]) -> list[bool]:
    """Whether the bound held, for each update of one replay."""
    count = round(bound["coverage"] * bound["updates"])
    return [place < count for place in range(int(bound["updates"]))]


KEPT = (
    "tre_mm",
    "phase_error_percent_rr",
    "force_error_n",
    "contact",
    "surface_error_mm",
    "hazard_s",
    "hazard_longest_s",
    "withheld_s",
    "valid_ticks",
    "ticks",
    "supervisor",
    "tip_in_image",
    "pose_bound_mm",
    "seconds",
)
"""Fields of a replay's result that a line keeps."""


def trial_of(settings: Settings, number: int) -> tuple[int, Kind]:
    """Seed and kind of a trial; those of one seed follow one another."""
    kinds = settings["kinds"]
    preset, patient = kinds[number % len(kinds)]
    return number // len(kinds), (preset, patient)


def trial_numbers(kinds: int, first_seed: int, seeds: int) -> range:
    """Numbers of the trials of consecutive seeds."""
    return range(first_seed * kinds, (first_seed + seeds) * kinds)


def replay_trial(settings: Settings, number: int) -> Line:
    """Make, replay and score one intervention.

    Args:
        settings: `kinds`, `motion`, `heart`, `seconds`, `cines`, `voxel_mm`.
        number: see `trial_of`.
    """
    seed, (preset, patient) = trial_of(settings, number)
    spec = ScenarioSpec(
        preset=preset,
        motion=settings["motion"],
        heart=HeartSpec(settings["heart"]),
        seconds=settings["seconds"],
        seed=seed,
    )
    scenario = phantom_scenario(spec) if patient is None else _patient_scenario(spec, settings, patient)
    replay = run_replay(scenario, model=cached_model(scenario.preop).model)
    result, settled, gate = result_of(replay), settled_part(replay), gate_part(replay)
    return {
        "scenario_seed": seed,
        "preset": preset,
        "patient": patient,
        "usable_registrations": sum(a["usable"] for a in result["registrations"]),
        "registrations": len(result["registrations"]),
        "settled": None if settled is None else asdict(settled),
        "gate": None if gate is None else asdict(gate),
        **{name: result[name] for name in KEPT},
    }


def _patient_scenario(spec: ScenarioSpec, settings: Settings, patient: str) -> Scenario:
    """Record a scenario on a real cine, whose first phase is made end-diastole."""
    cine = read_labelled_cine(Path(settings["cines"]) / patient, settings["voxel_mm"])
    values = np.roll(cine.image.values, -cine.ed_phase, axis=0)
    es_phase = (cine.es_phase - cine.ed_phase) % len(values)
    image = VolumeSeries(cine.image.grid, values, cine.image.timing)
    return cine_scenario(spec, CineHeart(patient, image, cine.ed, cine.es, es_phase))


def _patients(settings: ReplaySettings) -> list[str] | list[None]:
    """Names of the patients, all of whose files can be read; one None for phantoms."""
    if settings.cines is None:
        if settings.voxel_mm is not None:
            raise InvalidInputError("--voxel-mm belongs to --cines")
        return [None]
    folders = labelled_cines(settings.cines)
    for folder in folders:
        read_labelled_cine(folder, settings.voxel_mm)
    return [folder.name for folder in folders]


def run(settings: ReplaySettings, driver: Driver) -> Result:
    """Replay every preset on every seed."""
    named = [preset_name(name) for name in settings.preset]
    presets = list(dict.fromkeys(named)) or list(PRESETS)
    checked = ScenarioSpec(
        preset=presets[0], motion=settings.motion, seconds=settings.seconds, seed=settings.seed
    )
    kinds: list[Kind] = [(preset, patient) for patient in _patients(settings) for preset in presets]
    described = {
        "kinds": kinds,
        "cines": None if settings.cines is None else str(settings.cines),
        "voxel_mm": settings.voxel_mm,
        "motion": checked.motion,
        "heart": settings.heart,
        "seconds": checked.seconds,
    }
    lines = driver.trials(
        Trials("replay", described, replay_trial),
        trial_numbers(len(kinds), settings.seed, settings.seeds),
        group_size=len(kinds),
    )
    rows = summarise_replays(lines, kinds)
    summary = {**described, "seed": settings.seed, "seeds": settings.seeds, "rows": rows}
    return Result(summary, _table(rows), {"summary.json": summary})


def _table(rows: Sequence[PresetSummary]) -> Rows:
    head = (
        "preset",
        "guided",
        "TRE mm, worst",
        "force error N",
        "wall mm",
        "3 mm off s",
        "valid",
        "in contact, where known",
        "hazard s",
    )
    more = ("at a stretch", "withheld s", "latched s", "tip seen, elsewhere", "pose bound mm", "it covers")
    part = ("TRE mm, p95, worst", "in contact", "bound covers", "error/σ")
    late = (f"settled {part[0]}", *part[1:], "× calm", f"gate {part[0]}", *part[1:])
    return [(*head, *more, *late), *(_cells(row) for row in rows)]


def _cells(row: PresetSummary) -> tuple[str, ...]:
    tre = "" if row.tre_median_mm is None else f"{row.tre_median_mm:.2f}, {row.tre_worst_mm:.2f}"
    return (
        row.preset if row.patient is None else f"{row.patient}, {row.preset}",
        f"{row.guided} of {row.seeds}",
        tre,
        number_text(row.force_error_n, "{:.3f}", ""),
        number_text(row.wall_rms_mm, "{:.2f}", ""),
        number_text(row.wall_far_off_s, "{:.2f}", ""),
        number_text(row.valid_share, "{:.0%}", ""),
        number_text(row.served_share, "{:.0%}", "") + number_text(row.served_known_share, ", {:.0%}", ""),
        number_text(row.hazard_s, "{:.2f}", ""),
        number_text(row.hazard_longest_s, "{:.2f}", ""),
        number_text(row.withheld_s, "{:.1f}", ""),
        number_text(row.latched_s, "{:.1f}", ""),
        f"{row.tip_seen}, {row.tip_elsewhere}",
        number_text(row.pose_bound_mm, "{:.1f}", ""),
        f"{estimate_text(row.pose_bound_covers, '{:.0%}')} of {row.pose_updates} updates",
        *_part_cells(row.settled, row.settled_p95_worst_mm),
        number_text(row.over_calm, "{:.2f}", ""),
        *_part_cells(row.gate, row.gate_p95_worst_mm),
    )


def _part_cells(part: PartScore | None, worst_mm: float | None) -> tuple[str, ...]:
    if part is None:
        return ("", "", "", "")
    return (
        f"{part.tre_median_mm:.2f}, {part.tre_p95_mm:.2f}, {number_text(worst_mm, '{:.2f}', '')}",
        f"{part.served_share:.0%}",
        f"{part.bound_coverage:.0%}",
        f"{part.error_per_sigma:.2f}",
    )


STUDY = Study(ReplaySettings, run)
