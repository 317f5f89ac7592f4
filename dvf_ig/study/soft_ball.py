"""A soft ball or a heart's tissue at a haptic device, for `dvf-ig device test`, and what was measured."""

import time
from typing import Any

import numpy as np

from dvf_ig.core import CycleTiming, DvfModel, FloatArray, Mesh, Rigid
from dvf_ig.guidance import FixtureOptions, Fixtures, FixtureSet, Sigmoid
from dvf_ig.guidance.device import COMMON_DEVICE
from dvf_ig.guidance.devices import HeldDevice, SimulatedStylus, limits_of, position_mm
from dvf_ig.guidance.devices.simulated import Hand
from dvf_ig.guidance.servo import Servo, ServoInputs, ServoOptions
from dvf_ig.guidance.tissue import TissueClass, feel_fixtures, feel_of
from dvf_ig.preop import AxisSolver, fit_coefficients
from dvf_ig.study.passivity import steady_transform

RADIUS_MM, DISTANCE_MM = 20.0, 30.0
"""Radius of the ball; from the tip at rest to its centre, along -x of the device. A heart is as near."""
KNOT_MM, CELLS = 5.0, 32
"""The model's box is 160 mm wide: most of a desktop device's workspace."""
SOFT = Sigmoid(gamma_per_mm=0.5, cap_n=0.6)
DEPTH_MM = 5.0
"""A simulated hand aims for this depth, and then back."""
HAND_STIFFNESS_N_PER_M, HAND_DAMPING_N_S_PER_M = 100.0, 4.0
PUBLISH_S = 0.01


def ball_model() -> DvfModel:
    """Build a still ball at the origin of frame "mr", from its distance in closed form."""
    low_mm = -0.5 * KNOT_MM * CELLS
    axis = low_mm + 0.5 * KNOT_MM * np.arange(2 * CELLS + 1)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    solver = AxisSolver.of(CELLS)
    still = fit_coefficients(RADIUS_MM - np.linalg.norm(nodes, axis=-1), (solver, solver, solver))
    corners = RADIUS_MM * np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    triangle = Mesh("mr", corners, np.array([[0, 1, 2]]))
    phases = np.array([0.0, 0.25, 0.5, 0.75])
    return DvfModel(
        patient_id="soft ball",
        surface_name="BALL",
        frame="mr",
        timing=CycleTiming(phases, 1.0),
        es_fraction=0.3,
        ed_phase=0,
        coefficients=np.stack([still] * len(phases)),
        origin_mm=np.full(3, low_mm),
        knot_spacing_mm=KNOT_MM,
        reference=(triangle,) * len(phases),
        reference_caps=(np.zeros(1, dtype=bool),) * len(phases),
    )


def feel_ball(device: HeldDevice, seconds: float, heart: DvfModel | None = None) -> dict[str, Any]:
    """Render the ball, and return JSON values; a simulated hand pushes into it and draws back.

    Args:
        heart: whose tissue is felt instead, beating at its own rate; its side towards +x is touched.
    Raises:
        InvalidInputError: the device does not answer, or cannot render the ball; a heart without tissue.
    """
    limits = limits_of(device, COMMON_DEVICE)
    feel = None if heart is None else feel_of(heart, limits)
    if heart is None:
        fixtures = Fixtures(ball_model(), FixtureSet((FixtureOptions(SOFT, name="ball"),), device=limits))
        nearest_mm = np.array([RADIUS_MM, 0.0, 0.0])
    else:
        fixtures = feel_fixtures(heart, limits)
        corners_mm = heart.reference[heart.ed_phase].vertices_mm
        nearest_mm = corners_mm[corners_mm[:, 0].argmax()]
    first_mm = position_mm(device)
    touched_mm = first_mm - np.array([DISTANCE_MM - RADIUS_MM, 0.0, 0.0])
    place = Rigid.from_rotation_vector(np.zeros(3), np.zeros(3), "tracker", "device")
    frame = fixtures.model.frame
    model_from_tracker = Rigid.from_rotation_vector(np.zeros(3), nearest_mm - touched_mm, frame, "tracker")
    transform = steady_transform(fixtures.model, pose=model_from_tracker)
    options = ServoOptions(rate_hz=device.rate_hz, feel=feel)
    rows, presses, pressed = [], 0, False
    with Servo(fixtures, device, limits=limits, options=options) as servo:
        begin_s, enabled = time.monotonic(), False
        while (now_s := time.monotonic()) < begin_s + seconds:
            servo.publish(ServoInputs(transform, now_s - begin_s, place), now_s)
            if isinstance(device, SimulatedStylus):
                device.hold(_hand(first_mm, (now_s - begin_s) / seconds))
            presses, pressed = presses + int(device.pressed and not pressed), device.pressed
            rows.append(servo.read())
            time.sleep(PUBLISH_S)
            if not enabled and servo.ticks > 0:
                device.enable_force()
                enabled = True
    rows.append(servo.read())
    late = servo.deadlines
    force_n = np.concatenate([np.linalg.norm(row.sent_n, axis=1) for row in rows])
    depth_mm = np.concatenate([row.distance_mm for row in rows])
    work_us = np.concatenate([row.work_us for row in rows])
    last = next((row for row in reversed(rows) if len(row)), None)
    sent = None if last is None else last.newest()
    return {
        "device": device.name,
        "position_mm": first_mm.tolist(),
        "touched_mm": touched_mm.tolist(),
        "tissue": None if feel is None else [_described(one) for one in feel.classes],
        "cannot_render": [] if feel is None else list(feel.refused),
        "rate_hz": device.rate_hz,
        "ticks": late.ticks,
        "run_share": late.run_share,
        "realtime": servo.realtime,
        "lateness_us": {
            "median": late.percentile_us(50.0),
            "p99": late.percentile_us(99.0),
            "max": late.worst_us,
        },
        "work_us": {"median": float(np.median(work_us)), "p99": float(np.percentile(work_us, 99.0))},
        "latency_ms": 1e3 * device.latency_s,
        "continuous_force_n": limits.continuous_force_n,
        "stiffness_n_per_m": limits.stiffness_n_per_m,
        "ends_force_after_ms": None if device.ends_force_after_s is None else 1e3 * device.ends_force_after_s,
        "largest_force_n": float(force_n.max(initial=0.0)),
        "deepest_mm": float(np.nanmax(depth_mm, initial=-DISTANCE_MM)),
        "button_presses": presses,
        "state": None if sent is None else sent.state.name,
        "reasons": [] if sent is None else list(sent.hazards.sentences),
    }


def _described(one: TissueClass) -> dict[str, Any]:
    """Values of a kind of tissue, each with its source."""
    values = (one.stiffness_n_per_mm, one.damping_n_s_per_m, one.friction, one.texture)
    names = ("stiffness_n_per_mm", "damping_n_s_per_m", "friction", "texture")
    pairs = zip(names, values, one.sources, strict=True)
    return {"name": one.name, **{name: {"value": value, "source": source} for name, value, source in pairs}}


def _hand(first_mm: FloatArray, share: float) -> Hand:
    """Hand that goes to DEPTH_MM in the ball and back while `share` goes from 0 to 1."""
    reach_mm = (DISTANCE_MM - RADIUS_MM + DEPTH_MM) * np.sin(np.pi * share)
    target_mm = first_mm - np.array([reach_mm, 0.0, 0.0])
    return Hand(np.zeros(3), target_mm, HAND_STIFFNESS_N_PER_M, HAND_DAMPING_N_S_PER_M)
