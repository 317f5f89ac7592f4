"""Every heart draws inside the one table of ranges, each value from its own stream."""

import ast
from pathlib import Path

import pytest

import data_synth.second_world
from data_synth.second_world.drawn import QUALITIES, SEVERITY, Drawn, Quality
from data_synth.second_world.probes import drawn_probe, probe_kind
from data_synth.second_world.ranges import KINDS, RANGES
from dvf_ig.core import InvalidInputError

SEEDS = range(5001, 5011)
FOLDER = Path(data_synth.second_world.__file__).parent

THEORY = {
    "labels.noise_mm": (0.5, 1.5),
    "labels.noise_length_mm": (8.0, 8.0),
    "labels.outer_bias_mm": (-0.7, 0.7),
    "labels.blood_bias_mm": (-0.7, 0.7),
    "image.dynamic_range_db": (40.0, 80.0),
    "blood.echo_db": (-35.0, -12.0),
    "heart.contractility": (-0.3, 0.3),
    "heart.mismatch_length_mm": (10.0, 60.0),
    "heart.mismatch_beating_length_mm": (10.0, 60.0),
    "image.sound_speed": (0.0, 0.015),
}
"""What `theory/trust.md` asks of this world in numbers."""

TABLES = {
    "data_synth.heart.clock",
    "data_synth.heart.mismatch",
    "data_synth.ultrasound.presets",
    "data_synth.ultrasound.image_faults",
    "data_synth.mr.cine",
    "data_synth.mr.stack",
    "data_synth.scenario.presets",
    "data_synth.scenario.ground_truth",
    "data_synth.scenario.image_pair",
    "data_synth.scenario.world",
}
"""Modules of the first world that hold its values; of `heart.tissue` only names are taken."""


@pytest.mark.parametrize("name", THEORY)
def test_the_table_holds_what_the_theory_asks_for(name: str) -> None:
    known = RANGES[name]
    assert (min(known.low, known.high), max(known.low, known.high)) == THEORY[name]


@pytest.mark.parametrize("quality", QUALITIES)
def test_every_value_lies_in_its_range_and_in_the_part_of_its_quality(quality: Quality) -> None:
    mild, severe = SEVERITY[quality]
    for seed in SEEDS:
        for name, value in Drawn(seed, quality).table().items():
            known = RANGES[name]
            size = abs(value) if known.either_sign else value
            ends = (known.low, known.high)
            if known.graded:
                wide = known.high - known.low
                ends = (known.low + mild * wide, known.low + severe * wide)
            assert min(ends) - 1e-9 <= size <= max(ends) + 1e-9, name


def test_values_differ_between_hearts_and_between_names() -> None:
    tables = [Drawn(seed, "calm").table() for seed in SEEDS]
    for name, known in RANGES.items():
        distinct = len({table[name] for table in tables})
        assert distinct == (1 if known.low == known.high else len(SEEDS)), name
    shares = {
        (value - known.low) / (known.high - known.low)
        for name, known in RANGES.items()
        if not (known.graded or known.log or known.either_sign or known.low == known.high)
        for value in [tables[0][name]]
    }
    assert len(shares) > 60


def test_every_kind_of_probe_is_used_and_fits_its_table() -> None:
    kinds = {probe_kind(Drawn(seed, "calm")) for seed in range(5001, 5031)}
    assert kinds == set(KINDS)
    for seed in SEEDS:
        drawn = Drawn(seed, "poor-image")
        probe, kind = drawn_probe(drawn), probe_kind(drawn)
        assert RANGES[f"{kind}.depth_mm"].low <= probe.depth_mm <= RANGES[f"{kind}.depth_mm"].high
        assert probe.fan.half_angle_rad == probe.half_angle_rad


@pytest.mark.parametrize(("seed", "quality"), [(-1, "calm"), (1, "fine")])
def test_what_cannot_be_drawn_is_refused(seed: int, quality: Quality) -> None:
    with pytest.raises(InvalidInputError, match="calm, poor-image"):
        Drawn(seed, quality)


def test_no_table_of_the_first_world_is_imported() -> None:
    """Read from the source: which modules, and of the tissue table only names of tissues and labels."""
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                modules = [str(node.module)]
                if node.module == "data_synth.heart.tissue":
                    assert {a.name for a in node.names} <= {"Tissue", "LABEL_NAMES", "FIRST_OUTSIDE"}, path
            assert not TABLES & set(modules), path
