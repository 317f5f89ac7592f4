"""A second synthetic world that shares no table of values with the first: made to report, never to tune on."""
