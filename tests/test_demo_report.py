"""The sentences of a report on the page."""

import pytest

from demo.report import describe_finer, summarise
from phy124.accuracy import Stop
from phy124.accuracy.promises import Promise, promise_own
from phy124.scene import Scene


def test_a_finer_run_states_no_error_of_other_objects():
    finer = Scene.named("drop")
    similar = Promise(0.022, "Fitted to 9 measured objects.", seconds=0.96)
    stop = Stop.of(finer, 12.3, similar)
    text = describe_finer(stop, similar)
    assert text.startswith("about 12 s, off by at most 2.2 % (")
    assert text.endswith("in the first 0.96 s")
    estimated = promise_own({"about": 0.019, "at_most": 0.054, "until": 1.2, "cells": 16})
    assert describe_finer(stop, estimated) == "about 12 s"
    assert "2.2 %" in describe_finer(
        Stop.of(finer, 12.3, Promise(0.022, "", about=0.01)), estimated
    )


@pytest.mark.parametrize(
    ("volumes", "text"),
    [
        ((1, 0.98), "No part of the object was noticeably compressed."),
        ((1, 0.9), "Parts of the object were compressed."),
        ((1, 0.03), "Parts of the object were strongly compressed."),
        ((1, 0.26), "Parts of the object were strongly compressed."),
    ],
)
def test_compression_is_described_without_a_number(volumes, text):
    report = {"seconds": 3.0, "motion": {"min_J": volumes}}
    assert summarise(report, Promise(None, ""))[-1] == {"text": text}
