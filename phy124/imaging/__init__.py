"""Pictures: opened within limits, their object cut out, what is painted on it."""
