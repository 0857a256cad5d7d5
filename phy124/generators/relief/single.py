"""Builds the shell of an object from an image of the front alone."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.generators.relief.angular import is_angular
from phy124.generators.relief.back import BackLook, card_back, choose_look, plain_back
from phy124.generators.relief.boards import board_shell
from phy124.generators.relief.borders import has_border
from phy124.generators.relief.boxes import Cuboid, find_box
from phy124.generators.relief.caps import Cap, colour_cap, make_cap
from phy124.generators.relief.cards import is_card
from phy124.generators.relief.colours import (
    REACH,
    Shown,
    blend_pictures,
    clean_picture,
    colour_points,
)
from phy124.generators.relief.elevation import Raised
from phy124.generators.relief.ends import Continued, continue_silhouette
from phy124.generators.relief.flat import flatten
from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.legs import Legs, find_legs
from phy124.generators.relief.light import fit_light, unlight
from phy124.generators.relief.oblique import carve, find_oblique
from phy124.generators.relief.picture import PADDING, WORK, opaque_size, work_picture
from phy124.generators.relief.rings import find_ring
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.shoulders import Shoulder, find_shoulder
from phy124.generators.relief.sides import Box, check_back
from phy124.generators.relief.solids import (
    apply_depth,
    flat_topped,
    half_thickness,
    inflate,
    is_block,
    is_polygonal,
    is_turned,
    make_slab,
)
from phy124.generators.relief.surface import VIEW_DISTANCE, Surface, View, spread
from phy124.generators.relief.table_fit import CLEAR, OVERLAP, find_table
from phy124.generators.relief.thin import circles_on_ground, find_thin
from phy124.generators.relief.vessel import vessel_shell

CARD = 0.12
"""Largest half thickness of a slab that counts as a card, relative to the image's size. Thicker
slabs are blocks.
"""
SHEET = 0.05
"""Half thickness to which cards and objects with a border are limited, relative to the image's
size.
"""
BLOCK = 0.8
"""Behind a block's rim, the colours change gradually to those of the back. This is the largest
depth of this change, relative to half the block's depth.
"""

Field = NDArray[np.float64]
Shape = Literal["auto", "round", "upright", "flat"]
Step = Callable[[int], None]
RECOGNISED = (
    "It has no effect, because the object was recognised as a vessel, a ring, a box or a table, "
    "whose back follows from its shape. To inflate the silhouette instead, set shape = round."
)
OBLIQUE = (
    "The picture seems to show two sides of the object, so its depth is a guess. If it is wrong, "
    "give a picture from the front and a picture from the side, or set shape = round."
)
FRONT, BACK, ACROSS = np.array([0.0, 0, 1]), np.array([0.0, 0, -1]), np.array([1.0, 0, 0])


def from_front(
    picture: Image.Image,
    *,
    count: int,
    rng: np.random.Generator,
    step: Step,
    depth: NDArray | None,
    back: Image.Image | None,
    look: BackLook,
    thickness: float,
    shape: Shape,
    elevation: float | None,
) -> Shell:
    """Build the upright shell of an object: a ring, a vessel, a box, a table, an object
    that shows two sides, or the inflated silhouette.

    Args:
        picture: Image of the front.
        count: Approximate number of points.
        rng: Random number generator.
        step: Called with the number of finished steps.
        depth: Depth map of the image; None: the front is inflated like the back.
        back: Image of the object from behind.
        look: How the back looks if there is no image from behind.
        thickness: Factor of the guessed depth.
        shape: Kind of solid; "auto": the most plausible one.
        elevation: Angle above the horizontal from which the picture was taken [degrees]; None:
            estimated for a vessel, a ring, a box and an object that shows two sides, and 0 for
            other objects.
    """
    rgba = work_picture(picture, depth=depth)
    view = View.of(rgba[..., 3] > 0.5, VIEW_DISTANCE * WORK)
    legs = box = None
    if depth is None and back is None:
        shell = None
        if shape in ("auto", "upright"):
            shell = _ring_shell(rgba, view, count, elevation)
        if shell is None and shape in ("auto", "upright"):
            shell = vessel_shell(rgba, view, count, rng, elevation, always=shape == "upright")
        if shell is None and shape == "auto" and (box := find_box(rgba[..., 3] > 0.5, view)):
            shell = _box_shell(box, clean_picture(rgba), count, elevation)
        if shell is None and shape == "auto":
            legs = _legs_beside(rgba)
            least = OVERLAP if legs is None else CLEAR
            shell = _table_shell(rgba, view, count, rng, elevation, least)
        if shell is not None:
            if look != "auto":
                warnings.warn(f"back_look = {look}: {RECOGNISED}", stacklevel=3)
            step(1)
            return shell if thickness == 1 else shell.scale_depth(thickness)
        if shape == "auto" and legs is None:
            box = find_oblique(rgba[..., 3] > 0.5, view)
    work = continue_silhouette(rgba, PADDING) if legs is None else legs.trunk
    shell = _inflated_shell(
        work if box is None else Continued(rgba, rgba[..., 3], ()),
        count=count if legs is None else round(count * (1 - legs.share)),
        rng=rng,
        step=step,
        back=back,
        look=look,
        thickness=thickness,
        shape=shape if legs is None else "round",
        legs=legs,
        box=box,
    )
    if box is not None:
        warnings.warn(OBLIQUE, stacklevel=3)
        turn = box.upright() if elevation is None else _turn(elevation)
        shell = replace(shell, points=shell.points @ turn, normals=shell.normals @ turn)
        return shell if thickness == 1 else shell.scale_depth(thickness)
    return Raised(np.radians(elevation), view.distance).stand(shell) if elevation else shell


def _inflated_shell(
    work: Continued,
    *,
    count: int,
    rng: np.random.Generator,
    step: Step,
    back: Image.Image | None,
    look: BackLook,
    thickness: float,
    shape: Shape,
    legs: Legs | None,
    box: Cuboid | None,
) -> Shell:
    """Inflate the silhouette to a shell that the front camera sees, or carve it out of a box.

    If the image has a fifth channel, this channel is the depth map. If the object has legs, the
    image shows the body without the legs.
    """
    view = View.of(work.object_mask if legs is None else legs.object_mask, VIEW_DISTANCE * WORK)
    shoulder = find_shoulder(work)
    silhouette = Silhouette.of(work.alpha)
    half = half_thickness(silhouette, work, WORK, shape, _parts_thickness(work, shoulder, legs))
    mapped, thin, limited = work.rgba.shape[2] > 4, None, None
    half, most = _sheet(half, work) if shape == "auto" and not mapped else (half, 1.0)
    if box is not None:
        half, surface = None, carve(box, work.alpha)
    elif half is None:
        work = work.shorten()
        surface = make_slab(work, view, thickness, most * WORK if most < 1 else None)
    else:
        thin = find_thin(work.object_mask) if shape == "auto" and not mapped else None
        half = half if thin is None else thin.flatten(half)
        surface = inflate(half, silhouette, work, view, thickness)
        if thin is None and not mapped and shape != "round":
            limited = _flatten(half, surface, work, shoulder, shape, most)
            if limited is not None:
                surface = inflate(limited, silhouette, work, view, thickness)
    if shoulder is not None and half is not None:
        surface = shoulder.close(surface, view, work.alpha)
    if mapped:
        surface = apply_depth(surface, work.rgba[..., 4], work.object_mask)
    step(1)
    points, normals, spacing, caps = _points(surface, view, work, count, rng, lambda: step(1))
    step(2)
    picture = work.rgba if legs is None else legs.rgba
    front = clean_picture(picture[..., :4])
    inner = points - surface.inset(points, DRAWN_IN) * normals
    drawn, turned = view.project_points(inner, normals)
    if back is None:
        light = fit_light(front, surface, work.object_mask)
        unlit = unlight(front, surface, light)
        if look == "auto":
            look = _look(picture, thin is not None or box is not None, half is None)
        imagined, reach = unlit, 0.0
        if look == "plain":
            reach = _reach_behind(surface, half is None, limited is not None)
            inside = work.alpha > 0.5
            imagined = (
                plain_back(
                    unlit, inside, WORK, rng, half is not None and is_turned(work.object_mask)
                )
                if reach
                else card_back(unlit, inside)
            )
        walls = slice(len(points) - sum(len(cap.points) for cap in caps))
        rgb = np.concatenate(
            [
                colour_points(
                    points[walls], normals[walls], surface, front, unlit, imagined, light, reach
                ),
                *(colour_cap(cap, unlit, light) for cap in caps),
            ]
        )
    else:
        scale = Box.of(work.object_mask).size[1] / opaque_size(back)[1]
        middle = float(view.middle[0]), float(view.middle[1])
        shown = Shown(front, middle, FRONT, ACROSS), show_back(back, scale, work.object_mask)
        rgb = blend_pictures(drawn, turned, shown, view.distance)
    step(3)
    shell = Shell(drawn, turned, spacing, rgb)
    return shell if legs is None else legs.join(shell, surface, view, front, rng)


def _look(rgba: Field, alike: bool, slab: bool) -> Literal["mirror", "plain"]:
    return "mirror" if alike else "plain" if slab else choose_look(rgba)


def _sheet(half: Field | None, work: Continued) -> tuple[Field | None, float]:
    """Return the squared half thicknesses (None for a card), and the largest half thickness.

    The largest half thickness is relative to the image's size, and 1 if there is no limit.
    """
    if is_card(work.rgba, plain=half is None):
        return None, SHEET
    return half, SHEET if has_border(work.rgba) else 1.0


def _parts_thickness(work: Continued, shoulder: Shoulder | None, legs: Legs | None) -> Field | None:
    if legs is not None and legs.wheeled:
        return flat_topped(work.alpha > 0.5)
    return shoulder and shoulder.round_thickness(work.alpha)


def _legs_beside(rgba: Field) -> Legs | None:
    """Return the legs of an object that an image [H,W,4] shows from the side, or None.

    A symmetric outline is assumed to show an object from the front, so no legs are returned, unless
    the outline is as wide as a car. No legs are returned for boxes, objects with thin parts and
    scooters either.
    """
    legs = find_legs(rgba)
    if legs is None or find_thin(legs.object_mask) or is_polygonal(legs.object_mask):
        return None
    if circles_on_ground(legs.object_mask):
        return None
    return legs if legs.is_long or choose_look(rgba) == "mirror" else None


def _flatten(
    half: Field,
    surface: Surface,
    work: Continued,
    shoulder: Shoulder | None,
    shape: Shape,
    most: float,
) -> Field | None:
    """Return squared half thicknesses of a flat or angular object; None for a round one.

    `most` is the largest half thickness, relative to the image's size.
    """
    block = is_block(work) or (shoulder is not None and is_angular(work.rgba))
    always = shape == "flat" or most < 1 or (shape == "auto" and block)
    return flatten(half, surface, work, WORK, always=always, most=most)


def _ring_shell(rgba: Field, view: View, count: int, elevation: float | None) -> Shell | None:
    middle, radians = view.middle[:2], None if elevation is None else float(np.radians(elevation))
    ring = find_ring(rgba[..., 3] > 0.5, middle, view.distance, radians)
    return ring and ring.shell(count, clean_picture(rgba), middle)


def _table_shell(
    rgba: Field,
    view: View,
    count: int,
    rng: np.random.Generator,
    elevation: float | None,
    least: float,
) -> Shell | None:
    middle, radians = view.middle[:2], None if elevation is None else float(np.radians(elevation))
    table = find_table(rgba[..., 3] > 0.5, middle, view.distance, radians, least)
    return table and board_shell(table.boards(), rgba, middle, table.camera, count, rng)


def _box_shell(box: Cuboid, front: Field, count: int, elevation: float | None) -> Shell:
    points, normals, pitch = box.spread(count)
    middle = float(box.view.middle[0]), float(box.view.middle[1])
    seen = Shown(front, middle, FRONT, ACROSS).colours(points, box.view.distance)
    spacing = np.full(len(points), pitch)
    turn = box.upright() if elevation is None else _turn(elevation)
    colours = box.colours(points, normals, seen)
    return Shell(points @ turn, normals @ turn, spacing, colours)


def _turn(elevation: float) -> Field:
    return Raised(np.radians(elevation), 1.0).turn


def _reach_behind(surface: Surface, slab: bool, flat: bool) -> float:
    """Return the depth behind the rim [pixels] over which the colours change gradually to the
    back's colours; 0 for a card.
    """
    deepest = float(np.sqrt(max(surface.w.max(), 0.0)))
    if slab and deepest <= CARD * WORK:
        return 0.0
    return min(REACH * WORK, BLOCK * deepest) if slab or flat else REACH * WORK


def show_back(back: Image.Image, scale: float, object_mask: NDArray[np.bool_]) -> Shown:
    """Mirror an image from behind, and compare it with the front's silhouette [H,W].

    Raises:
        InputError: If the silhouettes differ.
    """
    rgba = work_picture(back, scale)[:, ::-1]
    solid = rgba[..., 3] > 0.5
    check_back(object_mask, solid)
    return Shown(clean_picture(rgba), Box.of(solid).middle, BACK, ACROSS)


def _points(
    surface: Surface,
    view: View,
    work: Continued,
    count: int,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[Field, Field, Field, list[Cap]]:
    """Return points, normals and spacing (first of the walls, then of the caps), and the caps
    themselves.
    """
    points, normals, spacing, pitch = spread(surface, work.ends, count, rng, alive)
    caps = [make_cap(surface, view, end, work.object_mask, pitch) for end in work.ends]
    kept = np.ones(len(points), bool)
    for face in caps:
        kept &= face.plane.includes(points, DRAWN_IN)
    walls = points[kept], normals[kept], spacing[kept]
    faces = [(face.points, face.normals, np.full(len(face.points), pitch)) for face in caps]
    points, normals, spacing = (np.concatenate(all_) for all_ in zip(walls, *faces, strict=True))
    return points, normals, spacing, caps
