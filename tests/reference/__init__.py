"""What the implementation is compared with: laws, solvers and problems written another way."""
