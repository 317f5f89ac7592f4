"""Rows of the table whose faults are at the servo: device, session, deadlines, energy, jumps of force."""

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.servo_trial import (
    ServoFault,
    device_silent,
    jumps,
    late_ticks,
    place_not_finite,
    session_silent,
    trembling,
)

from .row import Row, Severity

TICK_S = 0.001

SERVO_ROWS: tuple[Row, ...] = (
    Row(
        "NaN or Inf: device",
        Hazard.NOT_FINITE,
        "the first such tick",
        (
            Severity("NaN in 1 tick", ServoFault(place_not_finite, 0.001), TICK_S),
            Severity("NaN in 10 ticks", ServoFault(place_not_finite, 0.01), TICK_S),
            Severity("NaN in 100 ticks", ServoFault(place_not_finite, 0.1), TICK_S),
        ),
    ),
    Row(
        "device lost",
        Hazard.DEVICE_LOST,
        "the first tick without an answer",
        (
            Severity("no answer in 1 tick", ServoFault(device_silent, 0.001), TICK_S),
            Severity("no answer in 20 ticks", ServoFault(device_silent, 0.02), TICK_S),
            Severity("no answer for 0.5 s", ServoFault(device_silent, 0.5), TICK_S),
        ),
    ),
    Row(
        "session silent",
        Hazard.SESSION_SILENT,
        "0.1 s after the last word, and a tick",
        (
            Severity("three words missing", ServoFault(session_silent, 0.1), 0.1 + 2 * TICK_S),
            Severity("silent for 0.5 s", ServoFault(session_silent, 0.5), 0.1 + 2 * TICK_S),
            Severity("silent for 2 s", ServoFault(session_silent, 2.0), 0.1 + 2 * TICK_S),
        ),
    ),
    Row(
        "force jump",
        Hazard.FORCE_CLAMPED,
        "the tenth jump within 1 s, each by more than 0.1 N in a tick: 0.4 s at 25 jumps a second",
        (
            Severity("jumps of 0.12 N", ServoFault(jumps(0.8, 0.04), 1.0), 0.4 + 2 * TICK_S),
            Severity("jumps of 0.3 N", ServoFault(jumps(2.2, 0.04), 1.0), 0.4 + 2 * TICK_S),
            Severity("jumps of 0.55 N", ServoFault(jumps(6.4, 0.04), 1.0), 0.4 + 2 * TICK_S),
        ),
    ),
    Row(
        "missed deadlines",
        Hazard.MISSED_DEADLINES,
        "when the third late tick within 100 wakes",
        (
            Severity("3 of 100 late by 2.1 ms", ServoFault(late_ticks(0.0021, 3, 48), 0.2), 0.0021 + TICK_S),
            Severity("3 of 40 late by 2.5 ms", ServoFault(late_ticks(0.0025, 3, 18), 0.2), 0.0025 + TICK_S),
            Severity("3 of 10 late by 2.9 ms", ServoFault(late_ticks(0.0029, 3, 4), 0.2), 0.0029 + TICK_S),
        ),
    ),
    Row(
        "watchdog",
        Hazard.MISSED_DEADLINES,
        "10 ms after the last tick, and the watchdog's period of 1 ms",
        (
            Severity("no tick for 11.5 ms", ServoFault(late_ticks(0.0105, 1, 1), 0.2, restarts=True), 0.011),
            Severity("no tick for 30 ms", ServoFault(late_ticks(0.030, 1, 1), 0.2, restarts=True), 0.011),
            Severity("no tick for 0.3 s", ServoFault(late_ticks(0.3, 1, 1), 0.5, restarts=True), 0.011),
        ),
    ),
    Row(
        "energy",
        Hazard.ENERGY,
        "the tick in which the energy made passes 5 mJ, summed from places and forces",
        (
            Severity(
                "hand trembles by 1.5 mm", ServoFault(trembling(1.5, 20.0), 6.0, by_energy=True), TICK_S
            ),
            Severity(
                "hand trembles by 2.5 mm", ServoFault(trembling(2.5, 20.0), 4.0, by_energy=True), TICK_S
            ),
            Severity("hand trembles by 4 mm", ServoFault(trembling(4.0, 20.0), 4.0, by_energy=True), TICK_S),
        ),
    ),
)
