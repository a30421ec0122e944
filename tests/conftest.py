"""Profiles of the property tests: `pytest tests/test_properties.py --hypothesis-profile=full` tries 9 x 1200 inputs.

There is a process of tests on every core, and each starts others: threads that wait by spinning would keep them off it.

A process of tests holds a million objects that stay, of numba and of the tests themselves: to look for garbage among them
takes a tenth of the time, of compiling and drawing above all. The experiments take longest, and come first: whichever
process is left with the last test is not left with it for long.
"""

import gc
import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}  # read when numpy and numba are loaded

from hypothesis import HealthCheck, settings

COMMON = {"deadline": None, "suppress_health_check": list(HealthCheck), "database": None}
settings.register_profile("few", max_examples=40, derandomize=True, **COMMON)
settings.register_profile("full", max_examples=1200, print_blob=True, **COMMON)
settings.load_profile("few")

gc.set_threshold(100_000, 10, 10)


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.path.stem != "test_experiments")


def pytest_collection_finish():
    gc.freeze()
