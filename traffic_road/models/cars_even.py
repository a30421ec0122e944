"""The run of an even fleet: headway by headway in the layout of `even_kernels`."""

from __future__ import annotations

import numpy as np

from ..laws import Constant
from ..schemes import oscillator
from ..schemes.relaxation import LONGEST_BAND, band, relax_law, relax_transform, symbol
from . import Breath, Pace, Sample
from .cars_state import force, kinds, level_of, sink_rate, start
from .even_kernels import aligned, relax_band, sweep_even


def even_samples(scene, times, order, first_node, left=None, *, nodes, hold, relax_every):
    """The samples of an even fleet; `left` is the state of a Breath to go on from."""
    fleet, length, count = scene.fleet, scene.road.length, scene.fleet.count
    distinct, _ = kinds(fleet)
    speed, frequency, damping, mass = distinct[0]
    rows = nodes // count
    dx = length / nodes
    A, B = (c[0] for c in oscillator.propagator(dx / speed, frequency, damping, hold))
    kind, value, shape = scene.road.softness.kernel
    sweep = sweep_even(hold, kind)
    half = 0.5 * mass * scene.headway / speed
    height = scene.road.profile.sample(length, nodes)
    node = (first_node + rows * np.arange(count)) % nodes
    Z, P, past = start(scene, height, node, np.zeros(count, dtype=int), distinct, hold)
    state = np.concatenate((Z, P, past.T[::-1].ravel()))
    road = _EvenRoad(scene, height, rows, first_node)
    back = np.argsort(order)

    def sample():
        Zs, last = state[:count][back], state[-count:][back]
        where = (node[back] + done * rows) % nodes * dx
        pressed = force(scene, last, Zs, frequency, mass)
        time = done * scene.headway / speed
        return Sample(time, road.heights() + level, Zs + level, pressed, where, done * nodes, airborne)

    def leave():
        counts = {"taken": taken, "done": done, "airborne": airborne, "pending": pending, "level": level}
        return counts | {"road": road.heights(), "cars": state.copy()}

    taken = done = airborne = 0
    pending = level = 0.0  # headways of relaxation that are due; what has been taken off all heights
    if left is not None:
        taken, done, airborne, pending, level = (left[k] for k in ("taken", "done", "airborne", "pending", "level"))
        road.put_heights(left["road"])
        state[:] = left["cars"]
    else:
        yield sample()
        taken = 1
    sink, pace = sink_rate(scene) * scene.headway / speed, Pace()
    for target in np.rint(np.asarray(times[taken:]) * speed / scene.headway).astype(int).tolist():
        while done < target:
            chunk = min(relax_every, target - done)
            if pace.due():
                yield Breath(done * scene.headway / speed, leave, road.heights)
            road.relax(pending + chunk / 2)
            for _ in range(chunk):
                airborne += sweep(
                    road.flat, rows, road.stride, road.margin, done, state, count, A, B, half, frequency**2,
                    value, shape, scene.lift_off,
                )  # fmt: skip
                done += 1
            pending = chunk / 2
            if sink * done // 1 != sink * (done - chunk) // 1:
                sunk = level_of(road.heights())
                road.flat -= sunk
                state[:count] -= sunk  # Z, and below the contact heights; P does not know the level
                state[2 * count :] -= sunk
                level += sunk
        road.relax(pending)
        pending = 0.0
        yield sample()
        taken += 1


class _EvenRoad:
    """The road of an even fleet in the layout of `even_kernels`, and its relaxation over a number of headways."""

    def __init__(self, scene, height, rows, first_node):
        self.law = scene.road.diffusivity
        self.length, self.rows, self.first_node = scene.road.length, rows, first_node
        self.interval = scene.headway_time
        self.nodes = height.size
        self.cars = height.size // rows
        self.still = isinstance(self.law, Constant) and self.law.value == 0
        self.weights: dict = {}  # headways -> band, or None where only a transform will do
        self.margin = 0
        if isinstance(self.law, Constant) and not self.still:
            self.margin = -(-LONGEST_BAND // rows)
        self.margin += -self.margin % 8  # rows start at cache lines
        self.stride = self.cars + 2 * self.margin
        self.stride += -self.stride % 8
        self.flat = aligned(rows * self.stride)
        self.other = aligned(rows * self.stride)
        self.put_heights(height)

    def _put(self, heights):
        table = self.flat.reshape(self.rows, self.stride)
        table[:, self.margin : self.margin + self.cars] = heights.reshape(self.cars, self.rows).T

    def _get(self):
        table = self.flat.reshape(self.rows, self.stride)
        return table[:, self.margin : self.margin + self.cars].T.ravel()

    def heights(self):
        """Heights by node, shape (nodes,)."""
        return np.roll(self._get(), self.first_node + 1)

    def put_heights(self, heights):
        self._put(np.roll(heights, -self.first_node - 1))

    def relax(self, headways: float) -> None:
        if self.still or headways == 0:
            return
        interval = headways * self.interval
        if not isinstance(self.law, Constant):
            self._put(relax_law(self._get(), self.law, interval, self.length))
            return
        if headways not in self.weights:
            weights = band(self.law.value * interval, self.length, self.nodes)
            if weights is not None:
                weights = np.concatenate((weights, np.zeros(-(weights.size - 1) % 4)))
            factor = symbol(self.law.value * interval, self.length, self.nodes) if weights is None else None
            self.weights[headways] = weights, factor
        weights, factor = self.weights[headways]
        if weights is None:
            self._put(relax_transform(self._get(), factor))
        else:
            relax_band(self.flat, self.other, self.rows, self.stride, self.margin, self.cars, weights)
            self.flat, self.other = self.other, self.flat
