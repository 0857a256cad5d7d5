"""Generators with trained networks; other modules load these generators by name only.

Each generator is a package whose `__init__` declares two variables. `GENERATORS` contains factories
by name, and `WEIGHTS` lists the weights that the generator loads (keys of
`phy124.weights.store.KNOWN`). Importing such a package is fast, because torch is imported only when
a factory is called. To add a generator, add a package.
"""
