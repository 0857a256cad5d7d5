"""Trained weights: locates, checks and downloads files, and loads them into networks."""
