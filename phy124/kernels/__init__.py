"""Device code: kernels, device functions with one formula each, and their compilation.

All kernels take their arguments in the same order. The model's arguments come first: numbers, the
model's arrays, the lattice, the window, the clock and the tables of the tracks. Kernels do not
change these arguments. Next come the state arrays that are only read, and last the arrays that are
written. Only the names of written arrays end in `_out`. tests/test_kernels_order.py checks this
order. The module `arguments` declares the meaning of each argument.
"""

from phy124.runtime.late_parsing import parse_late

parse_late()
