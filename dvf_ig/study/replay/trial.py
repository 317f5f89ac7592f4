"""One trial: a synthetic intervention of one preset and one seed, made, replayed and scored."""

from data_synth.scenario.presets import ScenarioSpec
from data_synth.scenario.recording import phantom_scenario
from dvf_ig.intake import cached_model
from dvf_ig.replay import result_of, run_replay
from dvf_ig.study.trials import Line, Settings

KEPT = (
    "tre_mm",
    "phase_error_percent_rr",
    "force_error_n",
    "contact",
    "hazard_s",
    "hazard_longest_s",
    "withheld_s",
    "valid_ticks",
    "ticks",
    "supervisor",
    "tip_in_image",
    "seconds",
)
"""Fields of a replay's result that a line keeps."""


def trial_of(settings: Settings, number: int) -> tuple[int, str]:
    """Seed and preset of a trial; those of one seed follow one another."""
    presets = settings["presets"]
    return number // len(presets), presets[number % len(presets)]


def trial_numbers(presets: int, first_seed: int, seeds: int) -> range:
    """Numbers of the trials of consecutive seeds."""
    return range(first_seed * presets, (first_seed + seeds) * presets)


def replay_trial(settings: Settings, number: int) -> Line:
    """Make, replay and score one intervention.

    Args:
        settings: `presets`, `motion`, `seconds`.
        number: see `trial_of`.
    """
    seed, preset = trial_of(settings, number)
    spec = ScenarioSpec(preset=preset, motion=settings["motion"], seconds=settings["seconds"], seed=seed)
    scenario = phantom_scenario(spec)
    result = result_of(run_replay(scenario, model=cached_model(scenario.preop).model))
    return {
        "scenario_seed": seed,
        "preset": preset,
        "usable_registrations": sum(a["usable"] for a in result["registrations"]),
        "registrations": len(result["registrations"]),
        **{name: result[name] for name in KEPT},
    }
