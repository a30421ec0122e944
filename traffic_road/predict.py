"""The error that a model and its grid will make on a scene, before it is run.

The truth that errors refer to is the discrete scene: the cars model in the limit of a fine grid, relaxed every headway.
Relative error of the corrugation: L2 over the road, mean removed, at the end.

`ByTheory`: evenly spaced identical cars, constant laws, no car in flight. Every scheme is then a matrix per wave, and its
road at the end is known without a run: errors are those of the strongest waves, their growth over the whole duration and
the ripple that passages leave. Elsewhere `predict_runs`.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from . import costs
from .estimate import corrugation_difference, steps_stay
from .models.linear_state import Blocks, MeanField
from .outlook import whole_headways

STRONGEST = 12  # waves that stand for all of a road
FINEST = 32  # rows of the finest matrices, beyond which their error is extrapolated
STEPS_STAY = 0.5  # order without diffusion: a jump stays where each lap begins, and a grid leaves out its short waves
ENOUGH = 0.35  # of the tolerance: a difference of two coarse grids below which a third is not needed
HARDLY = 1e-13  # error below which nothing can be told from rounding


def relative(road, other) -> float:
    """Difference of two roads relative to the first; inf where one has been lost, 0 where both are flat."""
    if not (np.all(np.isfinite(road)) and np.all(np.isfinite(other))):
        return np.inf
    if not np.ptp(road) > 0:
        return 0.0 if not np.ptp(other) > 0 else np.inf
    with np.errstate(all="ignore"):
        return float(np.nan_to_num(corrugation_difference(road, other), nan=np.inf))


def order(differences: list[float], least: float, most: float) -> float:
    """The order that differences of runs, each at twice the resolution of the last, tell; within limits."""
    coarse, fine = differences[0], differences[-1]
    if not (HARDLY < fine < np.inf and 0 < coarse < np.inf):
        return least
    return float(np.clip(np.log2(coarse / fine) / (len(differences) - 1), least, most))


KNOWN = np.inf


class Predicted(NamedTuple):
    """Relative error; the part of it that is the model's own; what a run differs by from one at half the resolution.

    The last in units of its error, on the safe side; None where the plan knows no better than the model's PAIR_RATIO, KNOWN
    where it has made the runs that tell the error: finer ones, or of cars beside this very run of the continuum.
    """

    error: float
    model: float = 0.0
    pair: float | None = None


class ByTheory:
    """Errors by linear theory, for an even fleet under constant laws that never leaves the road."""

    words = "linear theory: evenly spaced cars, constant laws, and no car takes off"

    def __init__(self, scene, tolerance: float):
        self.scene, self.count, self.tolerance = scene, scene.fleet.count, tolerance
        self.least = max(1, -(-(2 * scene.road.profile.highest_wave(scene.road.length) + 1) // self.count))
        field = MeanField(scene)
        end = whole_headways(scene) * scene.headway_time
        with np.errstate(all="ignore"):
            y = field.after(field.y, end)
        self.waves = field.waves.size
        self.folded = np.unique(np.minimum(field.waves % self.count, -field.waves % self.count)).size
        strength = np.abs(y[:, 0])
        strength[0] = -1.0
        self.strongest = field.waves[np.argsort(-strength)[:STRONGEST]]
        self.highest = int(field.waves[-1])
        self.mean_field = np.zeros(max(2, int(field.waves[-1]) + 1), dtype=complex)
        self.mean_field[field.waves] = y[:, 0]
        self.classes = np.unique(np.append(np.minimum(self.strongest % self.count, -self.strongest % self.count), 0))
        self.sharp = steps_stay(scene, FINEST * self.count)
        self._roads: dict = {}

    def cost(self, grids, intervals) -> float:
        """Most predicted seconds of all that is asked of it, the rows of cars on `grids` relaxed at `intervals` headways."""
        rows = [max(4, self.least)]
        while len(rows) < 2 or rows[-1] <= FINEST:
            rows.append(2 * rows[-1])
        known = {max(min(n, FINEST), self.least) for n in grids if n >= self.least}
        rows += len(intervals) * sorted(known)
        return sum(costs.of_linear(self.scene, {"nodes": n * self.count}, self.classes.size, True) for n in rows)

    def _road(self, rows, **scheme):
        """Heights at the end by a scheme, of the uniform and the strongest waves alone."""
        key = rows, *sorted(scheme.items())
        if key not in self._roads:
            with np.errstate(all="ignore"):
                blocks = Blocks(self.scene, rows, classes=self.classes, **scheme)
                intervals = whole_headways(self.scene) // scheme.get("relax_every", 1)
                self._roads[key] = blocks.road(blocks.after(blocks.y, intervals), rows * self.count)
        return self._roads[key]

    @cached_property
    def _levels(self):
        """Rows, and the roads on them, each twice as fine as the last; then their errors and order."""
        rows = [max(4, self.least), 2 * max(4, self.least)]
        roads = [self._road(r) for r in rows]
        differences = [relative(roads[1], roads[0])]
        while differences[-1] > ENOUGH * self.tolerance and rows[-1] <= FINEST:
            rows.append(2 * rows[-1])
            roads.append(self._road(rows[-1]))
            differences.append(relative(roads[-1], roads[-2]))
        rate = order(differences[-2:], 0.4, 2.0) if len(differences) > 1 else 1.0
        # what is left of the finest, by the order: all errors against what that tells of the limit. Without diffusion it is
        # e of order 1/2 by the short waves that a grid leaves out, so that the difference is the root of 2 e^2 - e^2
        left = differences[-1] / (1.0 if self.sharp else 2**rate - 1)
        return rows, roads, [sum(differences[n:]) + left for n in range(len(rows))], rate

    @property
    def truth(self):
        return self._levels[1][-1]

    @property
    def left(self) -> float:
        """Error of `truth` itself."""
        return self._levels[2][-1]

    def linear(self, rows: int) -> float:
        levels, _, errors, rate = self._levels
        if rows in levels:
            return errors[levels.index(rows)]
        near = max((r for r in levels if r < rows), default=levels[0])
        slope = min(rate, STEPS_STAY) if self.sharp and rows > levels[-1] else rate
        return errors[levels.index(near)] * (near / rows) ** slope

    def cars(self, numerics: dict) -> float:
        rows = numerics["nodes"] // self.count
        known = max(min(rows, FINEST), self.least)
        road = self._road(known, hold=numerics["hold"], relax_every=numerics["relax_every"], offset=0.0)
        if known == rows:
            return relative(self.truth, road) + self.left
        often = self._road(known, hold=5, offset=0.0)
        # the ripple, at order 1; that of the truth is not in it, or cars finer than the truth would never be better
        grid = (relative(self.truth, often) + self.left) * (known / rows) ** (STEPS_STAY if self.sharp else 1.0)
        return relative(often, road) + grid

    @cached_property
    def continuum(self) -> float:
        """Error of the mean field, whatever its grid: other growth, and no ripple."""
        return relative(self.truth, self._mean_field_road()) + self.left

    def _mean_field_road(self):
        wave = np.zeros(self.truth.size // 2 + 1, dtype=complex)
        kept = self.strongest[self.strongest < wave.size]
        wave[kept] = self.mean_field[kept]
        return np.fft.irfft(wave, n=self.truth.size, norm="forward")
