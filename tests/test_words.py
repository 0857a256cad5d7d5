"""Names and prose use the words of docs/reference/glossary.md, apart from those in words.json.

A room is a folder right under a package, or a part of the docs. words.json says how many banned
words each still has, no more and no fewer; `python tests/test_words.py` counts again.
"""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("words.json")
ALLOWED: dict[str, int] = json.loads(TABLE.read_text("utf-8"))
NAMES = {"told", "given", "found", "one", "own"}
"""Names that say nothing about the thing."""
PARTICIPLES = re.compile(
    r"_*(said|told|given|found|meant|kept|held|made|taken|shown|drawn|known|thrown|spent|begun|gone"
    r"|cut|(?!(embed|exceed|feed|need|proceed|seed|shed|speed)$)[a-z]+ed)"
)
"""Names of functions that read like values. Properties are values, so they may have them."""
SUSPECT = re.compile(
    rf"\b_*({'|'.join(sorted(NAMES))})_*(\s*[^\w\s'\"`.;]|\s+in\b)|\bdef\s+{PARTICIPLES.pattern}\b"
)
"""Code without any such text has no bad name."""
PUBLIC = {"named", "replaced"}
"""Methods of `phy124.Scene` that users call by these names."""
FILLERS = re.compile(
    r"\b(anew|beside|hence|nobody|so many|so much|not so|astray|crumbs?|ways up"
    r"|(is|are|was|were|be|been) told|as (it|they) (was|were)|what flows|what there is"
    r"|ledger|culprit|blame|foretells?|foretold|wished|patience|greatest|pace|lanes?|ppc)\b".replace(
        " ", r'[\s"#]+'
    ),
    re.I,
)
"""Fillers, and words for which the field has others."""
CODE = re.compile(r"```.*?```|`[^`\n]*`|\"\w+\"|^## 0\..*", re.S | re.M)
"""Text that is not prose: code, strings of a single word, past versions of the changelog."""


def list_rooms() -> dict[str, list[Path]]:
    """Files of each room."""
    rooms = {page: [ROOT / page] for page in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")}
    for folder in ("phy124", "demo", "bridge", "docs"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".md", ".ipynb") and not {"api", "generated"} & {*path.parts}:
                room = "/".join(path.relative_to(ROOT).parts[:-1][:2])
                rooms.setdefault(room, []).append(path)
    return rooms


def find_names(code: str) -> Iterator[tuple[int, str]]:
    """Line and name of each badly named function, parameter and variable."""
    if not SUSPECT.search(code):  # parsing takes much longer
        return
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.FunctionDef(name=name, decorator_list=decorators):
                texts = list(map(ast.unparse, decorators))
                is_property = any("property" in t or t == f"{name}.setter" for t in texts)
                banned = PARTICIPLES.fullmatch(name) or name.lstrip("_") in NAMES
                if banned and not is_property and name not in PUBLIC:
                    yield node.lineno, f"{name}()"
            case (
                ast.arg(arg=name)
                | ast.Name(id=name, ctx=ast.Store())
                | ast.Attribute(attr=name, ctx=ast.Store())
            ) if name.lstrip("_") in NAMES:
                yield node.lineno, name


def find_fillers(text: str) -> Iterator[tuple[int, str]]:
    """Line and filler of a page, or of a module's docstrings, comments and messages."""
    prose = CODE.sub(lambda code: "\n" * code[0].count("\n"), text)
    for match in FILLERS.finditer(prose):
        yield prose.count("\n", 0, match.start()) + 1, match[0]


def find_banned(room: str) -> list[str]:
    """All banned words of a room, with the places where they stand."""
    words = []
    for path in ROOMS.get(room, []):
        text = path.read_text("utf-8")
        names = find_names(text) if path.suffix == ".py" else []
        for line, word in sorted([*names, *find_fillers(text)]):
            words.append(f"{path.relative_to(ROOT)}:{line}: {word}")
    return words


ROOMS = list_rooms()
TESTS = sorted(path.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("*.py"))


@pytest.mark.parametrize("room", sorted({*ROOMS, *ALLOWED}))
def test_room_has_its_number_of_banned_words(room):
    words, allowed = find_banned(room), ALLOWED.get(room, 0)
    assert len(words) <= allowed, "\n".join(["See docs/reference/glossary.md:", *words])
    assert len(words) == allowed, f"Thank you. Lower {room} to {len(words)} in tests/words.json."


def test_tests_have_no_banned_names():
    """Functions of tests may be participles: `moved(gaussians)`."""
    words = [
        f"tests/{path}:{line}: {name}"
        for path in TESTS
        for line, name in find_names((ROOT / "tests" / path).read_text("utf-8"))
        if name.strip("_()") in NAMES
    ]
    assert not words, "\n".join(["See docs/reference/glossary.md:", *words])


@pytest.mark.parametrize(
    "code",
    [
        "def told(): pass",
        "def _own(): pass",
        "def _moved(): pass",
        "def f(given): pass",
        "for one in x: pass",
        "self._own = (found := 1)",
    ],
)
def test_bad_names_are_found(code):
    assert [*find_names(code)]


@pytest.mark.parametrize(
    "code",
    [
        "def speed(): pass",
        "@property\ndef closed(self): pass",
        "@closed.setter\ndef closed(self, value): pass",
        "def find_one(): pass",
        "one.x = 2",
    ],
)
def test_good_names_are_allowed(code):
    assert not [*find_names(code)]


def test_fillers_are_found_outside_code():
    assert [*find_fillers("a\n\nIt is\ntold anew.")] == [(3, "is\ntold"), (4, "anew")]
    assert [*find_fillers('("there are so "\n "many of it")')]
    assert not [*find_fillers('```sh\nbeside\n```\n`hence` "anew"\n## 0.1\nanew')]


if __name__ == "__main__":
    counts = {room: len(find_banned(room)) for room in sorted(ROOMS)}
    table = {room: count for room, count in counts.items() if count}
    TABLE.write_text(json.dumps(table, indent=1) + "\n", "utf-8")
