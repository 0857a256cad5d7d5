"""The pages of results are short, and their tables are those of the lab."""

import re
import sys

import pytest

from support.pages import ROOT

sys.path.append(str(ROOT / "tests/benchmarks"))  # last, since a program there is called bridge
summaries = pytest.importorskip("summaries")


@pytest.mark.parametrize("page", summaries.BLOCKS)
def test_tables_of_results_are_those_of_the_lab(page):
    text = (ROOT / f"docs/results/{page}.md").read_text("utf-8")
    assert text == summaries.fill_page(page), "run `python tests/benchmarks/summaries.py`"


def test_every_page_of_results_is_generated():
    pages = {page.stem for page in (ROOT / "docs/results").glob("*.md")}
    assert pages == set(summaries.BLOCKS)


def test_times_of_the_readme_are_those_of_the_lab():
    text = (ROOT / "README.md").read_text("utf-8")
    assert text == summaries.fill_readme(), "run `python tests/benchmarks/summaries.py`"


def test_numbers_of_results_are_read_from_the_lab():
    pages = [(ROOT / f"docs/results/{page}.md").read_text("utf-8") for page in summaries.BLOCKS]
    used = {results[2] for page in pages for results in summaries.NUMBER.finditer(page)}
    assert used == set(summaries.NUMBERS)
    # A comment at the start of a line would end the paragraph.
    assert not any(re.search(r"^ *<!-- =", page, re.M) for page in pages)
