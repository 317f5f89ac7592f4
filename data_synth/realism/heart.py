"""Gates of the heart: extent, exactness and physiology of its motion."""

from data_synth.heart.motion_report import MotionReport

from .gates import Gate

INFINITY = float("inf")


def heart_gates(motion: str, report: MotionReport) -> list[Gate]:
    """Check exactness for any motion, and physiological ranges or the 4.96 mm of "paper5mm"."""
    r = report
    gates = [
        Gate(f"{motion}: |det - 1| in the LV wall", r.wall_det_error, 0.0, 1e-6),
        Gate(f"{motion}: inverse error, mm", r.inverse_error_mm, 0.0, 0.05),
        Gate(f"{motion}: smallest Jacobian", r.det_min, 0.2, INFINITY),
    ]
    if motion == "paper5mm":
        return [*gates, Gate(f"{motion}: largest LV motion, mm", r.largest_lv_motion_mm, 4.7, 5.2)]
    return [
        *gates,
        Gate(f"{motion}: largest LV motion, mm", r.largest_lv_motion_mm, 10.0, 16.0),
        Gate(f"{motion}: LV ejection fraction", r.lv_ejection_fraction, 0.52, 0.72),
        Gate(f"{motion}: RV ejection fraction", r.rv_ejection_fraction, 0.40, 0.68),
        Gate(f"{motion}: LA expansion at ES", r.la_expansion, 0.15, 1.2),
        Gate(f"{motion}: wall thickening", r.wall_thickening, 0.25, 0.80),
        Gate(f"{motion}: long-axis shortening", r.long_axis_shortening, 0.10, 0.22),
    ]
