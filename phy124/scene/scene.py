"""Scene: all options of a user, as an immutable tree, read from and written to TOML.

Each option is declared once, for validation, help and web page.
"""

from __future__ import annotations

import math
import os
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from phy124.boundaries import BOUNDARIES, AnyBoundary, Ground
from phy124.errors import InputError, did_you_mean
from phy124.forces import FORCES, AnyForce, Gravity
from phy124.materials import LAWS, AnyMaterial, NeoHookean
from phy124.mpm.tracks import AnyProfile, Track
from phy124.properties import Properties
from phy124.properties.stiffness import AnyStiffness, check_profile
from phy124.scene.accuracies import (
    PRESETS,
    Accuracy,
    AccuracyName,
    check_transfer,
    describe_accuracy,
)
from phy124.scene.changes import apply
from phy124.scene.files import check_depth, read_toml
from phy124.scene.lattices import find_elastic, reason_for_mpm, reason_for_others
from phy124.scene.liquids import reason_for_compressible
from phy124.scene.objects import (
    Pair,
    SceneObject,
    check_free,
    check_name,
    check_objects,
    check_pairs,
)
from phy124.scene.renamed import rename_keys
from phy124.scene.sections import Checks, Object, Part, Timing, check_energy
from phy124.scene.view import View
from phy124.schema.bounds import LONGEST, Text
from phy124.schema.refusals import validate
from phy124.schema.section import Section, omit_default

MOST_OBJECTS = 16
"""Largest number of objects; each object in contact needs a velocity field."""


class Scene(Section):
    """A complete simulation: object, material, forces, boundaries, accuracy, time and view."""

    description: Text = Field(default="", max_length=1000, examples=["It falls."])
    """Description of the scene in a sentence."""
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    """Seed of all random numbers."""
    object: Object = Object()
    """The first object and its placement."""
    material: AnyMaterial = NeoHookean()
    """Constitutive law."""
    parts: tuple[Part, ...] = ()
    """Parts made of other materials."""
    objects: tuple[SceneObject, ...] = omit_default((), max_length=MOST_OBJECTS - 1)
    """Further objects. Accuracy, stiffness and properties are for the first object."""
    pairs: tuple[Pair, ...] = omit_default(())
    """Contact between two objects. The default is the contact separate with friction 0.5."""
    stiffness: AnyStiffness | None = None
    """How E varies inside the object; if absent, E is uniform."""
    stiffness_profile: AnyProfile | None = None
    """Factor on E over time, evaluated at the start of each frame; if absent, 1."""
    properties: Properties | None = None
    """Material properties that vary from point to point, from a file; if absent, the material is
    uniform.
    """
    forces: tuple[AnyForce, ...] = (Gravity(),)
    """Forces on particles."""
    boundaries: tuple[AnyBoundary, ...] = (Ground(),)
    """Solid walls and other constraints on the motion."""
    accuracy: AccuracyName | Accuracy = Field(default="standard", description=describe_accuracy())
    binding: Literal["particles", "lattice"] = "lattice"
    """lattice: Gaussians follow a lattice of particles, which is faster; particles: each Gaussian
    is a particle, as in the paper.
    """
    time: Timing = Timing()
    """Number of frames, and limits on substep and time."""
    checks: Checks = Checks()
    """Checks during the run."""
    velocities: bool = False
    """Store the velocity of each Gaussian; if off, speeds are computed from positions."""
    contacts: bool = False
    """Store the mean force of the walls on each Gaussian; on if the output `force` is requested.
    Liquids are then compressible.
    """
    wrenches: bool = False
    """Store force and torque of the object on each wall; on if `contacts` is on."""
    grains: bool = True
    """Show the inside of sand, snow, foam and torn material as grains; if off, only the Gaussians
    on the surface are shown.
    """
    view: View = View()
    """Cameras, size, formats and stage of videos."""

    @model_validator(mode="before")
    @classmethod
    def _rename_keys(cls, data: Any) -> Any:
        return rename_keys(data)

    @field_validator("stiffness_profile")
    @classmethod
    def _check_profile(cls, profile: AnyProfile | None) -> AnyProfile | None:
        if profile is not None:
            check_profile(profile)
        return profile

    @model_validator(mode="after")
    def _check_together(self) -> Scene:
        check_objects(self.object, self.objects)
        check_transfer(self.resolution)
        self._check_energy()
        check_free(self.every_object, self.boundaries)
        solids = [item.name for item in self.objects if item.motion is not None]
        check_pairs(self.pairs, self.names, solids)
        moving = [item.name for item in self.every_object if not item.scenery]
        solids = [item.name for item in self.every_object if item.scenery]
        for section in (*self.forces, *self.boundaries):
            if section.object is not None:
                check_name(section.object, moving, solids)
        return self

    def _check_energy(self) -> None:
        if not self.checks.energy:
            return
        why, solid = reason_for_others(self), not self.projects
        moves = any(wall.moves for wall in self.boundaries)
        limits = {
            "objects": bool(self.objects) and solid,
            "a boundary that moves": moves and solid,
            "stiffness_profile": self.stiffness_profile is not None and not self.immerses,
        }
        end = f", unless all objects are on lattices; here they are not: {why}"
        check_energy(
            self.checks,
            {
                **{f"{name}{end}": present and bool(why) for name, present in limits.items()},
                "accuracy.gradient = spline": self.resolution.gradient != "affine",
                "accuracy.rpic_damping and a viscous material": self._damped_twice,
            },
        )

    @property
    def _damped_twice(self) -> bool:
        """Whether RPIC damping changes the matrices C, from which viscous stresses are computed."""
        viscous = any(math.isfinite(section.viscous_limit(self.dx)) for section in self.materials)
        return self.resolution.rpic_damping > 0 and (viscous or self.properties is not None)

    def softness(self, time: float) -> float:
        """Return the factor that multiplies Young's modulus at `time` [s]."""
        return float(self.softnesses(np.array([time]))[0])

    def softnesses(self, times: NDArray) -> NDArray[np.float64]:
        """Return the factors that multiply Young's modulus at `times` [T], s."""
        if self.stiffness_profile is None:
            return np.ones(len(times))
        whole = Track.of_profile((1.0, 0.0, 0.0), self.stiffness_profile, 0.0, LONGEST, mean=False)
        return whole.values(times)[:, 0]

    @property
    def resolution(self) -> Accuracy:
        """Accuracy settings; a named accuracy is replaced by its settings."""
        return PRESETS[self.accuracy] if isinstance(self.accuracy, str) else self.accuracy

    @property
    def particles_per_axis(self) -> float:
        """Particles per cell and axis: the number in the scene, or else the number that the
        materials need.
        """
        chosen = self.resolution.particles_per_axis
        return chosen or max(section.particles_per_axis for section in self.materials)

    @property
    def projects(self) -> bool:
        """Whether a liquid is computed by pressure projection."""
        fluid = any(section.law == "fluid" for section in self.materials)
        return fluid and not reason_for_compressible(self)

    @property
    def has_solids(self) -> bool:
        """Whether an object has particles of a material that is not a liquid."""
        return any(section.law != "fluid" for section in self.materials)

    @property
    def mixes(self) -> bool:
        """Whether a liquid with projected pressure moves together with other materials."""
        return self.projects and self.has_solids

    @property
    def immerses(self) -> bool:
        """Whether a liquid with projected pressure moves together with objects on lattices."""
        return self.projects and self.couples

    @property
    def on_lattice(self) -> bool:
        """Whether elastic objects are simulated on the lattices of their rest shapes."""
        return not reason_for_mpm(self)

    @property
    def solver(self) -> Literal["lattice", "mpm"]:
        """The solver that computes elastic objects."""
        return "lattice" if self.on_lattice else "mpm"

    @property
    def precision(self) -> Literal["float32", "float64"]:
        """Floating-point precision of the simulation."""
        chosen = self.resolution.precision
        if chosen != "auto":
            return chosen
        return "float32" if self.on_lattice and not self.couples else "float64"

    @property
    def on_lattices(self) -> list[bool]:
        """Whether each object is simulated on a lattice."""
        return find_elastic(self) if self.on_lattice else [False] * len(self.names)

    @property
    def couples(self) -> bool:
        """Whether some moving objects are on lattices, and others are made of particles."""
        return 0 < sum(self.on_lattices) < sum(map(bool, self.object_materials))

    @property
    def acting(self) -> list[AnyForce]:
        """Forces whose strength is not zero."""
        return [force for force in self.forces if not force.idle]

    @property
    def keeps_contacts(self) -> bool:
        """Whether the force of the walls on each Gaussian is stored."""
        return self.contacts or "force" in self.view.outputs

    @property
    def keeps_wrenches(self) -> bool:
        """Whether the force and torque on each wall are stored."""
        return self.wrenches or self.keeps_contacts

    @property
    def every_object(self) -> tuple[Object, ...]:
        """The first object, followed by all other objects."""
        return (self.object, *self.objects)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all objects."""
        return tuple(item.name for item in self.every_object)

    @property
    def materials(self) -> list[AnyMaterial]:
        """Material of each object with particles, and of its moving parts."""
        return [section for materials in self.object_materials for section in materials]

    @property
    def object_materials(self) -> list[list[AnyMaterial]]:
        """Materials of each object and its moving parts; empty without particles."""
        return [
            []
            if body.scenery
            else [item.material, *(p.material for p in item.parts if not p.static)]
            for body, item in zip(self.every_object, (self, *self.objects), strict=True)
        ]

    def with_solids(self) -> Scene:
        """Return the scene with a boundary for each object on a path."""
        solids = [item.solid(self.pairs) for item in self.objects if item.path is not None]
        if not solids:
            return self
        return self.model_copy(update={"boundaries": (*self.boundaries, *solids)})

    def alone(self, index: int) -> Scene:
        """Return the scene with a single object, whose size defines the grid spacing."""
        accuracy = self.accuracy
        if self.resolution.solver == "auto":
            accuracy = self.resolution.model_copy(update={"solver": self.solver})
        if index == 0:
            return self.model_copy(update={"objects": (), "pairs": (), "accuracy": accuracy})
        other = self.objects[index - 1]
        fields = {name: getattr(other, name) for name in Object.model_fields if name != "on"}
        changes = {
            "object": Object.model_construct(**fields),
            "material": other.material,
            "accuracy": accuracy,
            "parts": other.parts,
            "stiffness": None,
            "properties": None,
            "objects": (),
            "pairs": (),
        }
        return self.model_copy(update=changes)

    @property
    def dx(self) -> float:
        """Grid spacing [m]."""
        return self.object.size / self.resolution.cells

    @property
    def spacing(self) -> float:
        """Distance between neighbouring particles [m]."""
        return self.dx / self.particles_per_axis

    @classmethod
    def from_data(cls, data: dict[str, Any], source: str = "scene") -> Scene:
        """Validate plain data and return the scene.

        Raises:
            InputError: The data is not a scene; the error names field, value, limit and remedy.
        """
        check_depth(data, source)
        return validate(cls, data, source)

    @classmethod
    def of_clip(cls, data: dict[str, Any], source: str = "clip") -> Scene:
        """Read a clip's scene for rendering; ignore classes that only another program defines.

        Unknown materials are replaced by the default.

        Raises:
            InputError: The data is not a scene.
        """
        try:
            return cls.from_data(data, source)
        except InputError:
            known = _known_part(data)
            if known == data:
                raise
            return cls.from_data(known, source)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Scene:
        """Read a scene file.

        Raises:
            InputError: The file is missing, is not TOML, or is not a scene.
        """
        return cls.from_data(read_toml(path, "scene"), str(path))

    @classmethod
    def named(cls, name: str) -> Scene:
        """Return a preset by its name, or read a scene file by its path.

        Raises:
            InputError: There is neither a preset nor a file with this name.
        """
        if name in preset_names():
            return cls.from_toml(preset_folder() / f"{name}.toml")
        if Path(name).suffix == ".toml":
            return cls.from_toml(name)
        choices = f"Give a .toml file or one of {', '.join(preset_names())}."
        hint = did_you_mean(name, preset_names())
        raise InputError("scene", name, "no preset has that name.", f"{hint} {choices}".strip())

    def data(self) -> dict[str, Any]:
        """Return plain data, without values that are None."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_toml(self) -> str:
        """Return the scene as TOML.

        Raises:
            InputError: A class of the user is not registered under a name.
        """
        self.require_serialisable()
        return tomli_w.dumps(self.data())

    @property
    def unregistered(self) -> dict[str, str]:
        """Classes without a name in scene files, each with its entry-point group."""
        sections = ((LAWS, self.materials), (FORCES, self.forces), (BOUNDARIES, self.boundaries))
        return {
            type(section).__name__: kinds.group
            for kinds, group in sections
            for section in group
            if not kinds.has_name(section)
        }

    def require_serialisable(self) -> None:
        """Refuse classes without a name in scene files.

        Raises:
            InputError: A class of the user is not registered under a name.
        """
        for name, group in self.unregistered.items():
            limit = "it is a class of your program, which has no name in scene files."
            remedy = f"Register it by an entry point phy124.{group}, or use it in Python."
            raise InputError(group, name, limit, remedy)

    def replaced(self, changes: dict[str, Any]) -> Scene:
        """Return a copy with values at dotted paths, such as `{"material.E": 2e4}`.

        If a law or kind changes, the other values of the section are replaced by defaults.

        Raises:
            InputError: A path does not exist or a value is out of bounds.
        """
        data = self.data()
        # Instances of users' classes are kept, because the class may have no name in plain data.
        if LAWS.is_foreign(self.material):
            data["material"] = self.material
        of_objects = list(zip(self.objects, data.get("objects", []), strict=True))
        of_parts = [(self.parts, data["parts"])]
        of_parts += [(item.parts, plain["parts"]) for item, plain in of_objects]
        parts = [pair for both in of_parts for pair in zip(*both, strict=True)]
        for section, plain in (*of_objects, *parts):
            if LAWS.is_foreign(section.material):
                plain["material"] = section.material
        for name, kinds in (("forces", FORCES), ("boundaries", BOUNDARIES)):
            for index, section in enumerate(getattr(self, name)):
                if kinds.is_foreign(section):
                    data[name][index] = section
        apply(data, changes)
        return Scene.from_data(data)


def preset_names() -> list[str]:
    """Return the names of the presets, in alphabetical order."""
    return sorted(path.stem for path in preset_folder().glob("*.toml"))


def preset_folder() -> Path:
    """Return the folder of the presets."""
    return Path(str(resources.files("phy124") / "presets"))


def _known_part(data: dict[str, Any]) -> dict[str, Any]:
    data = _with_known_laws(data)
    for kinds in (FORCES, BOUNDARIES):
        if kinds.group in data:
            data[kinds.group] = [s for s in data[kinds.group] if kinds.knows(s)]
    return data


def _with_known_laws(section: dict[str, Any]) -> dict[str, Any]:
    section = dict(section)
    if not LAWS.knows(section.get("material", {})):
        section.pop("material", None)
    for name in ("parts", "objects"):
        if name in section:
            section[name] = [_with_known_laws(item) for item in section[name]]
    return section
