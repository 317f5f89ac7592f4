"""Simulated operators at the evaluation tasks of Ren 2008."""
