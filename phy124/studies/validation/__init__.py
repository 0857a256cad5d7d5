"""Tests the solver: comparisons with experiments and known solutions, and difficult cases."""
