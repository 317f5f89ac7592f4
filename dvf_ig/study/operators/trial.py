"""One simulated operator's work on one task, under every condition: a line of the study."""

from dataclasses import asdict
from typing import Any

from dvf_ig.study.trials import Line, Settings

from .conditions import ABLATIONS, BEATING, HAPTICS, NO_HAPTICS, TASKS, UNATTENDED, Condition
from .cutting import cut, cutting_measures
from .dissection import dissect, dissection_measures
from .heart import HEART_SEED, OperatingHeart, operating_heart, surface_of
from .tracking import track, tracked_place, tracking_measures

Measures = dict[str, float]


def operators_trial(settings: Settings, seed: int) -> Line:
    """All conditions of settings["task"], and the ablations of cutting.

    Returns:
        conditions, ablations: measures by name of the condition.
    """
    task, heart = str(settings["task"]), operating_heart()
    done = {c.name: measured(heart, task, c, seed) for c in TASKS[task]}
    line: dict[str, Any] = {"conditions": done}
    if task == "cutting":
        shared = {name: f"{BEATING}, {name}" for name in (NO_HAPTICS, HAPTICS, UNATTENDED)}
        line["ablations"] = {
            c.name: done[shared[c.name]] if c.name in shared else measured(heart, task, c, seed)
            for c in ABLATIONS
        }
    return line


def measured(heart: OperatingHeart, task: str, condition: Condition, seed: int) -> Measures:
    """Measures of one operator under one condition."""
    if task == "cutting":
        return cutting_measures(cut(heart, condition, seed))
    if task == "dissection":
        return dissection_measures(dissect(heart, condition, seed))
    place = tracked_place(heart, surface_of(HEART_SEED), seed)
    return tracking_measures(track(heart, place, condition, seed))


def operators_settings(task: str) -> Settings:
    """What a study's folder is bound to."""
    every = [*TASKS[task], *(ABLATIONS if task == "cutting" else ())]
    return {"task": task, "heart": HEART_SEED, "conditions": [asdict(c) for c in every]}
