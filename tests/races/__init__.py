"""Runs kernels on a CPU as a GPU would: threads in any order, with a record of each access.

Warp translates a kernel to C++ and compiles it. This package changes the C++ text before it is
compiled (watched.py): every read, write and atomic operation on an array writes an entry to memory
(record.py), and the loop over the threads runs them in the order stored there. A GPU never orders
two threads of one launch, so their accesses to the same word show whether they race (conflicts.py),
in whatever order they were run. The result is exact for the inputs of this run, and says nothing
about other inputs. Only the components of a vector that are used count as read (parts.py). Native
snippets are recorded where they call functions of Warp, so the forms for vector units of CPUs are
left out.

`PYTHONPATH=.:tests python -m races races walls FOLDER` runs a group of runs.py, or
`order solids FOLDER` one of clips.py, and prints what it found as JSON; compiled kernels are kept
in the folder. tests/test_concurrency.py does both.
"""
