"""Rows of the table whose faults take the heart's phase: electrodes off, no ECG, arrhythmia."""

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.injection.arrivals import missing
from dvf_ig.study.faults.injection.ecg import early_beats, fibrillation, flat, mains_hum, unplugged
from dvf_ig.study.faults.injection.fault import Fault

from .delays import BEAT_S, DETECTED_S, LOST_S, PACKET_S, REGULAR_S
from .row import Row
from .severity import ecg_fault, three

PHASE_ROWS: tuple[Row, ...] = (
    Row(
        "ECG lead-off",
        Hazard.NO_PHASE,
        "flat, railed or missing for 200 ms, and the packet; hum: no R by 1.35 RR, and the detection",
        (
            ecg_fault("flat for 0.3 s", Fault(samples=flat), 0.3, 0.2 + PACKET_S),
            ecg_fault("NaN for 1 s", Fault(samples=unplugged), 1.0, 0.2 + PACKET_S),
            ecg_fault("hum in place of the ECG for 4 s", Fault(samples=mains_hum), 4.0, LOST_S),
        ),
    ),
    Row(
        "ECG silent",
        Hazard.NO_PHASE,
        "no R by 1.35 RR, and the detection latency",
        three([ecg_fault(f"no sample for {s:g} s", Fault(ecg=missing), s, LOST_S) for s in (1.8, 4.0, 10.0)]),
    ),
    Row(
        "arrhythmia",
        Hazard.NO_PHASE,
        "an early R peak when it is detected; fibrillation within 16 beats",
        (
            ecg_fault("one extrasystole", Fault(beats=early_beats(1)), 2.0, DETECTED_S),
            ecg_fault("three extrasystoles in a row", Fault(beats=early_beats(3)), 4.0, DETECTED_S),
            ecg_fault("fibrillation", Fault(beats=fibrillation), 18.0, 16 * BEAT_S, REGULAR_S),
        ),
    ),
)
