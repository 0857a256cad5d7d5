"""Estimates the time and memory of runs, refuses runs beyond the budget, and suggests remedies.

The package also lists the effects that a run computes or omits.
"""
