"""Accuracy settings: the values behind `draft`, `standard`, `fine`, and what each promises."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from phy124.mpm.timestep import beside_rpic
from phy124.section import Section


class Accuracy(Section):
    """Settings that trade accuracy against time: cells across the object, particles in them."""

    cells: int = Field(default=32, ge=4, le=256, description="Grid cells across the longest side.")
    particles_per_axis: float | None = Field(
        default=None,
        ge=1,
        le=4,
        examples=[2.0],
        description="Particles per cell and axis inside the object; absent: as many as its "
        "materials need, 2 for elastic ones and liquids, 1.5 for plastic and granular ones.",
    )
    cfl: float = Field(
        default=0.75, ge=0.01, le=0.9, description="Fraction of the stable substep used."
    )
    precision: Literal["float32", "float64"] = Field(
        default="float32", description="Floating-point precision of the simulation."
    )
    transfer: Literal["apic", "aflip", "xpic2", "xpic3", "xpic4", "xpic5"] = Field(
        default="apic",
        exclude_if=lambda value: value == "apic",
        description="How velocities come back from the grid: apic damps most and costs least; "
        "xpic2 to xpic5 damp vibrations less for 2 to 5 more passes over the grid; aflip takes one "
        "and leaves noise. Only apic keeps the angular momentum of what spins.",
    )
    blend: float = Field(
        default=0.95,
        ge=0,
        le=1,
        exclude_if=lambda value: value == 0.95,
        description="How much aflip keeps of what the grid does not carry; no other transfer "
        "reads it.",
    )
    gradient: Literal["affine", "spline"] = Field(
        default="affine",
        exclude_if=lambda value: value == "affine",
        description="Where stress and strain come from: affine takes the fit around each particle "
        "(MLS-MPM), with which what bends through several cells is too soft; spline takes the "
        "gradients of the weights, for 1.7 to 4 times the time. For transfer = apic.",
    )
    rpic_damping: float = Field(
        default=0.0,
        ge=0,
        le=1e6,
        exclude_if=lambda value: value == 0,
        description="Rate at which the symmetric part of each particle's C dies away, for apic "
        "[1/s]; spin stays. PhysGaussian's number r at its substep dt is -ln(1 - r)/dt. It damps "
        "as a viscosity of rate density dx^2/8, so that its effect depends on the grid; substeps "
        "are 0.71 times as long.",
    )

    @property
    def fraction(self) -> float:
        """Fraction of the elastic limit that substeps take."""
        return beside_rpic(self.cfl) if self.rpic_damping > 0 else self.cfl

    @property
    def passes(self) -> int:
        """How often velocities go over the grid once more in each substep."""
        order = self.transfer.removeprefix("xpic")
        return int(order) if order.isdigit() else int(order == "aflip")

    @property
    def share(self) -> float:
        """How much of what the grid does not carry the particles keep."""
        return self.blend if self.transfer == "aflip" else 1.0


NAMED = {
    "draft": (
        Accuracy(cells=16),
        "looking at a motion before it is made well: thin places bend as if they were thicker "
        "by a part of a cell, and a cell is 6 % of the object",
    ),
    "standard": (
        Accuracy(cells=32),
        "most: cells half as wide bend more truly; a smaller substep would not help, for what "
        "transfers lose per step does not depend on it",
    ),
    "fine": (
        Accuracy(cells=48, precision="float64"),
        "what shall be right: cells a third as wide, and double precision so that rounding is no "
        "question",
    ),
}
"""The named accuracies and what each is good for (measured in docs/results/accuracy.md).

measured.json has their errors by law and kind of motion.
"""
PRESETS = {name: accuracy for name, (accuracy, _) in NAMED.items()}
GOOD_FOR = {name: use for name, (_, use) in NAMED.items()}
AccuracyName = Literal["draft", "standard", "fine"]


def check_transfer(accuracy: Accuracy) -> None:
    """Refuse a blend that no transfer reads, and what only one transfer has.

    Raises:
        ValueError: A blend was given, and the transfer is not aflip; or it is not apic, and C is
            damped or the gradient is not affine.
    """
    if accuracy.rpic_damping > 0 and accuracy.transfer != "apic":
        raise ValueError(
            f"accuracy.rpic_damping is for transfer = apic, and this one is {accuracy.transfer}, "
            "which gives back what the grid forgets; leave one of the two out"
        )
    if accuracy.gradient != "affine" and accuracy.transfer != "apic":
        raise ValueError(
            f"accuracy.gradient = {accuracy.gradient} is for transfer = apic, and this one is "
            f"{accuracy.transfer}; leave one of the two out"
        )
    usual = Accuracy.model_fields["blend"].default
    if accuracy.blend != usual and accuracy.transfer != "aflip":
        raise ValueError(
            f"accuracy.blend is for transfer = aflip, and this one is {accuracy.transfer}; leave "
            "blend out or set the transfer"
        )
