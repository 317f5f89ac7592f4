"""Result of a replay: `result.json` and its schema, scored if the truth is known."""
