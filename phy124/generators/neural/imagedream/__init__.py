"""ImageDream: four consistent views of the object in a picture (Wang & Shi 2023)."""

from __future__ import annotations

from phy124.generators.options import Work

STEPS = 30
"""Steps of the diffusion that LGM takes."""
STEP = Work(662.4e9, 1045.9e9, 473.6e9)
"""One step of the U-Net: five frames without the picture and five with it."""
AROUND = Work(371.2e9, 3358.3e9, 33.9e9)
"""Encoders of text and picture, and the autoencoder: one picture in, five out."""
PARAMETERS = 941_672_900
"""Numbers in the U-Net."""
