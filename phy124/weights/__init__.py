"""Finds, checks and downloads files of trained weights, and loads them into networks."""
