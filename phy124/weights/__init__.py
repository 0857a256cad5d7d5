"""Trained weights: where they are, whether they are intact, how networks are filled."""
