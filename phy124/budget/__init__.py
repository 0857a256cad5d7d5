"""Estimates the time and memory of runs, refuses runs beyond the budget, and suggests remedies.

The package also lists the effects that a run computes or omits. An estimate uses a closed formula
and is correct within a factor of two. A forecast (phy124/accuracy) is measured in short trial runs
of the object and is correct within a few per cent.
"""
