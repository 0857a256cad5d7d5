"""Declares options with bounds and descriptions, and parses command lines."""
