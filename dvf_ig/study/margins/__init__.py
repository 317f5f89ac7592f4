"""Margins of forbidden regions: how deep a wall that is off stands inside the true one, by kind of margin."""
