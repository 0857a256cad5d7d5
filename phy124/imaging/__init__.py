"""Opens images of limited size and segments their object.

It also samples grey images that a user has painted over the object.
"""
