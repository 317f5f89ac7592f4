"""Tensor B-splines fitted to signed distance (Ren 2008, eqs 1–3)."""
