"""The live link held against a replay of the same recording, and against messages that are wrong."""
