"""Accuracy settings, and the values and purposes of `draft`, `standard` and `fine`."""

from typing import Any, Literal, get_args

from pydantic import Field

from phy124.errors import InputError
from phy124.mpm.timestep import beside_rpic
from phy124.schema.section import Section, omit_default

USUAL = {"transfer": "apic", "gradient": "affine", "rpic_damping": 0.0}
"""Default values of the settings for MPM's transfers; other solvers do not use these settings."""


class Accuracy(Section):
    """Settings that trade accuracy against time, such as cells and particles per cell."""

    cells: int = Field(default=32, ge=4, le=256)
    """Number of grid cells across the longest side of the object."""
    particles_per_axis: float | None = Field(default=None, ge=1, le=4, examples=[2.0])
    """Particles per cell and axis inside the object. If absent: 2 for elastic materials, fluids and
    plasticine, 1.5 for other plastic and granular materials. Materials of the scene determine the
    number, and materials from a file of properties do not.
    """
    cfl: float = Field(default=0.75, ge=0.01, le=0.9)
    """Length of a substep as a fraction of the stable limit."""
    precision: Literal["float32", "float64", "auto"] = "float32"
    """Floating-point precision of the simulation. auto: float32 if all moving objects are simulated
    on lattices, where rounding errors of the strain do not accumulate; otherwise float64.
    """
    transfer: Literal["apic", "aflip", "xpic2", "xpic3", "xpic4", "xpic5"] = omit_default("apic")
    """Transfer of velocities between particles and grid. apic is the fastest, has the strongest
    damping, and is the only transfer that conserves angular momentum. xpic2 to xpic5 damp
    vibrations less, but need 2 to 5 more passes over the grid. aflip needs one more pass and leaves
    noise.
    """
    blend: float = omit_default(0.95, ge=0, le=1)
    """For transfer = aflip only: particles keep this fraction of the velocities that the grid
    cannot represent.
    """
    gradient: Literal["affine", "spline"] = omit_default("affine")
    """Velocity gradient from which stress and strain are computed. affine: the affine fit around
    each particle (MLS-MPM), with which objects that bend by several cells are too soft. spline: the
    gradients of the interpolation weights, for transfer = apic only; takes 1.4 to 6 times as long.
    """
    solver: Literal["auto", "mpm", "lattice"] = omit_default("auto")
    """Solver of elastic objects. mpm: the material point method. lattice: a lattice in the
    undeformed object, whose nodes move with the object; bending is accurate, but the object cannot
    tear; for transfer = apic only. auto: lattice where it is supported and was better in
    measurements; otherwise mpm, with the reason in the report.
    """
    rpic_damping: float = omit_default(0.0, ge=0, le=1e6)
    """Decay rate of the symmetric part of each particle's C, for apic only [1/s]. The decay acts
    like a viscosity of rate x density x dx^2/8, so the effect depends on the grid. PhysGaussian's
    damping r at a substep dt equals a rate of -ln(1 - r)/dt. If the rate is above 0, substeps are
    0.71 times as long.
    """
    liquid: Literal["compressible", "projection"] | None = omit_default(
        None, examples=["projection"]
    )
    """Solver of the law fluid. compressible: the pressure of each particle follows from its volume.
    projection: incompressible flow with longer steps, for one or several liquids, also together
    with other materials. If absent: projection where it is supported; otherwise compressible, with
    the reason in the report.
    """

    @property
    def fraction(self) -> float:
        """Length of a substep as a fraction of the elastic limit, including RPIC damping."""
        return beside_rpic(self.cfl) if self.rpic_damping > 0 else self.cfl

    @property
    def passes(self) -> int:
        """Number of additional passes over the grid in each substep."""
        order = self.transfer.removeprefix("xpic")
        return int(order) if order.isdigit() else int(order == "aflip")

    @property
    def share(self) -> float:
        """Fraction that particles keep of the velocities that the grid cannot represent."""
        return self.blend if self.transfer == "aflip" else 1.0


NAMED = {
    "draft": (
        Accuracy(cells=16),
        "a first look at a motion: a cell is 6 % of the object, and thin parts are too stiff",
    ),
    "standard": (
        Accuracy(cells=32),
        "most purposes: cells are half as wide, so bending is more accurate; shorter substeps "
        "would not help, since the loss in a transfer does not depend on the substep",
    ),
    "fine": (
        Accuracy(cells=48, precision="auto"),
        "final results: cells are a third as wide, and no rounding errors build up",
    ),
}
"""Settings and purpose of each named accuracy (docs/lab/accuracy.md)."""
PRESETS = {name: accuracy for name, (accuracy, _) in NAMED.items()}
GOOD_FOR = {name: use for name, (_, use) in NAMED.items()}
AccuracyName = Literal["draft", "standard", "fine"]


def describe_accuracy() -> str:
    """Describe the values of `accuracy`."""
    names = [f"{name} ({each.cells})" for name, each in PRESETS.items()]
    settings = []
    for name, declared in Accuracy.model_fields.items():
        choices = ", ".join(_list_choices(declared.annotation))
        settings.append(f"{name} ({choices})" if choices else name)
    return (
        f"Cells across the object by name: {', '.join(names)}; or a table of "
        f"{', '.join(settings[:-1])} and {settings[-1]}."
    )


def _list_choices(kind: Any) -> list[str]:
    if isinstance(kind, str):
        return [kind]
    return [choice for each in get_args(kind) for choice in _list_choices(each)]


def check_transfer(accuracy: Accuracy) -> None:
    """Refuse settings that the chosen transfer or solver does not support.

    Raises:
        InputError: `blend` is set, but the transfer is not aflip; or `rpic_damping` or `gradient`
            is set, but the transfer is not apic. The settings in `USUAL` are also refused for
            liquids with projected pressure, and for the lattice solver.
    """
    transfer = accuracy.transfer
    changed = [name for name, usual in USUAL.items() if getattr(accuracy, name) != usual]
    for name in changed:
        field, value = f"accuracy.{name}", getattr(accuracy, name)
        if accuracy.liquid == "projection":
            limit = "it has no effect with accuracy.liquid = projection."
            remedy = "Remove it or set accuracy.liquid = compressible."
            raise InputError(field, value, limit, remedy)
        if accuracy.solver == "lattice":
            limit = "accuracy.solver = lattice has no transfers."
            remedy = "Remove it or set accuracy.solver = mpm."
            raise InputError(field, value, limit, remedy)
        if name != "transfer" and transfer != "apic":
            limit = f"it needs transfer = apic, not {transfer}."
            raise InputError(field, value, limit, "Remove one of the two settings.")
    if accuracy.blend != Accuracy.model_fields["blend"].default and transfer != "aflip":
        limit = f"it needs transfer = aflip, not {transfer}."
        remedy = "Remove blend or set the transfer."
        raise InputError("accuracy.blend", accuracy.blend, limit, remedy)
