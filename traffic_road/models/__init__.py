"""Models: each is a module with the same five functions, and PAIR_RATIO, found by name in `model`.

numerics(scene, given) -> dict         every parameter, defaults filled in; SceneError or StabilityError if unusable
unstable_numerics(scene, given)        only where `numerics` raises StabilityError and a run is possible all the same: for study
coarser(scene, numerics) -> dict       the same at half the resolution or so, for an error estimate by a pair; or None
finer(scene, numerics, given) -> dict  the same at twice the resolution, but for what was given; cars by less, if asked
fitted(times, numerics) -> dict        only where the times of samples change them: as they will be
sample_times(scene, times, numerics)   the times (n,) at which samples will be taken, nearest to those asked for
samples(scene, times, numerics, state) an iterator over Sample, one for each of `times` (n,) increasing from 0, and between
                                       them over Breath, wherever the run may be left; the last is always a Sample.
                                       `state`: None, or what a Breath of the same run gave, to go on from there bit for bit
PAIR_RATIO                             a run differs from its coarser one by at least this many times its own error
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from time import perf_counter
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ..errors import SceneError

MODELS = ("cars", "continuum", "linear")
PACE = 0.1  # seconds of work between one breath and the next


class Sample(NamedTuple):
    """The state at one time; `where` is the position of each car, or None where cars are a field on the road's grid."""

    time: float
    road_height: np.ndarray
    car_height: np.ndarray
    contact_force: np.ndarray
    where: np.ndarray | None
    updates: int  # road-node updates done so far
    airborne: int | None = None  # of these, passages of a car that pressed on nothing; None where cars are a field


class Breath(NamedTuple):
    """A moment at which the run can be left. It changes nothing: a consumer that does not care skips it.

    state() -> dict of arrays and numbers, all that is needed to go on; "taken" is the number of samples before it. To be
    called before the iterator is asked for more. heights() -> the road (nodes,), less a level that is kept apart.
    """

    time: float
    state: Callable[[], dict]
    heights: Callable[[], np.ndarray]


class Pace:
    """When to breathe: where the clock says so, since breaths change nothing."""

    def __init__(self):
        self.last = perf_counter()

    def due(self) -> bool:
        now = perf_counter()
        if now - self.last < PACE:
            return False
        self.last = now
        return True


def model(name: str) -> ModuleType:
    """The model called `name`, imported when it is asked for."""
    if name not in MODELS:
        raise SceneError(f"model = {name!r}: must be one of {', '.join(('auto', *MODELS))}")
    return _imported(name)


@cache
def _imported(name: str) -> ModuleType:
    return import_module(f"{__name__}.{name}")
