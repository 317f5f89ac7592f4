"""The recordings that are made of each heart of a study, and the numbers of their trials."""

from dataclasses import dataclass

from dvf_ig.study.trials import Settings

PER_HEART = 100
"""Trials that one heart may have: a trial's number is PER_HEART · heart + place of its condition."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Of one recording.

    Attributes:
        quality: preset of the scenario.
        draw: 0: the plain preset; from 1 on: with errors of calibration, clock, anatomy and start drawn anew.
    """

    quality: str
    draw: int

    @property
    def disturbed(self) -> bool:
        return self.draw > 0


def conditions_of(settings: Settings) -> list[Condition]:
    """Every condition of a study.

    Args:
        settings: `qualities`, and `disturbed`, how many disturbed recordings of each quality.
    """
    draws = range(settings["disturbed"] + 1)
    return [Condition(quality, draw) for quality in settings["qualities"] for draw in draws]


def trial_numbers(hearts: range, settings: Settings) -> list[int]:
    """Number of every trial; those of a heart follow one another."""
    count = len(conditions_of(settings))
    return [PER_HEART * heart + place for heart in hearts for place in range(count)]


def of_trial(number: int, settings: Settings) -> tuple[int, Condition]:
    """Heart and condition of a trial."""
    heart, place = divmod(number, PER_HEART)
    return heart, conditions_of(settings)[place]
