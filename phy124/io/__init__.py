"""Files: PLY, video, pauses, and what other programs read; each appears whole or not at all."""
