"""Inputs, memory and records of the servo's kernels: every number by its name, defined here alone.

Structures are arrays of one record; kernels take the record (`array[0]`), whose fields cost what numbers at
an offset cost. Every field has 8 bytes, so that what threads share is copied word by word (`shared`). Hazards
are sums of bits in whole numbers.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.core.space.warp import COEFFICIENTS
from dvf_ig.kernels.composition import COMPOSED, work_size
from dvf_ig.kernels.place import POSE_AND_PHASE

_F, _I = np.float64, np.int64
MAX_FIXTURES = 8
MOST_SAMPLES = 64
"""Largest number of samples along a shaft."""

INPUTS = np.dtype(
    [
        ("valid_until_s", _F),
        ("clock_offset_s", _F),
        ("hazards", _I),
        ("tool_status", _I),
        ("tracker_from_device", _F, (3, 4)),
        ("tool_axis", _F, (3,)),
        ("margin_mm", _F, (MAX_FIXTURES,)),
        ("warps_number", _I),
        ("pose_and_phase", POSE_AND_PHASE),
    ]
)
"""Values published by a session. Only pose and phase live in the session's time: what fades, latches or times
out, and `valid_until_s`, runs by the servo's own clock, which no session can set back. The coefficients of
warps follow in the same memory (`Published`); they are copied where `warps_number` has changed. `tool_axis`
is the unit vector from the tip to the handle, tracker frame; 0: not known."""

FIXTURES = np.dtype(
    [
        ("walls", _I),
        ("others", _I),
        ("apart", _I, (MAX_FIXTURES,)),
        ("first", _I),
        ("first_linear", _I),
        ("structure_begin", _I, (MAX_FIXTURES,)),
        ("structure_shape", _I, (MAX_FIXTURES, 4)),
        ("far_outside", _I, (MAX_FIXTURES,)),
        ("cap_n", _F, (MAX_FIXTURES,)),
        ("forbidden", _F, (MAX_FIXTURES,)),
        ("base_width", _F, (MAX_FIXTURES,)),
        ("base_depth_mm", _F, (MAX_FIXTURES,)),
        ("widen_width", _F, (MAX_FIXTURES,)),
        ("widen_depth", _F, (MAX_FIXTURES,)),
        ("path_points", _I, (MAX_FIXTURES,)),
        ("path_phases", _I, (MAX_FIXTURES,)),
        ("path_first_point", _I, (MAX_FIXTURES,)),
        ("path_first_time", _I, (MAX_FIXTURES,)),
    ]
)
"""The fixtures' constants. A law's width grows by `widen_width` of the margin (1 of guidance, which it
softens), its depth by `widen_depth` (−1 of a forbidden region, +1 of a confinement, in the kernel's sign of
depth: both widen the region). `first` is the first fixture on the heart's surface, `first_linear` the first
that is linear in phase; `others` counts those `apart` from it. A path has `path_points` points in each of its
phases; any other fixture apart is on a structure, whose coefficients have `structure_shape` and begin at
`structure_begin`. A wall that is `far_outside` has no force outside the structure's box, which contains its
whole reach."""

LIMITS = np.dtype(
    [
        ("fade_s", _F),
        ("fast_fade_s", _F),
        ("slew_n_per_s", _F),
        ("slow_slew_n_per_s", _F),
        ("latch_after_s", _F),
        ("clamps_within_s", _F),
        ("rearm_below_n", _F),
        ("rearm_rise_s", _F),
        ("rearm_age_s", _F),
    ]
)
"""Limits of the supervisor."""

STATUSES = 7
HAZARDS = np.dtype(
    [
        ("fading", _I),
        ("fast", _I),
        ("at_once", _I),
        ("slowing", _I),
        ("latch_late", _I),
        ("latch_at_once", _I),
        ("not_finite", _I),
        ("force_clamped", _I),
        ("no_phase", _I),
        ("session_silent", _I),
        ("device_lost", _I),
        ("energy", _I),
        ("missed_deadlines", _I),
        ("of_status", _I, (STATUSES,)),
    ]
)
"""Bits of the hazards: by what they do to the force, of those that the servo finds, of each status."""

TOOL = np.dtype(
    [
        ("radius_mm", _F),
        ("shaft_mm", _F),
        ("pitch_mm", _F),
        ("samples", _I),
        ("trocar", _I),
        ("trocar_mm", _F, (3,)),
        ("length_mm", _F),
    ]
)
"""Constants of the tool; all 0 of a point. `radius_mm` is added to the distance of the primary fixture; the
shaft has `samples` places `pitch_mm` apart; `trocar`: whether it passes through `trocar_mm`, tracker frame;
`length_mm` leads from the hand to the tip where the device's position is the hand's, else 0."""

SETTINGS = np.dtype(
    [
        ("fixtures", FIXTURES),
        ("tool", TOOL),
        ("limits", LIMITS),
        ("hazards", HAZARDS),
        ("period_s", _F),
        ("cap_n", _F),
        ("lead_s", _F),
        ("predict_tool", _F),
        ("speed_share", _F),
        ("relative_damping", _F),
        ("friction_n", _F),
        ("slow_mm_s", _F),
        ("largest_damping", _F),
        ("residual_limit_mj", _F),
        ("delay_ticks", _I),
    ]
)
"""Constants while a servo runs; damping in N·s/mm."""

TISSUE = np.dtype(
    [
        ("felt", _I),
        ("warp_origin_mm", _F, (3,)),
        ("warp_per_mm", _F),
        ("label_origin_mm", _F, (3,)),
        ("label_per_mm", _F),
        ("stick_n_per_mm", _F),
    ]
)
"""Constants of tissue: whether it is felt instead of fixtures, the knots of its motion (named as those of a
change of shape), the grid of its properties, the stiffness of sticking friction."""

CLAMPS = 10
SUPERVISION = np.dtype(
    [
        ("state", _I),
        ("sent_n", _F, (3,)),
        ("last_s", _F),
        ("wanted_n", _F),
        ("hazards", _I),
        ("cause", _I),
        ("slow", _I),
        ("latch_due", _I),
        ("unsafe_since_s", _F),
        ("fade_from_n", _F, (3,)),
        ("fade_start_s", _F),
        ("fade_end_s", _F),
        ("rise_s", _F),
        ("rise_start_s", _F),
        ("scale", _F),
        ("clamped", _I),
        ("clamp_count", _I),
        ("clamps_s", _F, (CLAMPS,)),
    ]
)
"""Memory of the supervisor."""

SENT_KEPT = 32
"""Ticks of sent force that are remembered: the longest latency that can be accounted for, plus one."""
PASSIVITY = np.dtype(
    [
        ("started", _I),
        ("last_xyz_mm", _F, (3,)),
        ("last_field_n", _F, (3,)),
        ("surface_mm_s", _F, (3,)),
        ("residual_mj", _F),
        ("given_mj", _F),
        ("by_surface_mj", _F),
        ("damping", _F),
        ("sent_count", _I),
        ("sent_n", _F, (SENT_KEPT, 3)),
        ("parts", _I),
        ("parted", _I),
        ("part_n", _F, (MAX_FIXTURES, 3)),
        ("part_mm_s", _F, (MAX_FIXTURES, 3)),
        ("sent_part_n", _F, (SENT_KEPT, MAX_FIXTURES, 3)),
    ]
)
"""Memory of the passivity observer. With several structures `parts` fixtures have each its share of the field
and the velocity of its surface; `parted` is 1 from the first such tick on."""

MEMORY = np.dtype(
    [
        ("supervision", SUPERVISION),
        ("passivity", PASSIVITY),
        ("last_tick_s", _F),
        ("tool_known", _I),
        ("tool_mm", _F, (3,)),
        ("tool_mm_s", _F, (3,)),
        ("worst_share", _F),
        ("last_phase", _F),
        ("phase_known", _I),
        ("lever", _F),
        ("to_hand", _F, (3,)),
        ("anchored", _I),
        ("anchor_mm", _F, (3,)),
    ]
)
"""Memory from one tick to the next. `worst_share` is the progress from the fixtures of a known phase, 0, to
the walls of the worst one, 1; `last_phase` the last known phase of the model; `lever` and the unit vector
`to_hand` those of a fulcrum (`dvf_ig.kernels.servo.lever`); `anchor_mm` where friction
holds the tool, in the material of the tissue that it touches."""

SAMPLE = np.dtype(
    [
        ("distance_mm", _F),
        ("gradient", _F, (3,)),
        ("rate_mm_per_cycle", _F),
        ("distance_rate_mm_s", _F),
        ("sigma_mm", _F),
        ("parts", _I),
    ]
)
"""The primary fixture at the tool, tracker frame; NaN where there is none. `parts` counts the fixtures whose
shares are in `Scratch.part_n`: all with several structures and a known phase, else none."""

ROW = np.dtype(
    [
        ("t_s", _F),
        ("xyz_mm", _F, (3,)),
        ("field_n", _F, (3,)),
        ("wanted_n", _F, (3,)),
        ("sent_n", _F, (3,)),
        ("distance_mm", _F),
        ("gradient", _F, (3,)),
        ("rate_mm_per_cycle", _F),
        ("sigma_mm", _F),
        ("surface_mm_s", _F),
        ("status", _I),
        ("state", _I),
        ("hazards", _I),
        ("cause", _I),
        ("scale", _F),
        ("clamped", _I),
        ("conflict", _I),
        ("residual_mj", _F),
        ("given_mj", _F),
        ("by_surface_mj", _F),
        ("controller_damping", _F),
        ("lateness_ns", _I),
        ("work_ns", _I),
        ("tick", _I),
    ]
)
"""One row of the record: what a tick saw, wanted and sent."""


def words(array: Any) -> Any:
    """The memory of an array of records as (n,) int64."""
    return array.view(np.int64)


def row_words(rows: Any) -> Any:
    """The memory of (n,) ROW as (n, ROW_WORDS) int64."""
    return words(rows).reshape(len(rows), ROW_WORDS)


INPUT_WORDS, ROW_WORDS = INPUTS.itemsize // 8, ROW.itemsize // 8
_PLACES: Any = INPUTS.fields
WARPS_NUMBER_WORD = _PLACES["warps_number"][1] // 8
WARPS_SHAPE = (2, COEFFICIENTS, COEFFICIENTS, 4 * COEFFICIENTS)


class Published(NamedTuple):
    """Memory of one publication, in three forms.

    Attributes:
        words: (n,) int64, all of it; inputs: (1,) INPUTS, its first INPUT_WORDS.
        warps: WARPS_SHAPE float32, `dvf_ig.kernels.place.packed_warps` of the change of shape.
    """

    words: Any
    inputs: Any
    warps: Any


def new_published() -> Published:
    """Return a publication of zeros."""
    memory = np.zeros(INPUT_WORDS + math.prod(WARPS_SHAPE) // 2, dtype=np.int64)
    warps = memory[INPUT_WORDS:].view(np.float32).reshape(WARPS_SHAPE)
    return Published(memory, memory[:INPUT_WORDS].view(INPUTS), warps)


class Bound(NamedTuple):
    """Constants while a servo runs.

    Attributes:
        linear, periodic: (n, cx, cy, cz) coefficients of the two kinds of blend; (0, …) of one not used.
        packed: (k, p) fixtures (`packed_fixture`); their margins are written to.
        structures: (m,) coefficients of the further structures, one after the other.
        path_points: (3, m) mm of all paths, phase after phase; path_times: their phases' times.
        path_work: (8, n) working space of `dvf_ig.kernels.path`, n points of the longest path.
        settings: (1,) SETTINGS.
        tissue: (1,) TISSUE; tissue_motion: (n, c, c, 4 c) float32 pull-backs to end-diastole;
            tissue_properties: (x, y, z, 4) float32 stiffness in N/mm, damping in N·s/mm, friction, texture.
    """

    linear: Any
    periodic: Any
    packed: FloatArray
    structures: Any
    path_points: FloatArray
    path_times: FloatArray
    path_work: FloatArray
    settings: Any
    tissue: Any
    tissue_motion: Any
    tissue_properties: Any


class Scratch(NamedTuple):
    """Memory and working space of a servo's ticks, for k fixtures; `inputs` and `row` also as words.

    Attributes:
        memory: (1,) MEMORY; row: (1,) ROW of the last tick.
        inputs: (1,) INPUTS that were read last; warps: with them.
        sample: (1,) SAMPLE; forces: (k, 3); composed, other: (1,) COMPOSED.
        fields: (k, 4) gradient, model frame, and rate by the phase of each fixture's distance; part_n,
            part_mm_s: (k, 3) its share of the field, its surface's velocity; with several structures alone.
        shaft: (4,) axis of the shaft, tracker frame, and its length to the trocar; depths: (MOST_SAMPLES,).
    """

    memory: Any
    inputs: Any
    warps: Any
    input_words: Any
    read_words: Any
    row: Any
    row_words: Any
    sample: Any
    forces: FloatArray
    work: FloatArray
    order: FloatArray
    composed: Any
    other: Any
    vectors: FloatArray
    fields: FloatArray
    part_n: FloatArray
    part_mm_s: FloatArray
    shaft: FloatArray
    depths: FloatArray


def new_scratch(fixtures: int) -> Scratch:
    """Memory before the first tick, and working space, for `fixtures` fixtures."""
    read, row = new_published(), np.zeros(1, ROW)
    return Scratch(
        memory=new_memory(),
        inputs=read.inputs,
        warps=read.warps,
        input_words=read.words,
        read_words=np.zeros_like(read.words),
        row=row,
        row_words=words(row),
        sample=np.zeros(1, SAMPLE),
        forces=np.zeros((fixtures, 3)),
        work=np.zeros(work_size(fixtures)),
        order=np.zeros(fixtures),
        composed=np.zeros(1, COMPOSED),
        other=np.zeros(1, COMPOSED),
        vectors=np.zeros((9, 3)),
        fields=np.zeros((fixtures, 4)),
        part_n=np.zeros((fixtures, 3)),
        part_mm_s=np.zeros((fixtures, 3)),
        shaft=np.zeros(4),
        depths=np.zeros(MOST_SAMPLES),
    )


def new_memory() -> Any:
    """(1,) MEMORY before the first tick: the force begins at zero and rises slowly."""
    memory = np.zeros(1, MEMORY)
    memory["last_tick_s"] = np.nan
    supervision = memory["supervision"]
    supervision["state"], supervision["slow"], supervision["wanted_n"] = 1, 1, np.inf
    supervision["last_s"] = supervision["unsafe_since_s"] = np.nan
    return memory
