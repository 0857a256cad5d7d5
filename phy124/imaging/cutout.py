"""Segments the object of an image, and warns if the segmentation is implausible."""

import io
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.imaging import salient, u2net
from phy124.imaging.grabcut import find_conspicuous, grabcut
from phy124.imaging.hollow import find_hollow
from phy124.imaging.image import open_image, open_mask, original_size
from phy124.imaging.matting import decontaminate
from phy124.imaging.objects import Point, keep_largest, pixel_at, search_around, select_object
from phy124.imaging.silhouette import (
    count_pieces,
    find_touched_edges,
    measure_alike,
    measure_undecided,
    measure_unseen,
)
from phy124.imaging.touching import select_part, split_touching
from phy124.imaging.transparency import has_alpha, is_faint, make_solid, shows_object
from phy124.runtime import isolated

Alpha = NDArray[np.uint8]
MAXIMUM = 0.97
"""Largest fraction of the image that an object may cover."""
TINY, MUCH = 0.02, 0.85
"""A warning is shown if the object covers less or more than these fractions of the image."""
WIDER = 3.0
"""Side of the window in which a small object is searched, relative to the object's longest side."""
SIDES = 3
"""A warning is shown if a cut-out touches this number of image edges. Such a cut-out may include
background, for example a table.
"""
PIECES = 4
"""A warning is shown if a cut-out has this number of pieces."""
UNSEEN = 0.12
"""Largest fraction of the outline that may lie where the image has no edge. In correct cut-outs,
the fraction is 0.05.
"""
ALIKE = 0.1
"""Largest fraction of the surroundings that may have the object's colours. In correct cut-outs, the
fraction is 0.09.
"""
UNDECIDED = 0.02
"""A warning is shown if `undecided` exceeds this value in a network's cut-out."""
FAINT = "No part of the picture is opaque; its most opaque part is treated as opaque."
REMEDY = (
    "Use a picture that shows one whole object on a plain background, crop the picture around the "
    "object, give a mask (white where the object is), or save the cut-out object as PNG with "
    "transparency."
)
LATE = f"Try again when the machine is less busy. {REMEDY}"


class Method(NamedTuple):
    """A method that segments the object of an image."""

    applies: Callable[[Image.Image], bool]
    """Tests whether "auto" may choose this method for an image."""
    find: Callable[[Image.Image, isolated.Deadline], Alpha]
    """Returns the alpha [H,W] of the object."""
    title: str = ""


@dataclass(frozen=True)
class Cutout:
    """An RGBA image whose alpha is the mask of the object, with measures of plausibility."""

    picture: Image.Image
    """The image in mode RGBA, with straight (not premultiplied) alpha."""
    method: str
    """Name of the method in `METHODS`; "mask" if the user gave a mask; "brush" if a person
    corrected the cut-out.
    """
    coverage: float
    pieces: int
    """Number of connected pieces, without pieces smaller than a hundredth of the object."""
    touches: tuple[str, ...]
    """Image edges that the object nearly reaches: left, top, right, bottom."""
    unseen: float
    """Fraction of the outline along which the image has no edge."""
    alike: float
    """Fraction of the surrounding pixels whose colour is more common in the object."""
    undecided: float = 0.0
    """Half-transparent area away from the outline, relative to the object's area."""
    frames: int = 1
    """Number of frames of an animation; only the first frame was used."""
    objects: int = 1
    touching: bool = False
    """Whether the cut-out seems to contain two objects that touch."""
    file: Path | None = None
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Name of the method in messages."""
        return title_of(self.method)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons why the cut-out may not be the intended object."""
        return (*self._doubt_choice(), *self._doubt_size(), *self._doubt_outline())

    def _doubt_choice(self) -> Iterator[str]:
        if self.frames > 1:
            yield f"The picture is an animation of {self.frames} frames; the first is used."
        if self.objects > 1:
            yield f"The picture has {self.objects} separate objects; the largest is taken."
        if self.touching:
            yield "These may be two objects that touch; if so, pick the object that you want."
        if self.pieces >= PIECES:
            yield f"The cut-out is in {self.pieces} pieces."
        if self.pieces == 0:
            yield "The cut-out consists only of specks."

    def _doubt_size(self) -> Iterator[str]:
        # Networks are exempt: their cut-outs rarely include background, but touch edges if a person
        # is cropped by the picture.
        if len(self.touches) >= SIDES and self.method not in ("alpha", *NETWORKS):
            yield (
                f"The cut-out touches {len(self.touches)} edges of the picture "
                f"({', '.join(self.touches)}): it may include background."
            )
        if self.coverage < TINY:
            yield f"The cut-out is tiny: {self.coverage:.1%} of the picture."
        if self.coverage > MUCH and self.method != "alpha":
            yield f"The cut-out covers nearly the whole picture ({self.coverage:.0%})."

    def _doubt_outline(self) -> Iterator[str]:
        if self.method in ("alpha", "mask", "brush"):
            return
        if self.unseen > UNSEEN:
            yield f"{self.unseen:.0%} of the cut-out's outline runs where the picture has no edge."
        if self.undecided > UNDECIDED and self.method in NETWORKS:
            yield (
                f"{self.undecided:.0%} of the cut-out is half transparent away from its outline: "
                "it is uncertain whether these parts belong to the object."
            )
        if self.alike > ALIKE:
            yield (
                f"{self.alike:.0%} of the cut-out's surroundings has the same colours as the "
                "cut-out: a part of the object may be missing, or a part of the background "
                "included."
            )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the image as lossless PNG or WebP."""
        self.picture.save(path, compress_level=1, lossless=True, exact=True)

    def png(self) -> bytes:
        """Return the bytes of a PNG file."""
        written = io.BytesIO()
        self.picture.save(written, "PNG", compress_level=1)
        return written.getvalue()

    def data(self) -> dict[str, Any]:
        """Return all fields as plain data, except for the pixels and the file."""
        return {
            "method": self.method,
            "coverage": round(self.coverage, 4),
            "pieces": self.pieces,
            "touches": list(self.touches),
            "unseen": round(self.unseen, 4),
            "alike": round(self.alike, 4),
            "undecided": round(self.undecided, 4),
            "frames": self.frames,
            "objects": self.objects,
            "touching": self.touching,
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }


def cut_out(
    picture: str | os.PathLike[str],
    method: str = "auto",
    *,
    mask: str | os.PathLike[str] | None = None,
    pick: Point | None = None,
    field: str = "image",
    deadline: isolated.Deadline = isolated.PATIENT,
) -> Cutout:
    """Open an image file and segment its object.

    Args:
        picture: Path of the image.
        method: Name of a method in `METHODS`, or "auto" for the first method that is applicable.
        mask: Path of a mask that replaces the method.
        pick: A point on the object; see `foreground`.
        field: Name of the image in error messages.
        deadline: Time limit of the segmentation, and the means to cancel it.

    Raises:
        InputError: If a file cannot be used, or for the reasons listed at `foreground`.
    """
    image = open_image(picture, field=field, deadline=deadline)
    painted = None if mask is None else open_mask(mask)
    cutout = foreground(image, method, mask=painted, pick=pick, deadline=deadline)
    return replace(cutout, file=Path(picture))


def foreground(
    image: Image.Image,
    method: str = "auto",
    *,
    mask: Image.Image | None = None,
    pick: Point | None = None,
    deadline: isolated.Deadline = isolated.PATIENT,
) -> Cutout:
    """Segment the object of an opened image, and remove background colours from its soft edge.

    Args:
        image: An image in any mode.
        method: Name of a method in `METHODS`, or "auto" for the first method that is applicable.
        mask: A mask of the same size that replaces the method. The object is white or, if the mask
            has transparency, opaque.
        pick: A point on the object to segment: its distances from the left and the top, as
            fractions of the image's width and height. If None, the largest object is segmented.
        deadline: Time limit of the segmentation, and the means to cancel it.

    Raises:
        InputError: If the image is transparent; if the method is unknown, takes too long, or
            selects nothing or nearly everything; if there is no object at `pick`; if the mask has
            a different size; or if both a mask and a method are set.
    """
    _check_point(pick)
    frames, notes = image.info.get("frames", 1), image.info.get("notes", ())
    notes = (*notes, FAINT) if is_faint(image) else notes
    image = make_solid(image)
    _check_visible(image)
    count = 1
    if mask is not None:
        alpha, method = _apply_mask(image, mask, method), "mask"
    else:
        method = _choose_method(image, method)
        alpha = _search(image, method, deadline)
    if pick is not None:
        alpha = _pick_object(image, alpha, method, pick, deadline)
    elif method not in TAKEN_WHOLE:
        alpha, count = keep_largest(alpha)
        if not shows_object(alpha > 127):
            alpha, count = _search_conspicuous(image, method, deadline), 1
    _check_fraction(alpha, method, frames)
    searched = pick is None and method not in TAKEN_WHOLE
    touching = searched and split_touching(np.asarray(image.convert("RGB")), alpha) is not None
    original = _flatten(image, method).convert("RGB")
    image.putalpha(Image.fromarray(alpha))
    cut = image if method == "alpha" else clean_edge(image, alpha)
    rgb, solid = np.asarray(cut.convert("RGB")), np.asarray(cut)[..., 3] > 127
    notes = (*notes, *find_hollow(rgb, solid))
    measured = examine(cut, method, frames, count, original=original)
    return replace(measured, touching=touching, notes=notes)


def clean_edge(image: Image.Image, alpha: Alpha) -> Image.Image:
    """Apply an alpha [H,W], and remove background colours from the soft edge."""
    cut = Image.fromarray(decontaminate(np.asarray(image.convert("RGB")), alpha))
    cut.putalpha(Image.fromarray(alpha))
    return cut


def title_of(method: str) -> str:
    """Return the name of a method in messages."""
    known = METHODS[method].title if method in METHODS else PAINTED.get(method)
    return known or method


def examine(
    picture: Image.Image,
    method: str,
    frames: int = 1,
    objects: int = 1,
    *,
    original: Image.Image | None = None,
) -> Cutout:
    """Measure how plausible a cut-out is.

    Args:
        picture: RGBA image whose alpha segments the object.
        method: Name of a method in `METHODS`, or "mask" or "brush".
        frames: Number of frames of an animation.
        objects: Number of separate objects in the image.
        original: The image before its soft edge was cleaned, in which edges are searched; None:
            `picture`.
    """
    edges = np.asarray((original or picture).convert("RGB"))
    rgb, alpha = np.split(np.asarray(picture), (3,), axis=2)
    solid = alpha[..., 0] > 127
    return Cutout(
        picture,
        method,
        coverage=float(solid.mean()),
        pieces=count_pieces(solid),
        touches=find_touched_edges(solid),
        unseen=measure_unseen(edges, solid),
        alike=measure_alike(rgb, solid),
        undecided=measure_undecided(alpha[..., 0]),
        frames=frames,
        objects=objects,
    )


def _search(image: Image.Image, method: str, deadline: isolated.Deadline) -> Alpha:
    """Transparent pixels of the image remain transparent."""
    try:
        alpha = METHODS[method].find(_flatten(image, method), deadline)
    except isolated.Unfinished as error:
        limit = f"The search for the object by {method} {error}."
        raise InputError("foreground", method, limit, LATE) from error
    return np.minimum(alpha, np.asarray(image.getchannel("A")))


def _pick_object(
    image: Image.Image, alpha: Alpha, method: str, pick: Point, deadline: isolated.Deadline
) -> Alpha:
    picked = select_object(alpha, pick)
    if (picked is None or not shows_object(picked > 127)) and method not in TAKEN_WHOLE:
        picked = search_around(image, pick, lambda part: _search(part, method, deadline))
    if picked is None:
        limit = "No object was found at this point of the picture."
        remedy = (
            "Choose the middle of the object, or mark the object with "
            "a mask (on the page: with the brush)."
        )
        raise InputError("pick", f"{pick[0]:g},{pick[1]:g}", limit, remedy)
    return select_part(np.asarray(image.convert("RGB")), picked, pixel_at(pick, image.size))


def _search_conspicuous(image: Image.Image, method: str, deadline: isolated.Deadline) -> Alpha:
    """Search around the largest region that differs from the border, for a small object."""
    region = find_conspicuous(np.asarray(_flatten(image, method).convert("RGB")))
    nothing = np.zeros(image.size[::-1], np.uint8)
    if region is None:
        return nothing
    point, extent = region
    sides = (min(1.0, WIDER * extent),)
    alpha = search_around(image, point, lambda part: _search(part, method, deadline), sides)
    return nothing if alpha is None else alpha


def _check_point(pick: Point | None) -> None:
    if pick is None or (len(pick) == 2 and all(0 <= f <= 1 for f in pick)):
        return
    limit = "It is not a point in the picture."
    remedy = "Give two fractions of its width and height, such as 0.3,0.5."
    raise InputError("pick", ",".join(f"{f:g}" for f in pick), limit, remedy)


def _choose_method(image: Image.Image, method: str) -> str:
    if method == "auto":
        return next(name for name, way in METHODS.items() if way.applies(image))
    if method not in METHODS:
        known = ", ".join(["auto", *METHODS])
        raise InputError(
            "foreground", method, "This method is not known.", f"Choose one of {known}."
        )
    return method


def _flatten(image: Image.Image, method: str) -> Image.Image:
    if method == "alpha":
        return image
    return Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)


def _apply_mask(image: Image.Image, mask: Image.Image, method: str) -> Alpha:
    """Transparent pixels of the image remain transparent."""
    if method not in ("auto", "mask"):
        limit = "A mask already determines the object."
        raise InputError("foreground", method, limit, "Give either a mask or a point.")
    if mask.size != image.size:
        (width, height), (w, h) = original_size(image), original_size(mask)
        limit = f"Its size differs from that of the picture, {width} x {height} pixels."
        raise InputError(
            "mask", f"{w} x {h} pixels", limit, "Paint the mask on a copy of the picture."
        )
    mask = make_solid(mask)
    painted = mask.getchannel("A") if has_alpha(mask) else mask.convert("L")
    return np.minimum(np.asarray(painted), np.asarray(image.getchannel("A")))


def _check_visible(image: Image.Image) -> None:
    opaque = np.asarray(image.getchannel("A")) > 127
    if shows_object(opaque):
        return
    limit = f"{1 - opaque.mean():.2%} of the picture is transparent, so it shows no object."
    remedy = "Save the picture again without transparency, or use another picture."
    raise InputError("image", "{} x {} pixels".format(*original_size(image)), limit, remedy)


def _check_fraction(alpha: Alpha, method: str, frames: int) -> None:
    fraction = float(np.mean(alpha > 127))
    if shows_object(alpha > 127) and fraction <= MAXIMUM:
        return
    if method == "mask":
        limit = f"{fraction:.0%} of the mask is white, which cannot be an object."
        raise InputError(
            "mask", "painted", limit, "Paint the object white and everything else black."
        )
    limit = f"No object was found in the picture by {method}."
    if fraction > MAXIMUM:
        limit = f"Nearly the whole picture ({fraction:.0%}) was selected as the object by {method}."
    if frames > 1:
        limit += f" Only the first of the picture's {frames} frames is examined."
    raise InputError("foreground", method, limit, REMEDY)


def _keep_alpha(image: Image.Image, deadline: isolated.Deadline) -> Alpha:
    if not has_alpha(image):
        limit = "The picture has no transparency from which an object could be separated."
        remedy = 'Choose "auto", or save the cut-out object as PNG.'
        raise InputError("foreground", "alpha", limit, remedy)
    return np.asarray(image.getchannel("A"))


def _grabcut(image: Image.Image, deadline: isolated.Deadline) -> Alpha:
    return isolated.run(grabcut, np.asarray(image.convert("RGB")), deadline=deadline)


METHODS: dict[str, Method] = {
    "alpha": Method(has_alpha, _keep_alpha, "the picture's own transparency"),
    **{
        name: Method(
            partial(salient.is_available, name), partial(salient.find_alpha, name), network.title
        )
        for name, network in salient.NETWORKS.items()
    },
    "u2net": Method(u2net.is_available, u2net.find_alpha, "U2-Net"),
    "u2netp": Method(lambda _: True, u2net.find_alpha_small, "the small U2-Net"),
    "grabcut": Method(lambda _: True, _grabcut, "GrabCut"),
}
"""Methods by name; "auto" chooses the first method that applies to the image."""
NETWORKS = (*salient.NETWORKS, "u2net", "u2netp")
TAKEN_WHOLE = ("alpha", "mask")
"""Methods whose mask a person made; all pieces of such a mask are kept."""
PAINTED = {"mask": "the mask", "brush": "brush strokes"}
