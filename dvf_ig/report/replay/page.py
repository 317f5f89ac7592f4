"""Build `report.html` of a replay: one self-contained page with its estimates, errors and figures."""

import html
from collections.abc import Sequence

from dvf_ig.report.page import html_page, image_tag, section, table
from dvf_ig.report.plane_marks import LETTERS_NOTE

from . import figures
from .values import BeatTrace, BreathLoop, ReplayPage


def replay_html(page: ReplayPage) -> str:
    """Build the page for one replay."""
    ticks = page.ticks
    span_s = (float(ticks.t_s[0]), float(ticks.t_s[-1]))
    sections = (
        (
            "Ultrasound and model, before and after registration",
            "The model's surface, where its images show it, in the ultrasound plane at each frame's phase, "
            f"and its labels if it keeps any. {LETTERS_NOTE}.",
            figures.overlay_figure(page.overlays),
        ),
        (
            "The pose from beat to beat",
            "After each heart beat its ultrasound is compared with the model under the pose in use, and the "
            "log-likelihood ratio states how much better the beat's best pose explains it."
            + _tre_remark(page.beats),
            figures.pose_figure(page.beats, page.registrations, span_s),
        ),
        (
            "Breathing: the heart's motion and its model",
            _breath_note(page.breath),
            None if page.breath is None else figures.breathing_figure(page.breath),
        ),
        ("Phase error over time", "Against the ground truth.", figures.phase_error_figure(ticks)),
        (
            "Force and distance",
            "Force of the fixture at the tool tip through the estimated pose and phase, and distance of the "
            "tip from the surface.",
            figures.force_figure(ticks),
        ),
        (
            "Supervisor",
            "When the force was given in full, with a warning or rising (degraded), released (fade), or "
            "withheld until the operator re-armed (latched); the hazards behind it. Below: the age of the "
            "pose, the age at which it is withheld (by its age, or because its 95 % bound has grown too "
            "large), and the times in which it was withheld, each with the rule that acted.",
            figures.supervisor_figure(page.supervisor),
        ),
        (
            "Distance from the surface",
            "How long the tool tip spent at each distance while a force was given.",
            figures.distance_histogram(ticks),
        ),
        (
            "ECG, R peaks and phase",
            "Phase at each moment, estimated from past samples only.",
            figures.ecg_figure(page.ecg),
        ),
    )
    body = "".join(
        section(title, note, image_tag(figure, title))
        for title, note, figure in sections
        if figure is not None
    )
    estimates = _estimates(page)
    about = f"patient {html.escape(page.patient_id)}, dvf_ig {html.escape(page.version)}"
    head = f"<p class=note>{about}</p>{_verdict(page)}{_warnings(page.warnings)}"
    return html_page(f"Replay of {page.scenario}", f"{head}<h2>Estimates</h2>{estimates}{body}")


def _estimates(page: ReplayPage) -> str:
    """Format the table of estimates, with their errors if any is known."""
    if any(error for _, _, error in page.estimates):
        return table(("", "estimate", "error against the ground truth"), page.estimates)
    return table(("", "estimate"), [row[:2] for row in page.estimates])


def _breath_note(loop: BreathLoop | None) -> str:
    if loop is None:
        return ""
    return (
        "Displacement of the heart's centre from end-expiration, along the main direction of its motion, "
        "against the surrogate. Inspiration and expiration differ: the heart follows with hysteresis. Each "
        "mark is a heart beat, drawn at its middle with one standard deviation of its measurement. The model "
        f"was learnt from {loop.breaths} breaths and misses breaths that it was not learnt from by "
        f"{loop.held_out_mm:.1f} mm over the heart. Below: what it misses of each beat."
    )


def _tre_remark(beats: BeatTrace | None) -> str:
    if beats is None or beats.tre_mm is None:
        return ""
    return " Above it: mean target registration error (TRE) of that best pose; thin dotted line: 2 mm."


def _warnings(sentences: Sequence[str]) -> str:
    """List contradictions between the recordings; empty without any."""
    items = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in sentences)
    return f"<h2>Recordings that disagree</h2><ul>{items}</ul>" if items else ""


def _verdict(page: ReplayPage) -> str:
    """Build the banner: red without any force, amber if none could be given at the end, green otherwise."""
    registrations = page.registrations
    used = any(mark.usable for mark in registrations)
    last = registrations[-1].reason if registrations else "the recording is too short to register"
    without = f"no force for {page.without_force_s:.1f} s of the time since the first pose"
    if not used:
        kind, text = "bad", f"Not registered, no force was given: {last}"
    elif page.no_force is not None:
        kind, text = "bad", f"No force was given: {page.no_force}"
    elif page.lost is not None:
        kind, text = "warn", f"Registered, but lost before the end: {page.lost}; {without}"
    elif not registrations[-1].usable:
        kind, text = "warn", f"Registered, but the last registration was refused: {last}; {without}"
    elif page.without_force_s > 0.0:
        kind, text = "good", f"Registered to the end; {without}"
    else:
        kind, text = "good", "Registered to the end; force could be given from the first pose on"
    return f"<p class='verdict {kind}'>{html.escape(text)}</p>"
