"""A command line as a command, and its refusals in plain sentences."""
