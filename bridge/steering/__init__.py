"""A live run that is steered by messages and services: pushed, held, paused, stepped and reset."""
