"""Description of a recording's faults in words that disclose no true value."""

from .presets import Preset


def describe_faults(preset: Preset) -> tuple[str, ...]:
    """Describe each disturbance beyond ordinary noise in a sentence without its size or time."""
    ecg, image, rates = preset.ecg, preset.image, [rate for _, rate in preset.rhythm.rate_bpm]
    trackers = (preset.probe_tracker, preset.tool_tracker)
    disturbances = (
        (max(rates) - min(rates) > 10, "The heart rate changes a lot."),
        (preset.rhythm.ectopic_share > 0, "Some beats are ventricular extrasystoles."),
        (preset.tool.sites == 1, "The tool slides along one line of the heart."),
        (bool(ecg.lead_off_s), "ECG electrodes come off for a while."),
        (bool(ecg.noise_bursts_s), "Bursts of noise cover the ECG."),
        (bool(ecg.missed_beats), "Some beats leave no trace in the ECG."),
        (preset.respiration.moves, "The heart moves with respiration."),
        (bool(preset.respiration.events), "Breathing does not stay the same."),
        (
            preset.occlusion.losses_per_min > 0 or any(t.lost_s for t in trackers),
            "The tracker loses sight of probe and tool for seconds.",
        ),
        (any(t.latency_s > 0 for t in trackers), "The tracker reports its poses late."),
        (preset.video_drift_ppm != 0, "The video clock drifts against the tracker's."),
        (preset.patient_shift.happens, "The patient moves against the tracker's base."),
        (preset.probe_slip.happens, "The marker slips on the ultrasound probe."),
        (
            preset.other_probe_mm > 0 or preset.other_probe_deg > 0,
            "The probe's calibration recordings are of another probe.",
        ),
        (preset.looks.for_s > 0, "The operator turns the image to the tool now and then."),
        (preset.tool_echo.shown, "The ultrasound images show the tool."),
        (image.clutter > 0, "Clutter covers the ultrasound images."),
        (image.shadows > 0, "Parts of the ultrasound images lie in shadow."),
        (image.dynamic_range_db < 50, "The ultrasound images have little dynamic range."),
        (preset.probe_tracker.position_mm > 0.5, "The probe's poses are noisy."),
        (preset.mismatch_mm > 1.5, "The heart's shape differs much from the pre-operative images."),
        (preset.surgery.retraction_mm > 0, "A retractor presses on the heart."),
        (preset.surgery.load_mm != 0, "The heart is filled otherwise than in the pre-operative images."),
        (preset.contraction != (1.0, 1.0), "The heart contracts otherwise than in the pre-operative images."),
        (preset.still_mm > 0, "A wall that moves in the pre-operative images stands still."),
    )
    return tuple(sentence for present, sentence in (*disturbances, *_failures(preset)) if present)


def _failures(preset: Preset) -> tuple[tuple[bool, str], ...]:
    """List failures that begin at some time, each with whether the preset has it."""
    shows = preset.image_failure.shows
    sensors = (("ultrasound probe", preset.probe_failure), ("tool", preset.tool_failure))
    return (
        *((s.lost, f"The {name} is lost to the tracker and not found again.") for name, s in sensors),
        *(
            (s.frozen_s > 0, f"The tracker repeats one pose of the {name} as if fresh.")
            for name, s in sensors
        ),
        (preset.tool_clock.back_s > 0, "The clock of the tool's tracker restarts."),
        (preset.ecg.latency_s > 0, "The ECG's time stamps are late."),
        (shows == "noise", "The ultrasound images show noise in place of the heart from some moment on."),
        (shows == "black", "The ultrasound images are black from some moment on."),
        (shows == "frozen", "One ultrasound image is repeated from some moment on."),
    )
