"""How options are declared, bounded, described and read from command lines."""
