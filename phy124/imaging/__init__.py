"""Opens images of limited size and segments the object that each image shows.

The package also samples grey images that a user painted over the image of an object.
"""
