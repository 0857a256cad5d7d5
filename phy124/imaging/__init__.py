"""Opens images of limited size and segments their object.

It also samples other images that are laid over the object.
"""
