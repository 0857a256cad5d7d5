"""Device code, one formula per function, and how it is built; nothing else."""
