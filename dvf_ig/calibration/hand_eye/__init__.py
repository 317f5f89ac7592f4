"""Hand–eye calibration of a camera or probe held by a robot."""
