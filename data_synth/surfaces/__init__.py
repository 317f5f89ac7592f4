"""A beating anatomy made of real corresponding surfaces."""
