"""Models: each is a module with the same five functions, and PAIR_RATIO, found by name in `model`.

numerics(scene, given) -> dict         every parameter, defaults filled in; SceneError or StabilityError if unusable
coarser(scene, numerics) -> dict       the same at half the resolution, for an error estimate by a pair of runs; or None
finer(scene, numerics, given) -> dict  the same at twice the resolution, but for what was given
sample_times(scene, times, numerics)   the times (n,) at which samples will be taken, nearest to those asked for
samples(scene, times, numerics)        an iterator over Sample, the first at the start; `times` (n,) increasing from 0
PAIR_RATIO                             a run differs from its coarser one by at least this many times its own error
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ..errors import SceneError

MODELS = ("cars", "continuum")


class Sample(NamedTuple):
    """The state at one time; `where` is the position of each car, or None where cars are a field on the road's grid."""

    time: float
    road_height: np.ndarray
    car_height: np.ndarray
    contact_force: np.ndarray
    where: np.ndarray | None
    updates: int  # road-node updates done so far
    airborne: int | None = None  # of these, passages of a car that pressed on nothing; None where cars are a field


def model(name: str) -> ModuleType:
    """The model called `name`, imported when it is asked for."""
    if name not in MODELS:
        raise SceneError(f"model = {name!r}: must be one of {', '.join(('auto', *MODELS))}")
    return import_module(f"{__name__}.{name}")
