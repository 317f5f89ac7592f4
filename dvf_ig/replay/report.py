"""`report.html`: one self-contained page, pictures inlined."""

import base64
import html
import io
from typing import Any

from matplotlib.figure import Figure

import dvf_ig

from . import pictures
from .engine import Replay
from .table import table

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 1080px; margin: 2rem auto;
       padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .3rem; }
p.note { color: #555; margin: .2rem 0 .8rem; max-width: 75ch; }
table { border-collapse: collapse; }
th { text-align: left; font-weight: 600; }
td { padding: .25rem 1rem .25rem 0; border-bottom: 1px solid #e4e4e4; }
td:first-child { color: #555; white-space: nowrap; } img { max-width: 100%; height: auto; }
.verdict { display: inline-block; padding: .3rem .8rem; border-radius: .3rem; color: #fff; }
.good { background: #2b7a3d; } .bad { background: #b3261e; }
"""


def report_html(replay: Replay, result: dict[str, Any]) -> str:
    """The page for one replay and its result."""
    sections = (
        (
            "Ultrasound and model, before and after registration",
            "The model's surface in the ultrasound plane at the phase of each frame.",
            pictures.overlay(replay),
        ),
        (
            "The pose from beat to beat",
            "Each heart beat is asked about the pose: how far it is off where that is known, and by how "
            "much another pose explains the beat better; dotted: more than noise does. Red: in doubt, no "
            "force. Upright lines: a registration came into use, or (dotted) did not.",
            pictures.pose_over_time(replay),
        ),
        (
            "Phase error over time",
            "Against the planted truth. Grey: no force was given.",
            pictures.phase_error(replay),
        ),
        (
            "Force and distance",
            "What the fixture gave, through the estimated pose and phase. Grey: no force was given.",
            pictures.force_trace(replay),
        ),
        (
            "Distance from the surface",
            "How long the tool tip spent at each distance (as in Ren 2008, Fig. 14).",
            pictures.distance_histogram(replay),
        ),
        (
            "ECG, R peaks and phase",
            "Phase as it was known at each moment, from the past alone.",
            pictures.ecg_strip(replay),
        ),
    )
    body = "".join(
        f"<h2>{html.escape(title)}</h2><p class=note>{html.escape(note)}</p>{image_tag(figure, title)}"
        for title, note, figure in sections
        if figure is not None
    )
    rows = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in table(result)
    )
    heading = "<tr><th></th><th>estimate</th><th>error against the truth</th></tr>"
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        f"<title>Replay of {html.escape(result['scenario'])}</title><style>{STYLE}</style>"
        f"<h1>Replay of {html.escape(result['scenario'])}</h1>"
        f"<p class=note>patient {html.escape(result['patient_id'])}, dvf_ig {dvf_ig.__version__}</p>"
        f"{_verdict(result)}<h2>Estimates</h2><table>{heading}{rows}</table>{body}</html>"
    )


def _verdict(result: dict[str, Any]) -> str:
    attempts = result["registrations"]
    if any(a["usable"] for a in attempts) and not attempts[-1]["usable"]:
        reason = html.escape(attempts[-1]["reason"])
        return f"<p class='verdict bad'>Registered, but not to the end; the last attempt: {reason}</p>"
    if any(a["usable"] for a in attempts):
        return "<p class='verdict good'>Registered: force was given in valid state only</p>"
    reason = attempts[-1]["reason"] if attempts else "the recording is too short to register"
    return f"<p class='verdict bad'>Not registered, no force was given: {html.escape(reason)}</p>"


def image_tag(figure: Figure, title: str) -> str:
    """The figure as a PNG inside the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(title)}" src="data:image/png;base64,{data}">'
