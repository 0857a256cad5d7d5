"""Several objects in one scene: those besides the first, and what happens where two touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.boundaries import Box, Capsule, Sphere
from phy124.boundaries.base import Movable, vector
from phy124.boundaries.motion import Free, OwnMotion, Path, Swing
from phy124.bounds import FileName, Name
from phy124.materials import AnyMaterial, NeoHookean
from phy124.scene.sections import FLOOR, Object, Part
from phy124.scene.view import Background
from phy124.section import Section

ShapeName = Literal["sphere", "box", "capsule"]
_Side = Annotated[float, Field(ge=0.01, le=1)]
_Fraction = Annotated[float, Field(ge=0, le=1)]
CREAM = (0.93, 0.87, 0.73)


ANY = "any"
"""Instead of an object's name: whichever it is."""


class SceneObject(Object):
    """A further object: from a picture, from a file of Gaussians, a mesh, or a plain shape.

    Without any of these it is made from the next picture of the command; if there is none, it is
    a copy of the first object.
    """

    name: Name = Field(description="What the scene calls it.")
    picture: FileName | None = Field(
        default=None, examples=["teddy.png"], description="Picture that it is made from."
    )
    file: FileName | None = Field(
        default=None,
        examples=["teddy.ply"],
        description="File of Gaussians that it is read from, or a clip: its first frame.",
    )
    generator: str | None = Field(
        default=None,
        max_length=1000,
        examples=["relief"],
        description="What makes it of its picture; absent: what makes the first object.",
    )
    mesh: FileName | None = Field(
        default=None,
        exclude_if=lambda path: path is None,
        examples=["chair.glb"],
        description="File of triangles that it is made of: .glb, .gltf, .obj, .stl or .ply.",
    )
    shape: ShapeName | None = Field(
        default=None, examples=["box"], description="A sphere, box or capsule without a picture."
    )
    sides: tuple[_Side, _Side, _Side] = Field(
        default=(1.0, 1.0, 1.0),
        description="Sides of the shape along x, y and z relative to each other; the longest is "
        "`size` [m].",
    )
    colour: Background = Field(
        default=CREAM,
        description="Colour of the shape, or of a mesh without colours: red, green, blue from 0 to "
        "1, or CSS name.",
    )
    static: bool = Field(
        default=False, description="Scenery: it is seen, but neither moves nor touches anything."
    )
    motion: OwnMotion | None = Field(
        default=None,
        exclude_if=lambda motion: motion is None,
        description="Its displacement over time: path or swing. A shape that has one moves so, "
        "whatever it meets: it pushes the others and nothing pushes it. Or free: it is rigid, "
        "moves as gravity, walls and the others push it, and pushes them back.",
    )
    material: AnyMaterial = Field(default=NeoHookean(), description="Constitutive law.")
    parts: tuple[Part, ...] = Field(default=(), description="Parts of other materials.")
    crop: tuple[_Fraction, _Fraction, _Fraction, _Fraction] = Field(
        default=(0.0, 0.0, 1.0, 1.0),
        description="Where it is in the picture that masks of its parts were painted on: left, "
        "top, right, bottom; of its own picture this is found.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> SceneObject:
        sources = ("picture", "file", "mesh", "shape")
        given = [name for name in sources if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{self.name} has {' and '.join(given)}; give one of them")
        if any(part.surroundings for part in self.parts):
            raise ValueError("only the first object may have surroundings; leave them out")
        return self

    @model_validator(mode="after")
    def _may_be_moved(self) -> SceneObject:
        if self.motion is not None:
            self._check_moved()
        return self

    def _check_moved(self) -> None:
        """Check that an object with a motion is a solid that walls know.

        Raises:
            ValueError: It is not.
        """
        if self.shape is None:
            raise ValueError(f"{self.name} has a motion but no shape; only shapes follow a motion")
        led = not self.free
        if self.static or self.held or (led and any((*self.velocity, *self.spin))):
            raise ValueError(
                f"{self.name} has a motion; leave out static, held, velocity and spin, which say "
                "otherwise how it moves"
            )
        if led and self.on != FLOOR:
            raise ValueError(f"{self.name} has a motion, so it stands on the floor; use lift")
        if led and any(self.turn) and self.shape != "sphere":
            raise ValueError(f"{self.name} has a motion and cannot be turned; leave turn out")
        round_ = sorted(self.sides)[: 3 if self.shape == "sphere" else 2]
        if self.shape != "box" and round_[0] != round_[-1]:
            raise ValueError(
                f"{self.name} has a motion, so it must be round; give {len(round_)} equal sides"
            )

    @property
    def scenery(self) -> bool:
        """Whether it has no particles: it stays as it is, or is a solid with a motion."""
        return self.static or self.motion is not None

    @property
    def free(self) -> bool:
        """Whether it is a rigid solid that moves freely."""
        return isinstance(self.motion, Free)

    @property
    def path(self) -> Path | Swing | None:
        """What leads it; None: nothing."""
        return None if isinstance(self.motion, Free) else self.motion

    @property
    def half(self) -> NDArray[np.float64]:
        """Half the sides of the shape [3], m."""
        return np.array(self.sides) / max(self.sides) * self.size / 2

    def solid(self, pairs: Sequence[Pair]) -> Movable:
        """The wall that an object with a path is for others.

        Args:
            pairs: What happens where two objects touch.
        """
        half = self.half
        middle = np.array([*self.place, self.lift + half[2]])
        how = pair_of(pairs, self.name, ANY)
        given: dict[str, Any] = {"motion": self.path, "friction": how.friction}
        given["contact"] = how.contact
        if self.shape == "box":
            return Box(lower=vector(middle - half), upper=vector(middle + half), **given)
        if self.shape == "sphere":
            return Sphere(centre=vector(middle), radius=float(half[0]), **given)
        along = np.zeros(3)
        along[half.argmax()] = half.max() - half.min()
        ends = {"start": vector(middle - along), "end": vector(middle + along)}
        return Capsule(radius=float(half.min()), **ends, **given)

    @property
    def waits(self) -> bool:
        """Whether it takes the next picture of the command, if there is one."""
        return not (self.picture or self.file or self.mesh or self.shape)


class Pair(Section):
    """What happens where two objects touch."""

    between: tuple[Name, Name] = Field(
        default=(ANY, ANY),
        description="Names of the two; any stands for those of which no other entry says more.",
    )
    contact: Literal["separate", "sticky"] = Field(
        default="separate", description="separate (they slide with friction and part), or sticky."
    )
    friction: float = Field(
        default=0.5, ge=0, le=10, description="Coulomb friction coefficient; 0: they slip."
    )


def check_objects(first: Object, others: Sequence[SceneObject]) -> None:
    """Check that the objects of a scene can be told apart and stand on something.

    Raises:
        ValueError: Two have one name, or one stands on itself or on what there is not.
    """
    objects = {first.name: first}
    for other in others:
        if other.name in objects:
            raise ValueError(f"two objects are called {other.name}; give each its own name")
        objects[other.name] = other
    for name, one in objects.items():
        if name in (FLOOR, ANY):
            raise ValueError(f"no object can be called {name}; give it another name")
        seen = {name}
        while one.on != FLOOR:
            check_name(one.on, [FLOOR, *objects])
            if one.on in seen:
                raise ValueError(f"{name} stands on {one.on}, which stands on it; lift one of them")
            seen.add(one.on)
            one = objects[one.on]


def check_pairs(pairs: Sequence[Pair], names: Sequence[str]) -> None:
    """Check that each pair of objects is declared once at most.

    Raises:
        ValueError: A name is not that of an object, or two entries are about the same pair.
    """
    seen: set[frozenset[str]] = set()
    for pair in pairs:
        two = frozenset(pair.between)
        for name in two - {ANY}:
            check_name(name, names)
        if len(two) == 1 and ANY not in two:
            raise ValueError(f"between names {pair.between[0]} twice; name two objects")
        if two in seen:
            about = " and ".join(pair.between)
            raise ValueError(f"two entries of pairs are about {about}; leave one out")
        seen.add(two)


def pair_of(pairs: Sequence[Pair], one: str, other: str) -> Pair:
    """What happens where two objects touch: the entry that names most of them."""
    fitting = [pair for pair in pairs if set(pair.between) <= {one, other, ANY}]
    return min(fitting, key=lambda pair: pair.between.count(ANY), default=Pair())


def check_name(name: str, names: Sequence[str]) -> None:
    """Check that an object is called so.

    Raises:
        ValueError: None is.
    """
    if name not in names:
        raise ValueError(f"no object is called {name}; there are {', '.join(names)}")
