"""The further objects of a scene, and the contact of each pair of objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.boundaries import Box, Capsule, Container, Ground, HalfSpace, Press, Sphere
from phy124.boundaries.base import Movable, vector
from phy124.boundaries.motion import Free, OwnMotion, Path, Swing
from phy124.materials import AnyMaterial, NeoHookean
from phy124.scene.sections import FLOOR, Object, Part
from phy124.schema.bounds import RGB, FileName, Name
from phy124.schema.section import Section, omit_default

ShapeName = Literal["sphere", "box", "capsule"]
_Side = Annotated[float, Field(ge=0.01, le=1)]
_Fraction = Annotated[float, Field(ge=0, le=1)]
CREAM = (0.93, 0.87, 0.73)
ANY = "any"
"""In a pair, this name means every object."""
FLAT = Ground | HalfSpace | Press | Container
"""Boundaries that a freely moving solid can touch."""


class SceneObject(Object):
    """A further object, made from a picture, a file of Gaussians, a mesh, or a plain shape.

    If no source is set, the object is made from the next picture on the command line or, if there
    is none, copied from the first object.
    """

    name: Name = Field()
    """Name of the object."""
    picture: FileName | None = Field(default=None, examples=["teddy.png"])
    """Picture from which the object is made."""
    file: FileName | None = Field(default=None, examples=["teddy.ply"])
    """File of Gaussians, or clip whose first frame is used."""
    generator: str | None = Field(default=None, max_length=1000, examples=["relief"])
    """Generator for the object's picture; default: the first object's generator."""
    mesh: FileName | None = omit_default(None, examples=["chair.glb"])
    """Mesh from which the object is made: .glb, .gltf, .obj, .stl or .ply."""
    shape: ShapeName | None = Field(default=None, examples=["box"])
    """Plain shape: sphere, box or capsule."""
    sides: tuple[_Side, _Side, _Side] = (1.0, 1.0, 1.0)
    """Proportions of the shape along x, y and z; its longest side is `size` [m]."""
    colour: RGB = CREAM
    """Colour of the shape, or of a mesh without colours: red, green, blue from 0 to 1, or CSS name.
    """
    static: bool = False
    """Scenery: the object is visible, but does not move or touch anything."""
    motion: OwnMotion | None = omit_default(None)
    """Motion of a rigid shape. path or swing: the motion is prescribed, so the shape pushes other
    objects, but they do not push the shape. free: the shape moves under gravity and contact with
    walls and other objects.
    """
    material: AnyMaterial = NeoHookean()
    """Constitutive law."""
    parts: tuple[Part, ...] = ()
    """Parts made of other materials."""
    crop: tuple[_Fraction, _Fraction, _Fraction, _Fraction] = (0.0, 0.0, 1.0, 1.0)
    """Rectangle of the object (left, top, right, bottom) in the picture on which masks of the
    object's parts were painted; determined automatically for an object from a picture or a clip.
    """

    @model_validator(mode="after")
    def _check_source(self) -> SceneObject:
        names = ("picture", "file", "mesh", "shape")
        sources = [name for name in names if getattr(self, name) is not None]
        if len(sources) > 1:
            raise ValueError(f"{self.name} has {' and '.join(sources)}; give one of them")
        if any(part.surroundings for part in self.parts):
            raise ValueError("only the first object may have surroundings; remove them")
        return self

    @model_validator(mode="after")
    def _check_motion(self) -> SceneObject:
        if self.motion is None:
            return self
        if self.shape is None:
            raise ValueError(f"{self.name} has a motion but no shape; only shapes follow a motion")
        led = not self.free
        if self.static or self.held or (led and any((*self.velocity, *self.spin))):
            raise ValueError(
                f"{self.name} has a motion, which determines how it moves; remove static, held, "
                "velocity and spin"
            )
        if led and self.on != FLOOR:
            raise ValueError(
                f"{self.name} has a motion, so it cannot stand on another object; use lift"
            )
        if led and any(self.turn) and self.shape != "sphere":
            raise ValueError(f"{self.name} has a motion and cannot be rotated; remove `turn`")
        round_ = sorted(self.sides)[: 3 if self.shape == "sphere" else 2]
        if self.shape != "box" and round_[0] != round_[-1]:
            which = "all 3" if self.shape == "sphere" else "the 2 shorter"
            raise ValueError(
                f"{self.name} has a motion, so its cross-section must be round; make {which} "
                "sides equal"
            )
        if self.shape == "capsule" and min(self.sides) == max(self.sides):
            raise ValueError(
                f"{self.name} is a capsule whose length equals its width; lengthen one side, or "
                "use a sphere"
            )
        return self

    @property
    def scenery(self) -> bool:
        """Whether the object has no particles."""
        return self.static or self.motion is not None

    @property
    def free(self) -> bool:
        """Whether the object is a rigid solid that moves freely."""
        return isinstance(self.motion, Free)

    @property
    def path(self) -> Path | Swing | None:
        """Prescribed motion of the object; None if there is none."""
        return None if isinstance(self.motion, Free) else self.motion

    @property
    def half(self) -> NDArray[np.float64]:
        """Half the side lengths of the shape [3], m."""
        return np.array(self.sides) / max(self.sides) * self.size / 2

    def solid(self, pairs: Sequence[Pair]) -> Movable:
        """Return the boundary that moves along the object's path."""
        half = self.half
        centre = np.array([*self.place, self.lift + half[2]])
        pair = find_pair(pairs, self.name, ANY)
        fields: dict[str, Any] = {
            "motion": self.path,
            "friction": pair.friction,
            "contact": pair.contact,
        }
        if self.shape == "box":
            return Box(lower=vector(centre - half), upper=vector(centre + half), **fields)
        if self.shape == "sphere":
            return Sphere(centre=vector(centre), radius=float(half[0]), **fields)
        along = np.zeros(3)
        along[half.argmax()] = half.max() - half.min()
        fields |= {"start": vector(centre - along), "end": vector(centre + along)}
        return Capsule(radius=float(half.min()), **fields)

    @property
    def waits(self) -> bool:
        """Whether the object is made from the next picture on the command line."""
        return not (self.picture or self.file or self.mesh or self.shape)


class Pair(Section):
    """Contact of two objects."""

    between: tuple[Name, Name] = (ANY, ANY)
    """Names of the two objects; any means all objects not named in another entry."""
    contact: Literal["separate", "sticky"] = "separate"
    """separate (the objects slide with friction and may separate), or sticky."""
    friction: float = Field(default=0.5, ge=0, le=10)
    """Coulomb friction coefficient; 0 means no friction."""


def check_objects(first: Object, others: Sequence[SceneObject]) -> None:
    """Check that names differ, and that each object stands on the floor or a known object.

    Raises:
        ValueError: Two names are equal, or an object stands on itself or on an unknown object.
    """
    objects = {first.name: first}
    for other in others:
        if other.name in objects:
            raise ValueError(f"two objects are called {other.name}; give them different names")
        objects[other.name] = other
    for name, item in objects.items():
        if name in (FLOOR, ANY):
            raise ValueError(f"no object can be called {name}; give it another name")
        seen = [name]
        while item.on != FLOOR:
            check_name(item.on, [FLOOR, *objects])
            seen.append(item.on)
            if item.on in seen[:-1]:
                circle = " on ".join(seen[seen.index(item.on) :])
                raise ValueError(
                    f"objects cannot stand on each other in a circle ({circle}); lift one of them"
                )
            item = objects[item.on]


def check_free(objects: Sequence[Object], boundaries: Sequence[Any]) -> None:
    """Check that a freely moving solid cannot pass through a boundary or another object.

    Raises:
        ValueError: The solid would pass through a boundary or another object.
    """
    free = [item.name for item in objects if isinstance(item, SceneObject) and item.free]
    if not free:
        return
    if len(free) > 1:
        raise ValueError(
            f"contact between {free[0]} and {free[1]}, two freely moving solids, is not computed; "
            "remove the `motion` of one of them to simulate it with particles"
        )
    for item in objects:
        led = isinstance(item, SceneObject) and item.path is not None
        if item.held or led:
            how = "follows a path" if led else "is held"
            raise ValueError(
                f"{item.name} {how}, and the freely moving solid {free[0]} would pass through it; "
                "remove one of them, or use flat boundaries"
            )
    for wall in boundaries:
        if not (isinstance(wall, FLAT) or wall.holds):
            raise ValueError(
                f"the freely moving solid {free[0]} would pass through the boundary {wall.kind}; "
                "use ground, half_space, press or container"
            )


def check_pairs(pairs: Sequence[Pair], names: Sequence[str], solids: Sequence[str]) -> None:
    """Check that each pair of objects is declared at most once.

    Args:
        pairs: The declared pairs.
        names: Names of all objects.
        solids: Names of the moved shapes, whose contact is the same with every object.

    Raises:
        ValueError: A name is unknown, two entries declare the same pair, or an entry is for a moved
            shape and a single object.
    """
    seen: set[frozenset[str]] = set()
    for pair in pairs:
        two = frozenset(pair.between)
        for name in two - {ANY}:
            check_name(name, names)
        if len(two) == 1 and ANY not in two:
            raise ValueError(f"`between` names {pair.between[0]} twice; name two different objects")
        if ANY not in two and not two.isdisjoint(solids):
            solid = next(name for name in pair.between if name in solids)
            raise ValueError(
                f"`between` is {list(pair.between)}, but the contact of the moved shape {solid} is "
                f"the same with every object; use between = {[solid, ANY]}"
            )
        if two in seen:
            about = " and ".join(pair.between)
            raise ValueError(f"two entries of `pairs` are for {about}; remove one")
        seen.add(two)


def find_pair(pairs: Sequence[Pair], first: str, second: str) -> Pair:
    """Return the contact of two objects; an entry with both names takes precedence."""
    fitting = [pair for pair in pairs if set(pair.between) <= {first, second, ANY}]
    return min(fitting, key=lambda pair: pair.between.count(ANY), default=Pair())


def check_name(name: str, names: Sequence[str], solids: Sequence[str] = ()) -> None:
    """Check that an object of this name exists, and that it is none of `solids`, which have no
    particles.

    Raises:
        ValueError: No object has this name, or the object has no particles.
    """
    if name in solids:
        raise ValueError(
            f"{name} has no particles, so that no force or boundary acts on it alone; "
            f"remove `object`, or choose one of: {', '.join(names)}"
        )
    if name not in names:
        raise ValueError(f"no object is called {name}; there are {', '.join(names)}")
