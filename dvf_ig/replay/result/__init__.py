"""What a replay reports: `result.json` and its schema, scored where the truth is known."""
