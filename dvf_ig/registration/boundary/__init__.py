"""Blood–wall boundary points in ultrasound against the signed distance of the model."""
