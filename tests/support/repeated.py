"""Settings of tests by random examples."""

from hypothesis import HealthCheck, settings

REPEATED = settings(derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""The same examples in each run, which may take as long as a busy machine needs."""
