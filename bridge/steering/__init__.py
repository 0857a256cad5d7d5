"""A live run that peers push, hold, pause, step and reset by messages and services."""
