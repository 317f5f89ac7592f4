"""Short table for the user: each estimate, with its error if the truth is known."""

from collections.abc import Sequence
from typing import Any

MOSTLY_KNOWN = 0.99
"""Share of contact, from which on the part that no slice shows is not stated."""


def table(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Build the short table: quantity, estimate, and its error if the truth is known (else empty)."""
    est = result["estimates"]
    residual_mm = est["probe_calibration_mean95_mm"]
    tip = ", ".join(f"{v:.2f}" for v in est["tip_mm"])
    lag_error_s = result["lag_error_s"]
    return [
        ("tool tip", f"({tip}) mm", _error(result["tip_error_mm"], "{:.2f} mm")),
        (
            "probe image",
            "from a file" if residual_mm is None else f"phantom residual {residual_mm:.2f} mm",
            _error(result["probe_error_mm"], "{:.2f} mm at the far corner"),
        ),
        (
            "latency",
            f"{1000 * est['lag_s']:.1f} ms",
            _error(None if lag_error_s is None else 1000 * lag_error_s, "{:+.2f} ms"),
        ),
        *_phase_rows(result),
        *_pose_rows(result),
        *_bound_rows(result),
        *_update_rows(result),
        *_tip_rows(result),
        *_breathing_rows(result),
        *_force_rows(result),
        _supervisor_row(result),
        ("time", _time(result), ""),
    ]


def _time(result: dict[str, Any]) -> str:
    session_s = result["session_seconds"]
    supervised = result["supervisor"]
    recorded_s = sum(supervised[name] for name in ("ok_s", "degraded_s", "fade_s", "latched_s"))
    factor = recorded_s / max(session_s, 1e-3)
    return f"{result['seconds']:.1f} s, of which the session {session_s:.1f} s: {factor:.1f} × real time"


def _error(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)


def _phase_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    est, phase, surface = (
        result["estimates"],
        result["phase_error_percent_rr"],
        result["model_phase_error_mm"],
    )
    beats = f"{est['beats']} beats, phase valid {100 * result['valid_phase_share']:.0f} % of the time"
    error = ""
    if phase is not None and surface is not None:
        error = (
            f"{phase['mean']:.2f} % of RR mean, {phase['p95']:.2f} p95; {surface['mean']:.2f} mm of surface"
        )
    rows = [("heart", beats, error)]
    if est["rr_s"]:
        period = f"RR {est['rr_s']:.3f} s, T_d {1000 * est['frame_period_s']:.1f} ms × {est['phases']} phases"
        rows.append(("retiming", period, ""))
    return rows


def _stated(attempt: dict[str, Any]) -> str:
    """Describe a registration's stated error."""
    chance, bound = attempt["success_probability"], attempt["tre_bound_mm"]
    if chance is None:
        return "no probability stated"
    return f"success probability {chance:.2f}" + (
        f", largest error below {bound:.1f} mm" if bound is not None else ""
    )


def _pose_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    attempts: Sequence[dict[str, Any]] = result["registrations"]
    usable = [a for a in attempts if a["usable"]]
    start, tre = result["start_tre_mm"], result["tre_mm"]
    rows = []
    if start is not None:
        rows.append(("start pose", "", f"TRE {start['median']:.2f} mm median, {start['max']:.2f} max"))
    if usable:
        text = (
            f"{len(usable)} of {len(attempts)} usable, in use from {usable[0]['ready_s']:.1f} s, "
            f"{_stated(usable[-1])}"
        )
        refused = [a for a in attempts if not a["usable"]]
        if refused:
            text += f"; at {refused[-1]['ready_s']:.1f} s: {refused[-1]['reason']}"
    else:
        text = f"none of {len(attempts)} usable" + (f": {attempts[-1]['reason']}" if attempts else "")
    error = (
        ""
        if tre is None
        else f"TRE {tre['median']:.2f} mm median, {tre['p95']:.2f} p95, {tre['max']:.2f} max"
    )
    rows.append(("registration", text, error))
    dice = result["label_dice"]
    if dice is not None and dice["mean"] is not None:
        text = f"in {dice['frames']} ultrasound planes of the last registration"
        rows.append(
            ("labels", text, f"Dice {dice['mean']:.2f} mean of labels, {dice['organ']:.2f} whole organ")
        )
    if usable:
        rows.append(("least constrained", usable[-1]["weakness"], ""))
        shape = usable[-1]["shape_change"]
        if shape is not None:
            follow = "fixtures follow it" if shape["followed"] else "within the margins"
            rows.append(("shape of the heart", f"{shape['sentence']}; {follow}", ""))
    return rows


def _bound_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Show the two stated bounds under their names, and how often each held."""
    names = (
        ("tre_bound_mm", "bound of registrations", "95 % bound on the largest error over the heart"),
        (
            "pose_bound_mm",
            "bound of the pose",
            "95 % bound on the RMS error over the heart, or of the guarded walls if its shape is followed; "
            "median of its updates",
        ),
    )
    rows = []
    for key, name, meaning in names:
        bound = result[key]
        if bound is not None:
            coverage = bound["coverage"]
            error = "" if coverage is None else f"held in {coverage:.0%} of {_bounds_of(result, key)}"
            rows.append((name, f"{bound['median']:.1f} mm: {meaning}", error))
    return rows


def _bounds_of(result: dict[str, Any], key: str) -> str:
    return "registrations" if key == "tre_bound_mm" else f"{result[key]['updates']} updates"


def _update_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    seconds, drift = result["update_seconds"], result["drift_mm_per_min"]
    if seconds is None:
        return []
    text = f"{result['tracked_beats']} beats, {1000 * seconds['median']:.0f} ms an update"
    if drift is not None:
        text += f", drift {drift:.1f} mm/min"
    rows = [("pose updates", text, "")]
    rows += [
        (
            f"withheld at {one['begin_s']:.1f} s",
            f"for {one['end_s'] - one['begin_s']:.1f} s: {one['why']}",
            "",
        )
        for one in result["withheld"]
    ]
    return rows


def _tip_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Describe where ultrasound shows the tool, if it does."""
    seen = result["tip_in_image"]
    if seen is None:
        return []
    return [
        ("tip in the image", f"{seen['off_mm']:.1f} mm from its place, {seen['seen_beats']} sightings", "")
    ]


def _breathing_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Describe what was found about the motion in breathing, if anything was."""
    breath = result["breathing"]
    if breath is None:
        return []
    if breath["breaths"] is None:
        served = "that nothing follows; no force"
        if breath["by_ecg"]:
            served = "that only the ECG follows; force at end-expiration alone"
        moved = f"{breath['unfollowed_mm']:.1f} mm with breaths, some {breath['per_minute']:.0f} a minute"
        return [("breathing", f"{moved}, {served} from {breath['from_s']:.1f} s on", "")]
    behind = (
        f"{abs(breath['latency_s']):.2f} s {'behind' if breath['latency_s'] > 0 else 'ahead of'} the heart"
    )
    text = f"motion learnt from {breath['breaths']} breaths, {breath['held_out_mm']:.1f} mm off in others"
    return [("breathing", f"{text}; what follows it is {behind}", "")]


def _force_rows(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    force, contact, error = result["force_n"], result["contact"], result["force_error_n"]
    rows = [
        (
            "force",
            f"{force['mean']:.3f} N mean, {force['max']:.3f} max over valid ticks",
            "" if error is None else f"{error['median']:.3f} N median, {error['p95']:.3f} p95 in contact",
        ),
        (
            "ticks",
            f"{result['valid_ticks']} valid, {result['refused_ticks']} refused, "
            f"{result['nonfinite_ticks']} non-finite",
            "",
        ),
    ]
    wall = result["surface_error_mm"]
    if wall is not None:
        text = f"{wall['median']:.2f} mm median, {wall['p95']:.2f} p95 off at the tool"
        rows.append(("wall", "", f"{text}; force on one 3 mm off for {wall['force_far_off_s']:.1f} s"))
    if contact is not None:
        share, served = 100 * contact["share"], 100 * contact["served_share"]
        text = f"in {share:.0f} % of ticks, force given in {served:.0f} % of those"
        if contact["known_share"] < MOSTLY_KNOWN:
            share, served = 100 * contact["known_share"], 100 * contact["served_known_share"]
            text += f"; in {served:.0f} % of the {share:.0f} % where the model knows the heart"
        rows.append(("contact", "", text))
    return rows


def _supervisor_row(result: dict[str, Any]) -> tuple[str, str, str]:
    supervisor, hazard_s = result["supervisor"], result["hazard_s"]
    text = (
        f"no force for {result['without_force_s']:.1f} s after the first pose, faded {supervisor['fades']} "
        f"times, latched {supervisor['latches']} times ({supervisor['latched_s']:.1f} s), largest step "
        f"{supervisor['largest_step_n']:.3f} N"
    )
    if hazard_s is None:
        return ("supervisor", text, "")
    longest_s = result["hazard_longest_s"]
    return (
        "supervisor",
        text,
        f"{hazard_s:.1f} s of force over 5 mm off, {longest_s:.1f} at a time",
    )
