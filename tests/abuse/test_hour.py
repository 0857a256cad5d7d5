"""The beginning of the hostile hour (tests/abuse/hour.py), which is run by hand."""

import pytest
from hour import SETTINGS, attack, check

from demo.folder import LOCK
from support.served import serving


@pytest.mark.slow
def test_a_hostile_minute(tmp_path):
    """Every attack, while others want a run."""
    with serving(tmp_path, **SETTINGS) as server:
        record = attack(server, seconds=60.0, visitors=10)
        check(server, record, seconds=60.0, visitors=10)
    assert [path.name for path in server.folder.iterdir()] == [LOCK]
