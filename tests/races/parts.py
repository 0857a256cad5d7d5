"""Which components of a vector a kernel reads: Warp's text loads all four to look at one.

A compiler for a GPU leaves the others out, so they are not read there either.
"""

import re

LOAD = re.compile(r"(\w+) = wp::load\((\w+)\);")
CONSTANT = re.compile(r"const wp::int32 (\w+) = (\d+);")
FUNCTION = re.compile(r"(?<=\n}\n)")


def by_parts(source: str) -> str:
    """C++ in which loads name the components that are used, where these are known."""
    return "".join(_function(body) for body in FUNCTION.split(source))


def _function(body: str) -> str:
    numbers = {name: int(number) for name, number in CONSTANT.findall(body)}

    def replaced(load: re.Match[str]) -> str:
        mask = _mask(load[1], body.replace(load[0], "", 1), numbers)
        return f"{load[1]} = wp::load_parts({load[2]}, {mask}u);" if mask else load[0]

    return LOAD.sub(replaced, body)


def _mask(name: str, body: str, numbers: dict[str, int]) -> int:
    """Bits of the components of a variable that are used; 0: other use is made of it."""
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
