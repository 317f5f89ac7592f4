"""Second synthetic world, without any table of the first: made for reports, never for tuning."""
