"""Tests the solver by comparison with experiments and known solutions, and in difficult cases."""
