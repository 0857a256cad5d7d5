"""Kernels as a GPU would run them, seen on a CPU: threads in any order, each access noted.

Warp turns a kernel into C++ and compiles it by itself. Here that text is changed on its way to the
compiler (watched.py): every read, write and atomic operation on an array leaves an entry in memory
(record.py), and the loop over the threads takes them in the order that it finds there. Two threads
of one launch are never ordered on a GPU, so what they did to the same word tells whether they race
(conflicts.py), whatever order they were run in: exact for the inputs of that run, blind to others.
Of a vector only the components that are used count as read (parts.py). Native snippets are seen
where they call Warp's own functions, so the forms for vector units of CPUs are left out.

`PYTHONPATH=.:tests python -m races races walls FOLDER` runs a group of runs.py, or
`order solids FOLDER` one of clips.py, and prints what it found as JSON; compiled kernels are kept
in the folder. tests/test_concurrency.py does both.
"""
