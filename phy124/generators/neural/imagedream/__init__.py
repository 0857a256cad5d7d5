"""ImageDream: four consistent views of the object in an image (Wang & Shi 2023)."""

from phy124.generators.options import Work

STEPS = 30
"""Number of diffusion steps in LGM's program."""
STEP = Work(662.4e9, 1045.9e9, 473.6e9)
"""Floating-point operations of one step of the U-Net, for five frames with an image and five
without.
"""
AROUND = Work(371.2e9, 3358.3e9, 33.9e9)
"""Floating-point operations of the text encoder, the image encoder and the autoencoder, which
encodes one image and decodes five.
"""
PARAMETERS = 941_672_900
"""Number of parameters of the U-Net."""
