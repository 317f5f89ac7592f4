"""False alarms: interventions without a fault, accelerated, through session and servo; streams, no images.

Hearts at 50 to 110 beats/min whose rate drifts, with respiratory and slow variability; sensors with jitter
and noise, drop-outs of single frames of the tool, and clocks that are off by up to 20 ppm; a hand that moves
in and out of the wall. Left out: pixels (`known_ultrasound`), ectopic beats, losses of more than one frame.
"""

from collections.abc import Iterator

import numpy as np

from data_synth import RhythmSpec, child_rng
from data_synth.signals.smooth_noise import smooth_noise
from dvf_ig.core import FloatArray, Rigid
from dvf_ig.guidance import Fixtures, Hazard, SupervisorState
from dvf_ig.guidance.servo import ServoInputs, SimulatedServo
from dvf_ig.session import GuidanceState, Session, ToolPose
from dvf_ig.study.driver import Line, Settings
from dvf_ig.study.faults.servo_trial import RATE_HZ, FaultyDevice
from dvf_ig.study.faults.streams import HOME, KnownUltrasound, at_rest, wall_setup

from .servo_trial import PUBLISH_S
from .streams import Arrivals, InterventionSpec, TipPath, drawn_beats, drawn_ecg, drawn_streams

SECONDS = 1200.0
"""Length of one intervention."""
JUST_BEFORE_S = 1e-3
"""A state so long before each pose of the tool, when the last one is oldest, and one at its arrival: the two
of a session at 1 kHz in which most can be found."""
LOST_PER_MIN = 2.0
"""Single frames of the tool in which the tracker does not see it."""
CLOCKS_PPM = 20.0
ECG_PACKET = 25
"""Samples that arrive together, every 100 ms."""
SENSOR_MM = 0.01
"""Standard deviation of the device's encoders."""
OF_NORMAL_WORK = Hazard.POSE_MOVING
"""Raised with every beat that moves the pose, by a tenth of a millimetre as a rule: no alarm."""


class AlarmCount:
    """How often each hazard began, once guidance had begun."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._last = Hazard.NONE
        self._guided = False

    def add(self, hazards: int, state: int) -> None:
        """One state, in order of time."""
        if not self._guided:
            self._guided = state == SupervisorState.OK
            return
        if hazards == self._last:
            return
        for hazard in Hazard(hazards & ~int(self._last)):
            self.counts[str(hazard.name)] = self.counts.get(str(hazard.name), 0) + 1
        self._last = Hazard(hazards)

    @property
    def alarms(self) -> int:
        """All that were raised, but for those of normal work."""
        return sum(count for name, count in self.counts.items() if not Hazard[name] & OF_NORMAL_WORK)


def clean_trial(settings: Settings, seed: int) -> Line:
    """One intervention of SECONDS.

    Args:
        settings: none.
        seed: of heart, hand and noise.
    """
    spec, device_mm = _intervention(seed)
    samples = drawn_ecg(spec, drawn_beats(spec, seed), seed)
    streams = drawn_streams(spec, samples, seed)
    _lose_single_frames(streams.tool, child_rng(seed, "lost"))
    arrivals = streams.merged()
    session_alarms, servo_alarms, served = AlarmCount(), AlarmCount(), 0
    device = FaultyDevice(device_mm, np.zeros(len(device_mm), dtype=np.bool_))
    setup = wall_setup()
    servo = SimulatedServo(Fixtures(setup.heart.model, setup.fixtures), device)
    still, states = Rigid.identity("tracker", "device"), 0
    inputs: ServoInputs | None = None
    with Session(
        setup, ultrasound=lambda buffer: KnownUltrasound(buffer, at_rest, child_rng(seed, "beats"))
    ) as session:
        for state in _states(session, arrivals):
            session_alarms.add(int(state.supervised.hazards), int(state.supervised.state))
            states += 1
            served += state.supervised.state == SupervisorState.OK
            if state.now_s - servo.now_s < PUBLISH_S:
                continue
            if inputs is not None:
                record = servo.run(inputs, int((state.now_s - servo.now_s) * RATE_HZ))
                for hazards, of in zip(record.hazards.tolist(), record.state.tolist(), strict=True):
                    servo_alarms.add(hazards, of)
            inputs = state.inputs(still)
    return {
        "hours": spec.seconds / 3600.0,
        "rate_bpm": float(np.mean([rate for _, rate in spec.rhythm.rate_bpm])),
        "served_share": served / states,
        "session": session_alarms.counts,
        "servo": servo_alarms.counts,
        "false_alarms": session_alarms.alarms + _own(servo_alarms, session_alarms),
    }


def _lose_single_frames(tool: Arrivals, rng: np.random.Generator) -> None:
    """Never two of ten in a row."""
    count = int(rng.poisson(LOST_PER_MIN * SECONDS / 60.0))
    for k in (10 * rng.choice(len(tool) // 10, count, replace=False)).tolist():
        arrived_s, pose = tool[k]
        if isinstance(pose, ToolPose):
            tool[k] = arrived_s, ToolPose(pose.t_s, None)


def _own(servo: AlarmCount, session: AlarmCount) -> int:
    """Alarms of the servo that the session did not raise before."""
    names = [name for name in servo.counts if not Hazard[name] & OF_NORMAL_WORK]
    return sum(servo.counts[name] for name in names if name not in session.counts)


def _states(session: Session, arrivals: Arrivals) -> Iterator[GuidanceState]:
    """A state just before and at each arrival of a pose of the tool."""
    now_s = 0.0
    for arrived_s, event in arrivals:
        if not isinstance(event, ToolPose):
            session.push(event, arrived_s)
            continue
        if arrived_s - JUST_BEFORE_S > now_s:
            yield session.state(arrived_s - JUST_BEFORE_S)
        session.push(event, arrived_s)
        now_s = arrived_s
        yield session.state(now_s)


def _intervention(seed: int) -> tuple[InterventionSpec, FloatArray]:
    """Draw what is recorded, and (n, 3) positions of the device in the tracker's frame at RATE_HZ."""
    rng = child_rng(seed, "clean")
    knots_s = np.arange(0.0, SECONDS + 1.0, 120.0)
    middle = float(rng.uniform(58.0, 100.0))
    rates = np.clip(middle + 4.0 * rng.standard_normal(len(knots_s)), 50.0, 110.0)
    rhythm = RhythmSpec(
        rate_bpm=tuple(zip(knots_s.tolist(), rates.tolist(), strict=True)),
        respiratory=float(rng.uniform(0.01, 0.04)),
        respiration_hz=float(rng.uniform(0.2, 0.3)),
        mayer=float(rng.uniform(0.005, 0.02)),
        jitter=float(rng.uniform(0.002, 0.008)),
    )
    tip = _hand(rng)
    fast = rng.uniform(-CLOCKS_PPM, CLOCKS_PPM, 3).tolist()
    drift_ppm = (fast[0], fast[1], fast[2])
    spec = InterventionSpec(SECONDS, rhythm, ECG_PACKET, tip, drift_ppm)
    t_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    places = HOME.inverse().apply_array(np.concatenate([tip(part) for part in np.array_split(t_s, 60)]))
    return spec, places + SENSOR_MM * rng.standard_normal(places.shape)


def _hand(rng: np.random.Generator) -> TipPath:
    """Slow motion along the wall, in and out of it, below 40 mm/s."""
    motion = smooth_noise(3, 0.05, 0.4, rng)
    return lambda t_s: np.array([3.0, 0.0, 0.0]) + motion(t_s) * np.array([3.0, 6.0, 6.0])
