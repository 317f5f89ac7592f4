"""Delays that the limits of detection are made of: of frames, packets, beats and the operator, s."""

STEP_S, SLOW_STEP_S = 0.001, 0.004
"""States are a millisecond apart, which each limit includes; where it is a second or more, four."""
FRAME_S, TOOL_ARRIVES_S, FRAME_ARRIVES_S = 0.010, 0.007, 0.035
"""The tool's frame; a pose or an ultrasound frame has arrived so long after its stamp, jitter included."""
ULTRASOUND_FRAME_S = 1.0 / 12.0
PACKET_S = 0.028
"""A packet of the ECG has arrived so long after its first sample."""
LATE_FOR_S = 0.15
"""Of a jump: with half of the last 32 poses it is the usual latency, over which the tip is predicted."""
USUAL_LATE_S = 0.0045
"""Median latency of the tool's poses, and the jitter of their stamps."""
TOO_OLD_S = 2.5 * FRAME_S + USUAL_LATE_S + STEP_S
BEAT_S = 0.90
"""Longest interval at 72 beats/min with the study's variability."""
DETECTED_S = 0.25
"""An R peak is known so long after it: 0.139 s in 95 % (docs/theory/cardiac.md), and the packet's arrival."""
LOST_S = 1.35 * BEAT_S + DETECTED_S
PHASE_BACK_S, POSE_BACK_S, REGULAR_S = 12.0, 16.0, 45.0
"""The operator waits so long for the phase, for a registration that beats confirm, and for the phase after
fibrillation: forecasts that failed are forgotten by 5 % a beat."""
