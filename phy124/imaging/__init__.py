"""Pictures: opened within limits, their object cut out, values painted on them."""
