"""Opens images of limited size and segments their object.

The package also samples grey images that a user has painted over the object.
"""
