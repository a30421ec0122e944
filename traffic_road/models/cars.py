"""Discrete cars: each crosses the road node by node and compacts it; between passages the road relaxes.

Two layouts. An even fleet (identical cars, equal headways of a whole number of nodes) goes headway by headway in
`kernels.sweep_even`, and every sample is taken after a whole number of relaxation intervals. Any other fleet goes car by
car in the order of time in `kernels.cross_in_order`, and is sampled at the very times that were asked for.

The relaxation acts every `relax_every` mean headways. Half of one opens and closes the run and each sample (Strang), so
that the road is second order in the interval at every sample.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ..errors import SceneError, StabilityError
from ..laws import Constant, whole
from ..schemes import oscillator
from ..schemes.relaxation import LONGEST_BAND, band, relax_law, relax_transform, symbol
from . import Sample
from .kernels import aligned, cross_in_order, relax_band, sweep_even

MOST_NODES = 10**9  # 8 GB for the road alone
MOST_PASSAGES = 1e16  # a year of computing
NODES_PER_WAVE = 8  # of the shortest wave of the profile, in the default grid
PAIR_RATIO = 1.0  # a pair of runs differs by the error of the better one at order 1: the steps that wheels leave
PHASE_PER_NODE = 0.15  # omega dx / u of the quickest car, in the default grid


def numerics(scene, given: dict) -> dict:
    """nodes (road nodes in all), hold (1, 3, 5), relax_every (whole headways): given or default, checked.

    SceneError names a value that cannot be used, StabilityError a grid too coarse for the fleet.
    """
    unknown = sorted(set(given) - {"nodes", "hold", "relax_every"})
    if unknown:
        raise SceneError(f"{unknown[0]}: not a parameter of the cars model; it takes nodes, hold, relax_every")
    hold = whole("hold", given.get("hold", 3), 1, 5)
    if hold not in oscillator.HOLDS:
        raise SceneError(f"hold = {hold}: must be 1 (linear), 3 (cubic) or 5 (quintic)")
    relax_every = whole("relax_every", given.get("relax_every", 1), 1, MOST_NODES)
    count, length = scene.fleet.count, scene.road.length
    waves = scene.road.profile.highest_wave(length)
    if "nodes" in given:
        nodes = whole("nodes", given["nodes"], 1, MOST_NODES)
    else:
        quickest = float(np.max(scene.fleet.per_car("frequency") / scene.fleet.per_car("speed")))
        least = max(NODES_PER_WAVE * waves, length * quickest / PHASE_PER_NODE, 2 * waves + 1, hold + 1)
        nodes = count * 4 * int(np.ceil(min(least, 2 * MOST_NODES) / (4 * count)))
    if nodes <= hold:
        raise SceneError(f"nodes = {nodes}: hold {hold} needs at least {hold + 1}")
    passages = scene.duration * float(scene.fleet.per_car("speed").sum()) * nodes / length
    if nodes > MOST_NODES or not passages < MOST_PASSAGES:
        raise SceneError(
            f"nodes = {nodes}: with {passages:.3g} passages in the duration, must be at most {MOST_NODES:.0e} nodes and "
            f"{MOST_PASSAGES:.0e} passages; use a shorter ring or duration, or slower cars"
        )
    scene.road.profile.sample(length, nodes)  # SceneError where the grid does not resolve it
    _refuse_coarse_grid(scene, nodes, hold)
    return {"nodes": nodes, "hold": hold, "relax_every": relax_every}


def coarser(scene, chosen: dict) -> dict | None:
    """Half the nodes and, where relaxation is less often than every headway, twice the interval; None if impossible."""
    count = scene.fleet.count
    nodes = chosen["nodes"] // 2
    if chosen["nodes"] % count == 0 and chosen["nodes"] > count:
        nodes = count * (chosen["nodes"] // count // 2)  # an even fleet stays one
    relax_every = 2 * chosen["relax_every"] if chosen["relax_every"] > 1 else 1
    try:
        return numerics(scene, {**chosen, "nodes": nodes, "relax_every": relax_every})
    except (SceneError, StabilityError):
        return None


def finer(scene, chosen: dict, given: dict) -> dict:
    """Twice the nodes, unless they were given."""
    return chosen if "nodes" in given else {**chosen, "nodes": 2 * chosen["nodes"]}


def kinds(fleet) -> tuple[np.ndarray, np.ndarray]:
    """Distinct (speed, frequency, damping, mass), shape (kinds, 4), and the kind of each car, shape (count,)."""
    columns = np.stack([fleet.per_car(name) for name in ("speed", "frequency", "damping", "mass")], axis=1)
    distinct, kind_of = np.unique(columns, axis=0, return_inverse=True)
    return distinct, kind_of.reshape(-1)


def _refuse_coarse_grid(scene, nodes: int, hold: int) -> None:
    distinct, _ = kinds(scene.fleet)
    bad = np.flatnonzero(_too_coarse(scene.road.length / nodes, distinct, hold))
    if bad.size:
        speed, frequency, damping, _ = distinct[bad[0]]
        need = nodes
        while np.any(_too_coarse(scene.road.length / need, distinct, hold)):
            need *= 2
        raise StabilityError(
            f"nodes = {nodes}: omega dx/u = {scene.road.length / nodes * frequency / speed:.3g} is too coarse for hold {hold} "
            f"and a car of damping {damping:g}, speed {speed:g}, frequency {frequency:g}: its newest contact height must "
            f"weigh less than 1, and it must press all the grid's short waves down; use nodes >= {need}"
        )


def _too_coarse(dx, distinct, hold):
    """Where the passage is no scalar equation with one root, b >= 1, or the cars would pull a short wave up."""
    speed, frequency, damping, _ = distinct.T
    A, B = oscillator.propagator(dx / speed, frequency, damping, hold)
    return (B[:, 0, 0] >= 1) | ~(oscillator.least_response(A, B, frequency * dx / speed) > 0)


def even_start(scene, nodes: int) -> tuple[np.ndarray, int] | None:
    """For an even fleet: the cars in order of position, and the node of the first; None for any other fleet."""
    fleet, length = scene.fleet, scene.road.length
    distinct, _ = kinds(fleet)
    if len(distinct) > 1 or nodes % fleet.count:
        return None
    position = fleet.positions(length)
    order = np.argsort(position, kind="stable")
    spacing = position[order] - np.arange(fleet.count) * scene.headway
    if np.ptp(spacing) > 1e-9 * scene.headway:
        return None
    return order, int(_node_behind(position[order[:1]], length / nodes)[0])


def _node_behind(position, dx):
    """The node at or behind a position; a position within rounding of a node is on it."""
    return np.floor(position / dx + 1e-9).astype(np.int64)


def samples(scene, times, numerics: dict) -> Iterator[Sample]:
    """Run the scene; see `models` for the contract. A car between two nodes starts from the node behind it, earlier."""
    even = even_start(scene, numerics["nodes"])
    if even is not None:
        return _even_samples(scene, times, *even, **numerics)
    return _mixed_samples(scene, times, **numerics)


def sample_times(scene, times, numerics: dict) -> np.ndarray:
    """The times at which samples will be taken: for an even fleet whole relaxation intervals, without repeats."""
    if even_start(scene, numerics["nodes"]) is None:
        return np.asarray(times, dtype=float)
    interval = scene.headway_time * numerics["relax_every"]
    whole = np.rint(np.asarray(times) / interval)
    whole[-1] = max(whole[-1], 1)  # the shortest run there is
    return np.unique(whole) * interval


def _start(scene, road, node, kind_of, distinct, hold):
    """Z, P (cars,) and the contact heights behind each car (cars, hold), newest first, at the start."""
    length, nodes = scene.road.length, road.size
    Z, P = np.empty(node.size), np.empty(node.size)
    sink = float(scene.road.softness(np.mean(road))) * float(np.mean(scene.fleet.per_car("mass")))
    for k, (speed, frequency, damping, _) in enumerate(distinct):
        mine = kind_of == k
        if scene.fleet.start == "rest":
            Z[mine], P[mine] = road[node[mine]], 0.0
        else:
            height, momentum = oscillator.settled(road, length, speed, frequency, damping, sink)
            Z[mine], P[mine] = height[node[mine]], momentum[node[mine]]
    return Z, P, road[(node[:, None] - np.arange(hold)) % nodes]


def _force(scene, contact, Z, frequency, mass):
    force = mass * (1.0 + frequency**2 * (contact - Z))
    return np.maximum(force, 0.0) if scene.lift_off else force


def _even_samples(scene, times, order, first_node, *, nodes, hold, relax_every):
    fleet, length, count = scene.fleet, scene.road.length, scene.fleet.count
    distinct, _ = kinds(fleet)
    speed, frequency, damping, mass = distinct[0]
    rows = nodes // count
    dx = length / nodes
    A, B = (c[0] for c in oscillator.propagator(dx / speed, frequency, damping, hold))
    kind, value, shape = scene.road.softness.kernel
    sweep = sweep_even(hold, kind)
    half = 0.5 * mass * scene.headway / speed
    start = scene.road.profile.sample(length, nodes)
    node = (first_node + rows * np.arange(count)) % nodes
    Z, P, past = _start(scene, start, node, np.zeros(count, dtype=int), distinct, hold)
    state = np.concatenate((Z, P, past.T[::-1].ravel()))
    road = _EvenRoad(scene, start, rows, first_node)
    back = np.argsort(order)

    def sample(headways, updates, airborne):
        Zs, last = state[:count][back], state[-count:][back]
        where = (node[back] + headways * rows) % nodes * dx
        force = _force(scene, last, Zs, frequency, mass)
        return Sample(headways * scene.headway / speed, road.heights(), Zs, force, where, updates, airborne)

    done = airborne = 0
    yield sample(0, 0, 0)
    for target in np.rint(np.asarray(times[1:]) * speed / scene.headway).astype(int):
        chunks = [relax_every] * ((target - done) // relax_every)
        if (target - done) % relax_every:
            chunks.append((target - done) % relax_every)
        pending = 0.0
        for chunk in chunks:
            road.relax(pending + chunk / 2)
            for _ in range(chunk):
                airborne += sweep(
                    road.flat, rows, road.stride, road.margin, done, state, count, A, B, half, frequency**2,
                    value, shape, scene.lift_off,
                )  # fmt: skip
                done += 1
            pending = chunk / 2
        road.relax(pending)
        yield sample(done, done * nodes, airborne)


class _EvenRoad:
    """The road of an even fleet in the layout of `kernels`, and its relaxation over a number of headways."""

    def __init__(self, scene, start, rows, first_node):
        self.law = scene.road.diffusivity
        self.length, self.rows, self.first_node = scene.road.length, rows, first_node
        self.interval = scene.headway_time
        self.nodes = start.size
        self.cars = start.size // rows
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
        self._put(np.roll(start, -first_node - 1))

    def _put(self, heights):
        table = self.flat.reshape(self.rows, self.stride)
        table[:, self.margin : self.margin + self.cars] = heights.reshape(self.cars, self.rows).T

    def _get(self):
        table = self.flat.reshape(self.rows, self.stride)
        return table[:, self.margin : self.margin + self.cars].T.ravel()

    def heights(self):
        """Heights by node, shape (nodes,)."""
        return np.roll(self._get(), self.first_node + 1)

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


def _mixed_samples(scene, times, *, nodes, hold, relax_every):
    fleet, length = scene.fleet, scene.road.length
    dx = length / nodes
    distinct, kind_of = kinds(fleet)
    speed, frequency, damping, mass = distinct.T
    A, B = oscillator.propagator(dx / speed, frequency, damping, hold)
    law = scene.road.softness.kernel
    half = 0.5 * mass * scene.headway / speed
    road = scene.road.profile.sample(length, nodes).copy()
    position = fleet.positions(length)
    behind = _node_behind(position, dx)
    Z, P, past = _start(scene, road, behind % nodes, kind_of, distinct, hold)
    node = (behind + 1) % nodes
    first_due = np.maximum(((behind + 1) * dx - position) / speed[kind_of], 0.0)
    due = first_due.copy()
    crossed = np.zeros(fleet.count, dtype=np.int64)
    heap = np.lexsort((np.arange(fleet.count), due)).astype(np.int64)  # sorted is a heap
    interval = dx / speed
    diffusivity = scene.road.diffusivity
    still = isinstance(diffusivity, Constant) and diffusivity.value == 0

    factors: dict = {}

    def relax(span):
        if still:
            return
        if not isinstance(diffusivity, Constant):
            road[:] = relax_law(road, diffusivity, span, length)
            return
        if span not in factors:
            factors[span] = symbol(diffusivity.value * span, length, nodes)
        road[:] = relax_transform(road, factors[span])

    def sample(time, updates, airborne):
        force = _force(scene, past[:, 0], Z, frequency[kind_of], mass[kind_of])
        where = (node - 1) % nodes * dx
        return Sample(time, road.copy(), Z.copy(), force, where, updates, airborne)

    updates = airborne = 0
    yield sample(0.0, 0, 0)
    for begin, end in pairwise(times):
        factors.clear()  # this stretch has its own two spans
        parts = max(1, round((end - begin) / (relax_every * scene.headway_time)))
        edges = np.linspace(begin, end, parts + 1)
        span = (end - begin) / parts
        relax(span / 2)
        for i, until in enumerate(edges[1:], start=1):
            # a crossing on the very edge belongs to this interval, whatever its rounding
            done, lost = cross_in_order(
                road, until + 1e-9 * interval.min(), heap, due, first_due, crossed, node, Z, P, past, kind_of, A, B,
                interval, half, frequency**2, law, scene.lift_off,
            )  # fmt: skip
            updates += done
            airborne += lost
            relax(span if i < parts else span / 2)
        yield sample(float(end), updates, airborne)
