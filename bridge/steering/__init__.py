"""A live run that other programs push, hold, pause, step and reset by messages and services."""
