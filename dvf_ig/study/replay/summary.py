"""What the replays of each preset say together; the unit is the seed: it draws heart, patient and noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.session.pose.registration_monitor import ELSEWHERE_BEATS
from dvf_ig.study.trials import Line


@dataclass(frozen=True, slots=True)
class PresetSummary:
    """One preset over its seeds.

    Attributes:
        preset: its name.
        seeds: replays; refused: those that ended in an error.
        guided: replays that gave a force at any time; the numbers below are over these, medians unless said.
        tre_median_mm, tre_worst_mm: median TRE of each replay: their median and their largest.
        force_error_n: median error in contact.
        valid_share: of the ticks.
        served_share: of the ticks in contact.
        hazard_s: largest time with a force on a pose more than 5 mm off; hazard_longest_s: at a stretch.
        withheld_s: time in which the pose was suspended or unconfirmed.
        latched_s: time in which the operator had to re-arm.
        tip_seen: replays in which images showed the tool's tip; tip_elsewhere: of them
            for so long beside its place that no pose was used.
    """

    preset: str
    seeds: int
    refused: int
    guided: int
    tre_median_mm: float | None
    tre_worst_mm: float | None
    force_error_n: float | None
    valid_share: float | None
    served_share: float | None
    hazard_s: float | None
    hazard_longest_s: float | None
    withheld_s: float | None
    latched_s: float | None
    tip_seen: int
    tip_elsewhere: int


def summarise_replays(lines: Sequence[Line], presets: Sequence[str]) -> list[PresetSummary]:
    """A summary of each preset, in the order in which `trial_of` numbers them."""
    return [
        _summary(preset, [line for line in lines if line["seed"] % len(presets) == place])
        for place, preset in enumerate(presets)
    ]


def _summary(preset: str, lines: Sequence[Line]) -> PresetSummary:
    scored = [line for line in lines if "refused" not in line]
    tre = [line["tre_mm"]["median"] for line in scored if line["tre_mm"]]
    return PresetSummary(
        preset=preset,
        seeds=len(lines),
        refused=len(lines) - len(scored),
        guided=len(tre),
        tre_median_mm=_median(tre),
        tre_worst_mm=max(tre, default=None),
        force_error_n=_median([x["force_error_n"]["median"] for x in scored if x["force_error_n"]]),
        valid_share=_median([x["valid_ticks"] / x["ticks"] for x in scored]),
        served_share=_median([x["contact"]["served_share"] for x in scored if x["contact"]]),
        hazard_s=max((x["hazard_s"] for x in scored), default=None),
        hazard_longest_s=max((x["hazard_longest_s"] for x in scored), default=None),
        withheld_s=_median([x["withheld_s"] for x in scored]),
        latched_s=_median([x["supervisor"]["latched_s"] for x in scored]),
        tip_seen=sum(x["tip_in_image"] is not None for x in scored),
        tip_elsewhere=sum(
            x["tip_in_image"] is not None and x["tip_in_image"]["elsewhere_beats"] >= ELSEWHERE_BEATS
            for x in scored
        ),
    )


def _median(values: Sequence[Any]) -> float | None:
    return float(np.median(values)) if values else None
