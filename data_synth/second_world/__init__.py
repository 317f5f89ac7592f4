"""A second synthetic world, with no table of the first: made to report, never to tune on."""
