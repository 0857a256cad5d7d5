"""Parses command lines, and refuses bad ones in plain sentences."""
