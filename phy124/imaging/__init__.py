"""Opens images within limits, segments their object, and samples images painted over the object."""
