"""Simulated operators at the evaluation tasks of Ren 2008, with and without the fixtures' force."""
