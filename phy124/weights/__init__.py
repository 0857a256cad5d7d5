"""Trained weights: where they lie, whether they are whole, how a network is filled with them."""
