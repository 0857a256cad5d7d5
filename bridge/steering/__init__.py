"""A live run; other programs push, hold, pause, step and reset it by messages and services."""
