"""Device code: kernels, device functions with one formula each, and their compilation.

The arguments of each kernel come in this order: the model's arguments, which kernels do not change;
the state arrays that are only read; the arrays that are written. Only names of written arrays end
in `_out`. tests/test_kernels_order.py checks the order.
"""

from phy124.runtime.late_parsing import parse_late

parse_late()
