"""Device code, one formula per function, and how it is built; nothing else.

The parameters of every kernel come in one order, under headings:

- `# model`: what a launch does not change: numbers, the model's arrays, lattice, window, clock and
  tables of the tracks;
- `# state in`: what is read;
- `# in place`: what is read and written;
- `# out`: what is only written.

All that is written ends in `_out`, and nothing else does. Launches give their arguments in the same
order. tests/test_kernels_order.py holds this.
"""
