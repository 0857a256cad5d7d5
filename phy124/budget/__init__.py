"""The budget of a run: estimates of time and memory, refusals with remedies, and its effects.

An estimate is a closed form, correct within a factor of two. A forecast (phy124/accuracy) is based
on probes of the object itself, correct within a few per cent.
"""
