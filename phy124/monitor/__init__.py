"""Monitors of a run, which change nothing in it: balance, tearing, rest."""
