"""The run of any fleet: car by car in the order of time, in `mixed_kernels`."""

from __future__ import annotations

import numpy as np

from ..laws import Constant
from ..schemes import oscillator
from ..schemes.relaxation import relax_law, relax_transform, symbol
from . import Breath, Pace, Sample
from .cars_state import force, kinds, level_of, node_behind, sink_rate, start
from .mixed_kernels import cross_in_order


def mixed_samples(scene, times, left=None, *, nodes, hold, relax_every):
    """The samples of any fleet; `left` is the state of a Breath to go on from."""
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

    arrays = {"road": road, "Z": Z, "P": P, "past": past, "node": node, "due": due, "crossed": crossed, "heap": heap}

    def sample(time):
        pressed = force(scene, past[:, 0], Z, frequency[kind_of], mass[kind_of])
        where = (node - 1) % nodes * dx
        return Sample(float(time), road + level, Z + level, pressed, where, updates, airborne)

    def leave():
        counts = {"taken": taken, "part": i, "updates": updates, "airborne": airborne, "level": level}
        return counts | {name: values.copy() for name, values in arrays.items()}

    taken = i = updates = airborne = 0  # i: parts of the stretch between two samples
    level = 0.0  # what has been taken off all heights
    if left is not None:
        taken, i, updates, airborne, level = (left[k] for k in ("taken", "part", "updates", "airborne", "level"))
        for name, values in arrays.items():
            values[:] = left[name]
    else:
        yield sample(0.0)
        taken = 1
    sink, pace = sink_rate(scene), Pace()
    while taken < len(times):
        begin, end = times[taken - 1], times[taken]
        factors.clear()  # this stretch has its own two spans
        parts = max(1, round((end - begin) / (relax_every * scene.headway_time)))
        span = (end - begin) / parts
        if i == 0:
            relax(span / 2)
        while i < parts:
            i += 1
            until = begin + i * span if i < parts else end
            # a crossing on the very edge belongs to this interval, whatever its rounding
            done, lost = cross_in_order(
                road, until + 1e-9 * interval.min(), heap, due, first_due, crossed, node, Z, P, past, kind_of, A, B,
                interval, half, frequency**2, law, scene.lift_off,
            )  # fmt: skip
            updates += done
            airborne += lost
            relax(span if i < parts else span / 2)
            if sink * until // 1 != sink * (until - span) // 1:
                sunk = level_of(road)
                for heights in (road, Z, past):
                    heights -= sunk
                level += sunk
            if pace.due():
                yield Breath(float(until), leave, lambda: road)
        yield sample(end)
        taken, i = taken + 1, 0
