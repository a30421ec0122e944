"""The run of any fleet: car by car in the order of time, in `mixed_kernels`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..laws import Constant
from ..schemes import oscillator
from ..schemes.relaxation import relax_law, relax_transform, symbol
from . import Sample
from .cars_state import force, kinds, node_behind, start
from .mixed_kernels import cross_in_order


def mixed_samples(scene, times, *, nodes, hold, relax_every):
    fleet, length = scene.fleet, scene.road.length
    dx = length / nodes
    distinct, kind_of = kinds(fleet)
    speed, frequency, damping, mass = distinct.T
    A, B = oscillator.propagator(dx / speed, frequency, damping, hold)
    law = scene.road.softness.kernel
    half = 0.5 * mass * scene.headway / speed
    road = scene.road.profile.sample(length, nodes).copy()
    position = fleet.positions(length)
    behind = node_behind(position, dx)
    Z, P, past = start(scene, road, behind % nodes, kind_of, distinct, hold)
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
        pressed = force(scene, past[:, 0], Z, frequency[kind_of], mass[kind_of])
        where = (node - 1) % nodes * dx
        return Sample(time, road.copy(), Z.copy(), pressed, where, updates, airborne)

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
