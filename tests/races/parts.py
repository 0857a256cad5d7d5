"""Finds the components of a vector that a kernel reads; Warp's C++ loads all four to use one.

A compiler for a GPU removes the unused loads, so they are not counted here either.
"""

import re

LOAD = re.compile(r"(\w+) = wp::load\((\w+)\);")
CONSTANT = re.compile(r"const wp::int32 (\w+) = (\d+);")
FUNCTION = re.compile(r"(?<=\n}\n)")


def by_parts(source: str) -> str:
    """Return C++ in which loads name the used components, where these are known."""
    return "".join(_function(body) for body in FUNCTION.split(source))


def _function(body: str) -> str:
    numbers = {name: int(number) for name, number in CONSTANT.findall(body)}

    def replaced(load: re.Match[str]) -> str:
        mask = _mask(load[1], body.replace(load[0], "", 1), numbers)
        return f"{load[1]} = wp::load_parts({load[2]}, {mask}u);" if mask else load[0]

    return LOAD.sub(replaced, body)


def _mask(name: str, body: str, numbers: dict[str, int]) -> int:
    """Return a bit for each used component of a variable; 0 if the variable is used in another
    way."""
    mask = 0
    rest = re.sub(rf"\n *wp::[^;()]* {name};", "", body)  # its declaration
    for part in re.findall(rf"wp::extract\({name}, (\w+)\)", rest):
        if part not in numbers:
            return 0
        mask |= 1 << numbers[part]
    rest = re.sub(rf"wp::extract\({name}, \w+\)", "", rest)
    for copy in re.findall(rf"(\w+) = wp::copy\({name}\);", rest):
        expected = _mask(copy, rest.replace(f"{copy} = wp::copy({name});", "", 1), numbers)
        if not expected:
            return 0
        mask |= expected
    rest = re.sub(rf"\w+ = wp::copy\({name}\);", "", rest)
    return 0 if re.search(rf"\b{name}\b", rest) else mask
