"""Generators with trained networks.

Each generator is a package whose `__init__` declares two variables. `GENERATORS` contains factories
by name, and `WEIGHTS` lists keys of `phy124.weights.store.KNOWN`. Torch is imported only when a
factory is called.
"""
