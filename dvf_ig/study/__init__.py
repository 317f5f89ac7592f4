"""Many trials with a known truth, and the speed of single calls: one folder a study."""
