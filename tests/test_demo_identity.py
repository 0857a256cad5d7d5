"""Whose request it is: only a name we could have given counts."""

from types import SimpleNamespace

import pytest

from demo.guard import COOKIE, NAME, cookie_of, make_name, visitor_of


def request(name=None, session=None):
    cookies = {} if name is None else {COOKIE: name}
    return SimpleNamespace(cookies=cookies, session_hash=session)


def test_names_are_long_and_never_the_same():
    names = {make_name() for _ in range(100)}
    assert len(names) == 100
    assert all(NAME.fullmatch(name) for name in names)


def test_a_cookie_comes_before_the_session():
    name = make_name()
    assert visitor_of(request(name, "abc")) == cookie_of(request(name)) == f"cookie {name}"
    assert visitor_of(request(session="abc")) == "session abc"


@pytest.mark.parametrize("name", ["", "short", "../" * 10 + "..", "x" * 33, "x" * 31 + "\n", 5])
def test_names_that_are_not_ours_are_none(name):
    assert cookie_of(request(name)) is None


def test_programs_without_cookies_are_separate_visitors():
    assert visitor_of(request()) != visitor_of(request())
    assert cookie_of(None) is None
