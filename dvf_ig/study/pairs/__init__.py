"""Registration of pairs of organ images that do not beat: one trial a pair."""
