"""Device code: one formula per function, and the helpers that compile it.

All kernels take their arguments in the same order. The model's arguments come first. A launch does
not change them: numbers, the model's arrays, the lattice, the window, the clock and the tables of
the tracks. The state arrays that are only read come next, and the arrays that are written come
last. Only names of written arrays end in `_out`. Launches pass their arguments in the same order.
tests/test_kernels_order.py checks the order of arguments. The module `arguments` declares the
meaning of each argument.
"""

from phy124.runtime.late_parsing import parse_late

parse_late()
