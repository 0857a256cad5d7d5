"""Solids that are known from all sides, by name. Each part has a distance function and a colour.

Units are arbitrary; x is towards the viewer, y to the right, z up.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from support.truths.distances import (
    Distance,
    Points,
    box,
    capsule,
    ellipsoid,
    moved,
    prism,
    rotated,
    sphere,
    torus,
    turned,
    without,
)

Paint = Callable[[Points], NDArray[np.float64]]
RED, BLUE, GREEN, YELLOW = (0.8, 0.2, 0.15), (0.2, 0.35, 0.75), (0.25, 0.6, 0.25), (0.9, 0.75, 0.2)
BROWN, WHITE, DARK, PINK = (0.5, 0.33, 0.2), (0.9, 0.9, 0.88), (0.12, 0.1, 0.1), (0.9, 0.6, 0.65)


class Part(NamedTuple):
    """A piece of one colour or texture."""

    distance: Distance
    paint: Paint


def part(distance: Distance, colour: tuple[float, float, float] | Paint) -> Part:
    """Return a piece whose colour is constant or a function of the position."""
    if callable(colour):
        return Part(distance, colour)
    return Part(distance, lambda p: np.broadcast_to(np.asarray(colour), p.shape))


def striped(first: tuple, other: tuple, along: int, width: float) -> Paint:
    """Stripes across an axis."""
    return lambda p: np.where((np.floor(p[:, along] / width) % 2 > 0)[:, None], first, other)


def checked(first: tuple, other: tuple, width: float) -> Paint:
    """A chessboard in space."""
    return lambda p: np.where(
        (np.floor(p / width + 1e-3).sum(axis=1) % 2 > 0)[:, None], first, other
    )


def mottled(colour: tuple, depth: float = 0.25, size: float = 0.12) -> Paint:
    """Return a smoothly varying colour, like that of fur or stone."""

    def paint(p: Points) -> NDArray[np.float64]:
        waves = sum(
            np.sin(p @ np.array(k) / size + i)
            for i, k in enumerate([(1.0, 0.7, 0.3), (-0.4, 1.1, 0.8), (0.6, -0.5, 1.3)])
        )
        return np.clip(np.asarray(colour) * (1 + depth * waves[:, None] / 3), 0, 1)

    return paint


def legs(x: float, y: float, top: float, radius: float, paint: Paint | tuple) -> list[Part]:
    """Four straight legs down to z = 0."""
    return [
        part(capsule((a * x, b * y, radius), (a * x, b * y, top), radius), paint)
        for a in (-1, 1)
        for b in (-1, 1)
    ]


def _figure() -> list[Part]:
    pairs = [((0, 0.14, 0.1), (0, 0.12, 0.5), 0.09), ((0, 0.2, 0.85), (0, 0.42, 0.55), 0.06)]
    limbs = [
        (tuple(np.multiply(v, (1, s, 1)) for v in ends), r) for *ends, r in pairs for s in (-1, 1)
    ]
    return [
        *(part(capsule(a, b, r), BLUE) for (a, b), r in limbs),
        part(capsule((0, 0, 0.55), (0, 0, 0.82), 0.17), striped(RED, WHITE, 2, 0.08)),
        part(sphere(0.16, (0, 0, 1.14)), (0.85, 0.65, 0.5)),
        *(part(sphere(0.03, (0.15, y, 1.17)), DARK) for y in (-0.06, 0.06)),
    ]


def _bear() -> list[Part]:
    fur = mottled(BROWN)
    return [
        part(ellipsoid((0.27, 0.3, 0.36), (0, 0, 0.4)), fur),
        part(sphere(0.24, (0, 0, 0.92)), fur),
        *(part(sphere(0.09, (0, y, 1.12)), fur) for y in (-0.18, 0.18)),
        *(part(capsule((0.0, 0.2 * s, 0.6), (0.1, 0.42 * s, 0.42), 0.09), fur) for s in (-1, 1)),
        *(part(capsule((0.0, 0.17 * s, 0.15), (0.22, 0.24 * s, 0.1), 0.12), fur) for s in (-1, 1)),
        part(sphere(0.1, (0.2, 0, 0.87)), (0.8, 0.65, 0.45)),
        part(sphere(0.035, (0.3, 0, 0.9)), DARK),
        *(part(sphere(0.03, (0.21, y, 0.99)), DARK) for y in (-0.09, 0.09)),
    ]


def _dog() -> list[Part]:
    fur = mottled((0.75, 0.55, 0.3))
    return [
        part(capsule((0, -0.35, 0.55), (0, 0.3, 0.55), 0.2), fur),
        *legs(0.11, 0.32, 0.5, 0.075, fur),
        part(capsule((0, 0.32, 0.62), (0, 0.45, 0.85), 0.12), fur),
        part(ellipsoid((0.16, 0.2, 0.16), (0, 0.5, 0.92)), fur),
        part(capsule((0, 0.6, 0.88), (0, 0.76, 0.86), 0.075), fur),
        part(sphere(0.04, (0, 0.83, 0.88)), DARK),
        *(part(ellipsoid((0.04, 0.08, 0.13), (s * 0.15, 0.45, 0.9)), BROWN) for s in (-1, 1)),
        *(part(sphere(0.025, (s * 0.12, 0.6, 0.97)), DARK) for s in (-1, 1)),
        part(capsule((0, -0.5, 0.65), (0, -0.7, 0.9), 0.05), fur),
    ]


def _duck() -> list[Part]:
    return [
        part(ellipsoid((0.3, 0.45, 0.28), (0, 0, 0.28)), mottled(YELLOW, 0.1)),
        part(sphere(0.22, (0, 0.28, 0.68)), YELLOW),
        part(ellipsoid((0.11, 0.15, 0.06), (0, 0.53, 0.65)), (0.95, 0.5, 0.1)),
        part(capsule((0, -0.35, 0.35), (0, -0.52, 0.5), 0.09), YELLOW),
        *(part(sphere(0.035, (s * 0.17, 0.4, 0.74)), DARK) for s in (-1, 1)),
        *(
            part(ellipsoid((0.06, 0.24, 0.13), (s * 0.29, -0.05, 0.33)), (0.85, 0.65, 0.1))
            for s in (-1, 1)
        ),
    ]


def _car() -> list[Part]:
    wheel = turned([(0.15, -0.06), (0.15, 0.06)], axis=0)
    places = [(a * 0.27, b * 0.38, 0.15) for a in (-1, 1) for b in (-1, 1)]
    return [
        part(box((0.6, 1.4, 0.28), (0, 0, 0.32), 0.06), RED),
        part(box((0.52, 0.7, 0.3), (0, -0.05, 0.55), 0.08), (0.5, 0.65, 0.75)),
        *(part(moved(wheel, place), DARK) for place in places),
    ]


def _chair(azimuth: float) -> list[Part]:
    pieces = [
        box((0.5, 0.5, 0.06), (0, 0, 0.5)),
        box((0.06, 0.5, 0.55), (-0.22, 0, 0.78)),
        *(box((0.06, 0.06, 0.5), (a * 0.21, b * 0.21, 0.25)) for a in (-1, 1) for b in (-1, 1)),
    ]
    return [part(rotated(piece, azimuth), mottled(BROWN, 0.15)) for piece in pieces]


def _mug() -> list[Part]:
    body = without(turned([(0.3, 0.0), (0.32, 0.7)]), turned([(0.25, 0.06), (0.27, 0.8)]))
    return [
        part(body, striped(BLUE, WHITE, 2, 0.14)),
        part(torus(0.2, 0.045, 0, (0, 0.36, 0.36)), BLUE),
    ]


VASE = [(0.14, 0), (0.2, 0.1), (0.3, 0.35), (0.28, 0.5), (0.14, 0.75), (0.12, 0.85), (0.2, 1.0)]
BOTTLE = [(0.2, 0), (0.21, 0.05), (0.21, 0.6), (0.17, 0.7), (0.08, 0.78), (0.07, 1.0)]
PEAR = [(0.05, 0), (0.2, 0.04), (0.32, 0.2), (0.33, 0.33), (0.24, 0.52)]
PEAR += [(0.16, 0.7), (0.1, 0.8), (0.02, 0.84)]
STAR = [
    (r * np.sin(np.pi * i / 5), r * np.cos(np.pi * i / 5)) for i, r in enumerate([0.5, 0.22] * 5)
]
BOW = [(0.0, 0.4 * np.cos(a), 0.4 * np.sin(a)) for a in np.linspace(3.5, 5.7, 8)]
BALL = sphere(0.5)


def _objects() -> dict[str, list[Part]]:
    stem = part(capsule((0, 0, 0.8), (0, 0.04, 0.95), 0.025), BROWN)
    return {
        "ball": [part(BALL, mottled(RED))],
        "striped ball": [part(BALL, striped(BLUE, WHITE, 2, 0.2))],
        "egg": [part(ellipsoid((0.35, 0.35, 0.5)), mottled(WHITE, 0.1))],
        "lying egg": [part(ellipsoid((0.3, 0.5, 0.3)), mottled(PINK))],
        "cylinder": [part(turned([(0.25, -0.5), (0.25, 0.5)]), checked(RED, WHITE, 0.125))],
        "drum": [part(turned([(0.5, -0.25), (0.5, 0.25)]), striped(YELLOW, RED, 1, 0.2))],
        "log": [part(turned([(0.2, -0.5), (0.2, 0.5)], axis=1), mottled(BROWN))],
        "cone": [part(turned([(0.35, 0), (0.01, 1)]), striped(GREEN, YELLOW, 2, 0.2))],
        "cube": [part(box((0.9, 0.9, 0.9)), checked(BLUE, YELLOW, 0.3))],
        "turned cube": [part(rotated(box((0.8, 0.8, 0.8)), 35), checked(RED, WHITE, 0.4))],
        "book": [part(box((0.18, 0.7, 1.0)), mottled(RED, 0.15))],
        "standing ring": [part(torus(0.35, 0.13, 0), mottled(PINK))],
        "lying ring": [part(torus(0.35, 0.14, 2), striped(BROWN, PINK, 1, 0.15))],
        "banana": [part(capsule(a, b, 0.1), YELLOW) for a, b in pairwise(BOW)],
        "figure": _figure(),
        "bear": _bear(),
        "dog": _dog(),
        "duck": _duck(),
        "snowman": [
            part(sphere(0.32, (0, 0, 0.3)), WHITE),
            part(sphere(0.23, (0, 0, 0.76)), WHITE),
            part(sphere(0.16, (0, 0, 1.1)), WHITE),
            part(capsule((0.14, 0, 1.1), (0.32, 0, 1.08), 0.03), (0.95, 0.5, 0.1)),
            *(part(sphere(0.025, (0.14, y, 1.15)), DARK) for y in (-0.06, 0.06)),
            *(part(sphere(0.03, (0.23, 0, z)), DARK) for z in (0.7, 0.82)),
        ],
        "fish": [
            part(ellipsoid((0.16, 0.45, 0.25)), striped((0.95, 0.5, 0.1), WHITE, 1, 0.15)),
            part(ellipsoid((0.03, 0.16, 0.2), (0, -0.5, 0)), (0.95, 0.5, 0.1)),
            *(part(sphere(0.04, (s * 0.12, 0.3, 0.06)), DARK) for s in (-1, 1)),
        ],
        "car": _car(),
        "chair": _chair(0),
        "turned chair": _chair(35),
        "table": [
            part(box((0.6, 1.0, 0.07), (0, 0, 0.6)), mottled(BROWN)),
            *legs(0.24, 0.43, 0.6, 0.04, BROWN),
        ],
        "house": [
            part(box((0.6, 0.8, 0.5), (0, 0, 0.25)), mottled(WHITE, 0.1)),
            part(prism([(-0.46, 0.5), (0.46, 0.5), (0, 0.9)], 0.7), RED),
            part(box((0.04, 0.16, 0.3), (0.3, 0, 0.15)), BROWN),
        ],
        "mug": _mug(),
        "vase": [part(turned(VASE), striped(BLUE, WHITE, 2, 0.12))],
        "bottle": [part(turned(BOTTLE), mottled(GREEN))],
        "pear": [part(turned(PEAR), mottled((0.7, 0.75, 0.25))), stem],
        "mushroom": [
            part(capsule((0, 0, 0.08), (0, 0, 0.5), 0.14), WHITE),
            part(without(ellipsoid((0.5, 0.5, 0.4), (0, 0, 0.5)), box((2, 2, 1), (0, 0, 0))), RED),
        ],
        "cupcake": [
            part(turned([(0.26, 0), (0.36, 0.4)]), striped(BROWN, YELLOW, 1, 0.1)),
            part(ellipsoid((0.42, 0.42, 0.3), (0, 0, 0.48)), PINK),
            part(sphere(0.09, (0, 0, 0.82)), RED),
        ],
        "potted plant": [
            part(turned([(0.16, 0), (0.24, 0.35)]), (0.7, 0.4, 0.25)),
            *(
                part(capsule((0, 0, 0.3), (0.3 * np.cos(a), 0.3 * np.sin(a), 0.9), 0.06), GREEN)
                for a in np.arange(5) * 2 * np.pi / 5
            ),
        ],
        "tree": [
            part(capsule((0, 0, 0.07), (0, 0, 0.5), 0.07), BROWN),
            part(sphere(0.3, (0, 0, 0.75)), mottled(GREEN, 0.4, 0.06)),
            part(sphere(0.2, (0.05, 0.22, 0.6)), mottled(GREEN, 0.4, 0.06)),
            part(sphere(0.2, (-0.1, -0.22, 0.62)), mottled(GREEN, 0.4, 0.06)),
        ],
        "fir": [
            part(turned([(0.07, 0), (0.07, 0.3)]), BROWN),
            *(
                part(turned([(0.4 - 0.1 * i, 0.2 + 0.25 * i), (0.01, 0.6 + 0.25 * i)]), GREEN)
                for i in range(3)
            ),
        ],
        "lamp": [
            part(turned([(0.22, 0), (0.2, 0.05), (0.03, 0.07), (0.03, 0.6)]), DARK),
            part(turned([(0.32, 0.55), (0.18, 0.95)]), YELLOW),
        ],
        "star": [part(prism(STAR, 0.18), YELLOW)],
        "hammer": [
            part(capsule((0, 0, 0), (0, 0, 0.85), 0.05), BROWN),
            part(moved(turned([(0.1, -0.3), (0.1, 0.2)], axis=1), (0, 0, 0.85)), (0.5, 0.5, 0.55)),
        ],
        "plane": [
            part(ellipsoid((0.12, 0.6, 0.12)), WHITE),
            part(box((1.2, 0.2, 0.04), (0, 0.05, 0), 0.02), BLUE),
            part(box((0.4, 0.12, 0.03), (0, -0.5, 0.02), 0.01), BLUE),
            part(box((0.03, 0.14, 0.22), (0, -0.5, 0.12), 0.01), RED),
        ],
    }


OBJECTS = _objects()

LEAF = [(0.2 * np.sin(a) * (1 + 0.3 * np.cos(a)), 0.45 * np.cos(a)) for a in np.arange(24) * 0.2618]
SHIRT = [(0.25, -0.45), (0.25, 0.15), (0.4, 0.02), (0.52, 0.15), (0.3, 0.42), (0.12, 0.45)]
SHIRT += [(0.0, 0.38), *((-y, z) for y, z in reversed(SHIRT))]


def _key() -> list[Part]:
    bow = without(
        turned([(0.2, -0.04), (0.2, 0.04)], axis=0), turned([(0.07, -1), (0.07, 1)], axis=0)
    )
    metal = mottled(YELLOW, 0.2, 0.03)
    sides = ((0.08, 0.1, 0.7), (0, 0, -0.5)), ((0.08, 0.14, 0.07), (0, 0.08, -0.8))
    teeth = ((0.08, 0.14, 0.07), (0, 0.08, -0.65))
    return [part(bow, metal), *(part(box(*at), metal) for at in (*sides, teeth))]


FLAT = {
    "coin": [
        part(turned([(0.5, -0.04), (0.5, 0.04)], axis=0), mottled(YELLOW, 0.2, 0.03)),
        part(torus(0.46, 0.05, 0), YELLOW),
        part(box((0.1, 0.3, 0.3)), mottled(BROWN, 0.2, 0.03)),
    ],
    "key": _key(),
    "leaf": [
        part(prism(LEAF, 0.07), mottled(GREEN, 0.2, 0.03)),
        part(capsule((0, 0, -0.6), (0, 0, 0.3), 0.04), mottled(GREEN, 0.2, 0.03)),
    ],
    "shirt": [
        part(prism(SHIRT, 0.1), mottled(BLUE, 0.2, 0.03)),
        part(box((0.11, 0.5, 0.1), (0, 0, -0.1)), WHITE),
    ],
}
"""Objects that are flat, and whose outlines are no polygons of few corners."""
