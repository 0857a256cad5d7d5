"""Device code: one formula per function, and the helpers that compile it.

All kernels take their arguments in one order. First come the model's arguments, which a launch does
not change (numbers, the model's arrays, lattice, window, clock and the tables of the tracks). The
state arrays that are only read come next, and the written arrays come last. Only names of written
arrays end in `_out`. Launches pass their arguments in the same order. tests/test_kernels_order.py
checks the order of arguments. The module `arguments` declares the meaning of each argument.
"""

from phy124.runtime.late_parsing import parse_late

parse_late()
