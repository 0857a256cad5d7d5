"""Declaration of options: bounds, descriptions, and parsing of command lines."""
