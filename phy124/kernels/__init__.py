"""Device code, one formula per function, and how it is compiled; nothing else.

The arguments of every kernel come in one order: the model's, which a launch does not change
(numbers, the model's arrays, lattice, window, clock and the tables of the tracks); the state's,
which are read; and those that are written, or read and written. Names of arrays that are written
end in `_out`, and no others do. Launches pass their arguments in the same order.
tests/test_kernels_order.py checks this. `arguments` declares what the names mean.
"""
