"""Generators with trained networks, which the rest of phy124 imports by name only.

Each package here that makes Gaussians says so in its `__init__`: `GENERATORS` (name -> factory) and
`WEIGHTS` (names of the weights that it reads, as in `phy124.weights.store.KNOWN`). Importing such a
package is fast; its factories import torch. To add a generator, add a package.
"""
