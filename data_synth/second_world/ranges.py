"""Table of all values of the second world with the ranges from which they are drawn.

The ranges are physical and clinical ones, never chosen by the results of a registration; changes before the
freeze are in docs/decisions/0017-second-world.md. Seeds 5001 to 5010 are for inspection only.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Range:
    """Range of one drawn value.

    Attributes:
        low, high: ends; `low` is the mild one if the value has one.
        graded: the value is worse towards `high`, so that the quality says which part of the range is drawn.
        log: uniform in the logarithm.
        either_sign: the drawn size gets a random sign.
    """

    low: float
    high: float
    graded: bool = False
    log: bool = False
    either_sign: bool = False


def _graded(low: float, high: float) -> Range:
    return Range(low, high, graded=True)


def _either(low: float, high: float, *, graded: bool = False) -> Range:
    return Range(low, high, graded=graded, either_sign=True)


HEART: dict[str, Range] = {
    # relative change of the contraction since the MR
    "heart.contractility": Range(-0.3, 0.3),
    # uniform normal shift of the surface by volume load, mm, outward positive
    "heart.volume_load_mm": Range(-2.0, 3.0),
    # delay from one side of the heart to the other, share of the cycle (LBBB: 60-100 ms)
    "heart.dyssynchrony": _graded(0.0, 0.08),
    # constant part of the non-rigid mismatch, RMS of 3-D displacement, and its length (SD of the correlation)
    "heart.mismatch_mm": _graded(0.5, 2.5),
    "heart.mismatch_length_mm": Range(10.0, 60.0, log=True),
    # part of the mismatch that varies over the cycle
    "heart.mismatch_beating_mm": _graded(0.1, 1.2),
    "heart.mismatch_beating_length_mm": Range(10.0, 60.0, log=True),
    # largest share of its length that a mismatch may reach, so that space does not fold
    "heart.mismatch_over_length": Range(0.12, 0.12),
    # epicardial fat: mean and largest thickness, and size of its patches
    "heart.fat_mean_mm": Range(0.5, 6.0),
    "heart.fat_most_mm": Range(12.0, 12.0),
    "heart.fat_patch_mm": Range(12.0, 30.0),
    # depth of pericardial effusion at its deepest; below 0 there is none
    "heart.effusion_mm": Range(-8.0, 10.0),
    "heart.pericardium_mm": Range(0.8, 2.0),
    # trabeculae in the blood of the ventricles: depth of their layer and share of it that is muscle
    "heart.trabeculae_mm": Range(1.5, 6.0),
    "heart.trabeculae_share": Range(0.15, 0.45),
    "heart.trabeculae_width_mm": Range(1.2, 2.5),
}

RHYTHM: dict[str, Range] = {
    "rhythm.rate_bpm": Range(54.0, 98.0),
    "rhythm.respiratory": Range(0.005, 0.045),
    "rhythm.mayer": Range(0.005, 0.025),
    "rhythm.jitter": Range(0.003, 0.02),
    "rhythm.ectopic_share": _graded(0.0, 0.05),
    # systole lasts as RR to this power (0.5 is Bazett's); so does early filling
    "rhythm.systole_power": Range(0.12, 0.55),
    "rhythm.filling_power": Range(0.0, 0.5),
    # share of diastole that early filling takes at the rate of the MR
    "rhythm.filling_share": Range(0.35, 0.6),
    # SD of the delay between the R peak and the beat of the muscle, from beat to beat
    "rhythm.gate_noise_s": _graded(0.003, 0.022),
    "rhythm.ecg_noise_mv": _graded(0.01, 0.05),
    "rhythm.ecg_baseline_mv": Range(0.03, 0.15),
}

BREATHING: dict[str, Range] = {
    # excursion of the heart's centre, mm: ventilated (Maeyens 2023), and free tidal breathing (Shechter 2004)
    "breathing.ventilated_mm": Range(9.3, 13.0),
    "breathing.spontaneous_mm": Range(3.0, 8.6),
    "breathing.per_minute": Range(10.0, 18.0),
    "breathing.tilt_deg_per_cm": Range(1.0, 3.5),
    # change of shape, RMS at the surface, mm for each cm of excursion
    "breathing.stretch_mm_per_cm": Range(0.3, 0.9),
    "breathing.nonrigid_mm_per_cm": Range(0.1, 0.5),
    # share of the motion that lags, and backlash as a share of a breath
    "breathing.lagging": Range(0.2, 0.8),
    "breathing.backlash": Range(0.0, 0.1),
}

ACOUSTICS: dict[str, Range] = {
    # impedance in MRayl, attenuation in dB/cm/MHz, echo in dB re muscle of the left ventricle
    "muscle.impedance": Range(1.64, 1.74),
    "muscle.attenuation": Range(0.4, 0.8),
    "muscle.echo_db": Range(0.0, 0.0),
    "atrium.impedance": Range(1.64, 1.74),
    "atrium.attenuation": Range(0.4, 0.8),
    "atrium.echo_db": Range(-3.0, 4.0),
    "vessel.impedance": Range(1.66, 1.82),
    "vessel.attenuation": Range(0.5, 1.0),
    "vessel.echo_db": Range(0.0, 8.0),
    "valve.impedance": Range(1.70, 1.85),
    "valve.attenuation": Range(0.6, 1.2),
    "valve.echo_db": Range(2.0, 9.0),
    "blood.impedance": Range(1.60, 1.67),
    "blood.attenuation": Range(0.13, 0.21),
    # -12 dB is stirred, slow blood (spontaneous contrast), -35 dB fast and clean
    "blood.echo_db": Range(-35.0, -12.0),
    "effusion.impedance": Range(1.50, 1.56),
    "effusion.attenuation": Range(0.01, 0.06),
    "effusion.echo_db": Range(-48.0, -36.0),
    "fat.impedance": Range(1.35, 1.46),
    "fat.attenuation": Range(0.5, 1.1),
    "fat.echo_db": Range(-7.0, 5.0),
    "pericardium.impedance": Range(1.72, 1.95),
    "pericardium.attenuation": Range(0.7, 1.4),
    "pericardium.echo_db": Range(5.0, 14.0),
    "mediastinum.impedance": Range(1.52, 1.62),
    "mediastinum.attenuation": Range(0.5, 0.8),
    "mediastinum.echo_db": Range(-10.0, 1.0),
    "liver.impedance": Range(1.62, 1.70),
    "liver.attenuation": Range(0.4, 0.75),
    "liver.echo_db": Range(-4.0, 5.0),
    "lung.impedance": Range(0.2, 0.5),
    "lung.attenuation": Range(18.0, 40.0),
    "lung.echo_db": Range(-6.0, 4.0),
    "bone.impedance": Range(5.0, 7.5),
    "bone.attenuation": Range(6.0, 14.0),
    "bone.echo_db": Range(0.0, 8.0),
    # echo of muscle differs from region to region by up to this, over this length
    "muscle.regional_db": _graded(1.0, 6.0),
    "muscle.regional_length_mm": Range(12.0, 35.0),
    # loss of a beam along the wall compared with one across it
    "muscle.anisotropy_db": Range(3.0, 14.0),
}

SCANNER: dict[str, Range] = {
    "image.dynamic_range_db": Range(80.0, 40.0, graded=True),
    "image.white_db": Range(14.0, 26.0),
    # 0: a straight log curve; 1: a full S
    "image.s_shape": Range(0.0, 1.0),
    # operator's sliders: RMS over depth, over their spacing; and across the lines
    "image.time_gain_db": _graded(0.5, 5.0),
    "image.time_gain_length_mm": Range(18.0, 40.0),
    "image.line_gain_db": _graded(0.2, 3.0),
    # mixture of muscle and blood that time-gain compensation assumes
    "epicardial.tgc_muscle_share": Range(0.35, 0.65),
    "narrow.tgc_muscle_share": Range(0.35, 0.65),
    "tee.tgc_muscle_share": Range(0.15, 0.4),
    "ice.tgc_muscle_share": Range(0.15, 0.4),
    "image.persistence": Range(0.0, 0.55),
    "image.noise_db": Range(-98.0, -76.0, graded=True),
    "image.specular_db": Range(14.0, 28.0),
    "image.specular_power": Range(1.5, 5.0),
    "image.haze_db": Range(-34.0, -8.0, graded=True),
    "image.haze_mm": Range(6.0, 18.0),
    "image.dirty_shadow_db": Range(-36.0, -18.0),
    # bloom: share of a strong echo that spreads, its extent along and across the beam, and the threshold
    "image.bloom_share": _graded(0.15, 0.8),
    "image.bloom_axial_mm": _graded(0.4, 1.6),
    "image.bloom_across_mm": _graded(0.5, 3.0),
    "image.bloom_above_db": Range(2.0, 8.0),
    # arcs of lines without contact: number, width, loss, and rate at which they come and go
    "image.dropouts": _graded(0.0, 4.0),
    "image.dropout_deg": Range(3.0, 14.0),
    "image.dropout_db": _graded(8.0, 35.0),
    "image.dropout_hz": Range(0.05, 0.3),
    # repeated echoes of the septum and the near wall: how much deeper and weaker
    "image.reverberation_mm": Range(8.0, 30.0),
    "image.reverberation_db": Range(-30.0, -12.0, graded=True),
    # relative error of the assumed speed of sound: depths are scaled by it
    "image.sound_speed": _either(0.0, 0.015),
}

PROBE: dict[str, Range] = {
    "epicardial.depth_mm": Range(120.0, 165.0),
    "epicardial.half_angle_deg": Range(32.0, 44.0),
    "epicardial.frequency_mhz": Range(2.4, 4.5),
    "epicardial.aperture_mm": Range(15.0, 22.0),
    "epicardial.standoff_mm": Range(12.0, 42.0),
    "narrow.depth_mm": Range(125.0, 170.0),
    "narrow.half_angle_deg": Range(19.0, 27.0),
    "narrow.frequency_mhz": Range(2.0, 3.6),
    "narrow.aperture_mm": Range(13.0, 20.0),
    "narrow.standoff_mm": Range(25.0, 55.0),
    "tee.depth_mm": Range(105.0, 150.0),
    "tee.half_angle_deg": Range(40.0, 45.0),
    "tee.frequency_mhz": Range(3.8, 6.5),
    "tee.aperture_mm": Range(9.0, 13.0),
    "tee.standoff_mm": Range(3.0, 7.0),
    "ice.depth_mm": Range(90.0, 130.0),
    "ice.half_angle_deg": Range(40.0, 45.0),
    "ice.frequency_mhz": Range(4.5, 8.0),
    "ice.aperture_mm": Range(8.0, 12.0),
    "ice.standoff_mm": Range(0.0, 0.0),
    # a matrix array for gated 3-D images: its lines, in either direction, and its voxels
    "matrix.lines": Range(44.0, 68.0),
    "matrix.voxel_mm": Range(0.8, 1.2),
    "probe.bandwidth_share": Range(0.4, 0.7),
    "probe.focus_share": Range(0.4, 0.75),
    "probe.slice_height_mm": Range(8.0, 14.0),
    "probe.lines_per_deg": Range(1.3, 2.0),
    "probe.mm_per_px": Range(0.35, 0.55),
    "sweep.period_s": Range(5.0, 12.0),
    "sweep.turn_deg": Range(45.0, 85.0),
    "sweep.rock_deg": Range(16.0, 30.0),
    "sweep.slide_mm": Range(12.0, 30.0),
    "sweep.wander_deg": Range(2.0, 7.0),
    "sweep.wander_mm": Range(1.0, 6.0),
    "sweep.aim_mm": Range(0.0, 14.0),
}

KINDS: dict[str, float] = {"epicardial": 0.35, "narrow": 0.2, "tee": 0.3, "ice": 0.15}
"""Probes with their probabilities."""

TRACKER: dict[str, Range] = {
    "tracker.heart_distance_mm": Range(220.0, 480.0),
    "tracker.position_mm": _graded(0.15, 0.8),
    "tracker.rotation_deg": _graded(0.08, 0.6),
    # electromagnetic distortion of the field: RMS beyond its rigid part, and its length
    "tracker.bias_mm": _graded(0.2, 1.4),
    "tracker.bias_deg": _graded(0.1, 0.6),
    "tracker.bias_length_mm": Range(120.0, 300.0),
    # slow drift: RMS over a minute
    "tracker.drift_mm": _graded(0.05, 0.6),
    "tracker.dropouts_per_min": Range(0.0, 3.0),
    # errors of the calibrations at the middle of the image
    "calibration.shift_mm": _graded(0.1, 1.0),
    "calibration.turn_deg": _graded(0.1, 0.8),
    "calibration.point_noise_mm": Range(0.15, 0.5),
    "calibration.row_noise_mm": Range(0.2, 0.6),
    "calibration.lag_s": _either(0.010, 0.110),
    "calibration.lag_error_s": _either(0.0, 0.010, graded=True),
    "calibration.video_jitter_s": Range(0.0005, 0.004),
    # the operator's start, and touched points (RMS)
    "start.shift_mm": Range(4.0, 13.0),
    "start.turn_deg": Range(3.0, 10.0),
    "start.landmark_mm": Range(2.0, 5.0),
}

MR: dict[str, Range] = {
    "mr.phases": Range(16.0, 25.0),
    "mr.in_plane_mm": Range(1.3, 1.9),
    "mr.slice_mm": Range(3.0, 5.0),
    "mr.obliquity_deg": Range(0.0, 25.0),
    "mr.psf_mm": Range(1.3, 2.4),
    "mr.snr": Range(45.0, 12.0, graded=True),
    # coils: smooth relative shading
    "mr.bias": _graded(0.1, 0.5),
    "mr.bias_length_mm": Range(60.0, 140.0),
    # breath-holds: RMS shift of a slice; each slice at another heart rate, its gate late or early
    "mr.slice_shift_mm": _graded(0.2, 1.8),
    "mr.rr_jitter": Range(0.0, 0.1),
    "mr.gate_noise_s": _graded(0.0, 0.015),
    # above 0.5 the sequence is balanced (bSSFP), below it a spoiled gradient echo with inflow
    "mr.balanced": Range(0.0, 1.0),
    "mr.balanced_flip_deg": Range(40.0, 70.0),
    "mr.balanced_tr_s": Range(0.0028, 0.0042),
    "mr.spoiled_flip_deg": Range(12.0, 25.0),
    "mr.spoiled_tr_s": Range(0.0045, 0.009),
    # share of fresh blood in each excitation, and its variation between chambers
    "mr.inflow": Range(0.05, 0.35),
    "mr.inflow_variation": Range(0.0, 0.4),
    # T1 and T2 in s at 1.5 T, proton density
    "mr.muscle_t1": Range(0.90, 1.10),
    "mr.muscle_t2": Range(0.040, 0.056),
    "mr.muscle_density": Range(0.72, 0.84),
    "mr.blood_t1": Range(1.35, 1.70),
    "mr.blood_t2": Range(0.15, 0.28),
    "mr.blood_density": Range(0.90, 1.0),
    "mr.fat_t1": Range(0.24, 0.36),
    "mr.fat_t2": Range(0.055, 0.09),
    "mr.fat_density": Range(0.75, 1.0),
    "mr.wall_t1": Range(0.8, 1.1),
    "mr.wall_t2": Range(0.035, 0.055),
    "mr.wall_density": Range(0.65, 0.8),
    "mr.liver_t1": Range(0.50, 0.70),
    "mr.liver_t2": Range(0.038, 0.055),
    "mr.liver_density": Range(0.7, 0.82),
    "mr.lung_t1": Range(1.0, 1.3),
    "mr.lung_t2": Range(0.005, 0.02),
    "mr.lung_density": Range(0.1, 0.25),
    "mr.bone_t1": Range(0.3, 0.6),
    "mr.bone_t2": Range(0.02, 0.06),
    "mr.bone_density": Range(0.15, 0.4),
    "mr.fluid_t1": Range(2.5, 4.0),
    "mr.fluid_t2": Range(0.5, 1.5),
    "mr.fluid_density": Range(0.95, 1.0),
    "mr.mediastinum_t1": Range(0.3, 0.7),
    "mr.mediastinum_t2": Range(0.04, 0.07),
    "mr.mediastinum_density": Range(0.55, 0.85),
}

SEGMENTATION: dict[str, Range] = {
    # noise of the boundary, its length and its correlation from phase to phase
    "labels.noise_mm": _graded(0.5, 1.5),
    "labels.noise_length_mm": Range(8.0, 8.0),
    "labels.noise_kept": Range(0.5, 0.95),
    # outward bias of the outer boundary and of the blood's
    "labels.outer_bias_mm": Range(-0.7, 0.7),
    "labels.blood_bias_mm": Range(-0.7, 0.7),
    # error of the drawn valve plane, and distance from it within which contours follow
    "labels.basal_mm": _either(0.0, 6.0, graded=True),
    "labels.basal_reach_mm": Range(10.0, 10.0),
}

RANGES: dict[str, Range] = (
    HEART | RHYTHM | BREATHING | ACOUSTICS | SCANNER | PROBE | TRACKER | MR | SEGMENTATION
)
"""All ranges by name."""
