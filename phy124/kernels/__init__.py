"""Device code, one formula per function, and how it is compiled; nothing else.

The parameters of every kernel come in one order, under headings:

- `# model`: what a launch does not change: numbers, the model's arrays, lattice, window, clock and
  the tables of the tracks;
- `# state in`: arrays that are read;
- `# in place`: arrays that are read and written;
- `# out`: arrays that are only written.

Names of arrays that are written end in `_out`, and no others do. Launches pass their arguments in
the same order. tests/test_kernels_order.py checks this.
"""
