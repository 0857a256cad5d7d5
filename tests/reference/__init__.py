"""References for the implementation: laws, solvers and problems, implemented in another way."""
