"""The error that a model and its grid will make, as `predict` tells it, where no theory holds: by coarse runs.

Two or three coarse runs of cars tell the order and the constant of the grid's error and, extrapolated, the road itself, with
which coarse runs of the continuum are compared.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from . import costs
from .errors import SceneError, StabilityError
from .health import RUNAWAY
from .models import cars, continuum, linear
from .models.cars_state import evenly_spaced
from .models.continuum_state import Kinds
from .outlook import piece, whole_headways
from .predict import ENOUGH, KNOWN, Predicted, order, relative

CAUTION = 0.7  # of a predicted difference of two runs: the less it is, the larger the error that it tells
ANSWER = 1.0  # omega dx/u
MOST_LEVELS, MOST_NODES = 6, 20_000  # of coarse runs of an uneven fleet
LEAST_CONTINUUM = 16  # nodes, below which nothing is gained


class ByRuns:
    """Errors by coarse runs: two of cars, one on twice the nodes, a third where the tolerance asks for it; and of others."""

    def __init__(self, scene, tolerance: float, hold: int = 5, purse: costs.Purse | None = None):
        self.scene, self.tolerance, self.hold = scene, tolerance, hold
        self.purse = purse or costs.Purse(np.inf)
        self.piece = piece(scene)
        self.even = linear.is_even(scene)
        self.waves = scene.road.profile.highest_wave(scene.road.length) + 1
        # the very moment that the run will end at: errors of another one, a headway off, are others, half as large or twice
        even = evenly_spaced(scene, scene.fleet.count) is not None
        self.end = whole_headways(scene) * scene.headway_time if even else scene.duration
        self._runs: dict = {}

    @property
    def words(self) -> str:
        part = "" if self.piece is self.scene else f" of {self.piece.fleet.count} of the {self.scene.fleet.count} cars"
        if "_levels" not in self.__dict__:
            return "no run: coarse ones of cars would have told"
        return f"{len(self._levels[0])} coarse runs of cars{part}: no theory holds for all of the scene"

    @property
    def runs_away(self) -> bool:
        """Whether one of the runs of cars has come to where `simulate` ends it."""
        return not all(np.ptp(road) < RUNAWAY for road in self._runs.values())

    def _of_piece(self, nodes: int) -> int:
        return round(nodes * self.piece.road.length / self.scene.road.length)

    def _cars(self, nodes: int, relax_every: int = 1):
        """Road at the end of a run on the piece; nodes: of the piece."""
        key = nodes, relax_every
        if key not in self._runs:
            numerics = cars.numerics(self.piece, {"nodes": nodes, "hold": self.hold, "relax_every": relax_every})
            self.purse.pay(self._cost(numerics))
            self._runs[key] = self._end_of(cars, numerics)
        return self._runs[key]

    def _cost(self, numerics) -> float:
        """Predicted seconds of cars on the piece."""
        return costs.of_cars(self.piece, numerics, self.even and numerics["nodes"] % self.piece.fleet.count == 0)

    def _affords(self, nodes: int) -> bool:
        return self.purse.covers(self._cost({"nodes": nodes, "hold": self.hold, "relax_every": 1}))

    def _end_of(self, model, numerics):
        with np.errstate(all="ignore"):
            *_, last = model.samples(self.piece, np.array([0.0, self.end]), numerics)
        return last.road_height

    @cached_property
    def least(self) -> int:
        """Nodes of the coarsest usable grid of the piece: 4 a headway, or what the profile and the hold need."""
        count, length = self.piece.fleet.count, self.piece.road.length
        rows = max(4, -(-(2 * self.piece.road.profile.highest_wave(length) + 1) // count), -(-(self.hold + 1) // count))
        for _ in range(40):
            try:
                cars.numerics(self.piece, {"nodes": rows * count, "hold": self.hold})
                return rows * count
            except StabilityError:
                rows *= 2
        raise SceneError("frequency: no grid can be as fine as this fleet needs; use a lower frequency or longer road")

    @cached_property
    def _answering(self) -> int:
        """Nodes of the coarsest grid whose spacing cars answer to: what a longer relaxation smooths away is seen there."""
        nodes, quickest = self.least, Kinds.of(self.piece.fleet).quickest
        while self.piece.road.length / nodes * quickest > ANSWER:
            nodes *= 2
        return nodes

    @cached_property
    def _levels(self):
        """Nodes of the coarse grids, their errors, and the order: of what finer ones leave 1 at most.

        The steps that wheels roll down are of order 1 and last. Where coarse grids seem of a higher one, what is smooth
        still errs more there, and is gone from finer ones; with d, the last difference, no more than d is left of both.
        """
        nodes = [self.least, 2 * self.least]
        first = relative(self._cars(nodes[1]), self._cars(nodes[0]))
        # even at order 1 the better one is as good as that; nor is more told where a third costs more than it may
        if first <= ENOUGH * self.tolerance or not self._affords(2 * nodes[-1]):
            return nodes, [2 * first, first], 1.0
        nodes.append(2 * nodes[-1])
        differences = [first, relative(self._cars(nodes[2]), self._cars(nodes[1]))]
        # an uneven fleet errs by where its wheels stand between nodes, in no regular way: come nearer to the tolerance
        while not self.even and self._too_far(nodes, differences[-1]):
            nodes.append(2 * nodes[-1])
            differences.append(relative(self._cars(nodes[-1]), self._cars(nodes[-2])))
        rate = order(differences, 0.5, 1.0)
        left = differences[-1] / (2**rate - 1)
        errors = [left + sum(differences[n:]) for n in range(len(nodes))]
        return nodes, errors, rate

    def _too_far(self, nodes, difference) -> bool:
        """Whether the tolerance asks for more than 4 times these nodes, as many as two more runs would not tire."""
        return (
            difference > 4 * self.tolerance
            and len(nodes) < MOST_LEVELS
            and nodes[-1] < MOST_NODES
            and difference < 1
            and self._affords(2 * nodes[-1])
        )

    def _grid(self, nodes: float) -> float:
        levels, errors, rate = self._levels
        near = max((n for n in levels if n <= nodes), default=levels[0])
        return errors[levels.index(near)] * (near / nodes) ** rate

    def cars(self, numerics: dict) -> Predicted:
        """Error of cars, and by how many times it they will differ from a run at half the resolution."""
        nodes, every = self._of_piece(numerics["nodes"]), numerics["relax_every"]
        error = self._grid(nodes)
        differs = self._grid(nodes / 2) - error if nodes >= 2 * self.least else error
        if every > 1:
            coarse = self._answering
            relaxed = relative(self._cars(coarse), self._cars(coarse, every))
            # order 2 would make it 3 times that; the steps at the wheels, smoothed the later, make it no more than that
            further = relative(
                self._cars(coarse, every), self._cars(coarse, min(2 * every, whole_headways(self.scene)))
            )
            error, differs = error + relaxed, differs + min(further, 3 * relaxed)
        if self.piece is self.scene and nodes < self._levels[0][-1]:  # finer runs have told already
            return Predicted(error, 0.0, KNOWN)
        return Predicted(error, 0.0, CAUTION * differs / error if error > 0 else None)

    @cached_property
    def _truth(self) -> tuple:
        """The finest road, for an even fleet with the error that is told taken off, which leaves a third; and its error."""
        nodes, errors, rate = self._levels
        coarse, fine = self._cars(nodes[-2]), self._cars(nodes[-1])
        if not (self.even and np.all(np.isfinite(fine))):
            return fine, errors[-1]
        wave = np.fft.rfft(fine, norm="forward")
        gain = np.fft.rfft(fine[::2] - coarse, norm="forward") / (2**rate - 1)
        wave[: gain.size - 1] += gain[:-1]
        return np.fft.irfft(wave, n=fine.size, norm="forward"), errors[-1] / 3

    def other(self, name: str, numerics: dict) -> float:
        """Error of another model with these numerics."""
        module = {"continuum": continuum, "linear": linear}[name]
        numerics = module.numerics(self.piece, numerics | {"nodes": self._of_piece(numerics["nodes"])})
        truth, left = self._truth
        if name == "linear":
            cost = costs.of_linear(self.piece, numerics, self.waves, False)
        else:
            cost = costs.of_continuum(self.piece, numerics, False)
        self.purse.pay(cost)
        return relative(truth, self._end_of(module, numerics)) + left

    @cached_property
    def model_error(self) -> float:
        """Error of the continuum however fine: of one on its usual grid."""
        return self.other("continuum", continuum.numerics(self.scene, {}))

    @cached_property
    def least_continuum(self) -> int:
        """Nodes of the continuum's coarsest usable grid of the scene, as many on each of its pieces."""
        parts = round(self.scene.road.length / self.piece.road.length)
        waves = self.piece.road.profile.highest_wave(self.piece.road.length)
        return parts * max(2 * waves + 2, -(-LEAST_CONTINUUM // parts))

    def continuum(self, numerics: dict) -> Predicted:
        error = self.other("continuum", numerics)
        own = min(error, self.model_error) if error > ENOUGH * self.tolerance else error
        if self.piece is self.scene:  # this is the error of the very run: a pair would tell less
            return Predicted(error, own, KNOWN)
        if numerics["nodes"] < continuum.numerics(self.scene, {})["nodes"]:
            return Predicted(error, error)  # half of so few nodes cannot be run
        return Predicted(error, own)
