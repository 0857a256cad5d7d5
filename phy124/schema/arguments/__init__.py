"""Parse the command line of any program; errors are plain sentences."""
