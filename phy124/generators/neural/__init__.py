"""Generators with trained networks; the rest of phy124 imports these packages by name only.

Each generator package declares two variables in its `__init__`: `GENERATORS` (factories by name)
and `WEIGHTS` (names of the weights that it loads, keys of `phy124.weights.store.KNOWN`). Importing
such a package is fast; its factories import torch when they are called. To add a generator, add a
package.
"""
