"""Finds the walls that a change of the scene keeps."""

from collections import defaultdict
from collections.abc import Hashable, Sequence


def find_equal(before: Sequence[Hashable], after: Sequence[Hashable]) -> list[tuple[int, int]]:
    """Return the indices of equal keys in two lists; repeated keys are matched in order."""
    places = defaultdict(list)
    for place, key in enumerate(before):
        places[key].append(place)
    return [(places[key].pop(0), place) for place, key in enumerate(after) if places[key]]
