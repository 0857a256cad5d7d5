"""Opens images and segments the object that each image shows."""
