"""The changelog is short, and its newest release is the version that stands everywhere."""

import re
from pathlib import Path

import pytest

from phy124 import __version__

ROOT = Path(__file__).parents[1]
LONGEST = 60
"""Lines of a release."""
SECTIONS = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text("utf-8"), flags=re.M)[1:]


def test_changelog_starts_with_unreleased():
    assert SECTIONS[0].startswith("Unreleased\n")


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.split("\n")[0])
def test_release_has_at_most_sixty_lines(section):
    assert len(section.splitlines()) <= LONGEST, "shorten it: the git history has the rest"


def test_newest_release_is_the_version():
    assert re.match(r"(\S+) - \d{4}-\d\d-\d\d\n", SECTIONS[1])[1] == __version__


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("CITATION.cff", r"^version: (\S+)$"),
        ("bridge/package.xml", r"<version>(.*)</version>"),
        ("CONTRIBUTING.md", r"(?:Version |\bv)(\d+\.\d+\.\d+)"),
    ],
)
def test_version_is_the_same_everywhere(file, pattern):
    versions = re.findall(pattern, (ROOT / file).read_text("utf-8"), re.M)
    assert versions and {*versions} == {__version__}
