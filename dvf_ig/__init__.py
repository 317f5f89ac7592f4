"""Dynamic virtual fixtures for image-guided beating-heart intervention.

Pre-operative 4-D images become a signed-distance spline per cardiac phase (`preop`); ECG, tracked
ultrasound and calibration recordings become one pose-and-phase transform (`cardiac`, `calibration`,
`registration`); the evaluator turns a tool pose into a force (`guidance`). Values live in `core`, files
in `io`.
"""

__version__ = "0.1.0"
