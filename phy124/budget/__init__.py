"""Estimates the time and memory of a run, refuses a run that exceeds the budget, and suggests
remedies.

The package also lists the effects that a run computes or leaves out. An estimate uses a closed
formula and is correct within a factor of two. A forecast (phy124/accuracy) measures short probes of
the object itself and is correct within a few per cent.
"""
