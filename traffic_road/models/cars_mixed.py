"""The run of any fleet: units of cars side by side, in the order of passages at every node; see `mixed_order`."""

from __future__ import annotations

import numpy as np

from ..schemes import oscillator
from . import Breath, Pace, Sample
from .cars_state import force, kinds, level_of, node_behind, sink_rate, start
from .even_layout import aligned
from .lanes import LANES
from .line_relaxation import LineRelaxation
from .mixed_kernels import RECORD, coefficients, cross_until, workspace
from .mixed_order import LENGTH, LEVEL, plan

AT_A_TIME = 1_000_000  # passages of a run without relaxation between two moments at which it may be left
STRETCHES = (8, 4, 2, 1, 1 / 2, 1 / 4, 1 / 8)  # mean headway times that units may last
# what work costs, in ns: a row of units by its width, a unit, a unit more because of an overtake
ROW, LANE, UNIT, OVERTAKE = 2.0, 0.65, 35.0, 200.0


def mixed_samples(scene, times, left=None, *, nodes, hold, relax_every):
    """The samples of any fleet; `left` is the state of a Breath to go on from."""
    fleet, length = scene.fleet, scene.road.length
    dx = length / nodes
    distinct, kind_of = kinds(fleet)
    speed, frequency, damping, mass = distinct.T
    A, B = oscillator.propagator(dx / speed, frequency, damping, hold)
    _, value, shape = law = scene.road.softness.kernel
    kind, numbers, factor, offset = coefficients(A, B, 0.5 * mass * scene.headway / speed, frequency**2, law)
    table = aligned(numbers.size)  # a record, a cache line
    table[:] = numbers.ravel()
    road = aligned(nodes)
    road += scene.road.profile.sample(length, nodes)
    # neighbours on the road are neighbours in memory, at first at least
    position = fleet.positions(length)
    number = np.argsort(position, kind="stable")
    back = np.argsort(number)
    position, kind_of = position[number], kind_of[number]
    newest, factor, offset = B[kind_of, 0, 0], factor[kind_of], offset[kind_of]
    behind = node_behind(position, dx)
    Z, P, past = start(scene, road, behind % nodes, kind_of, distinct, hold)
    free = A[kind_of, 0, 0] * Z + A[kind_of, 0, 1] * P + np.einsum("ij,ij->i", B[kind_of, 0, 1:], past)
    flat = aligned(RECORD * fleet.count)
    body = flat.reshape(fleet.count, RECORD)  # passages without contact, f, f_-1, contact heights
    body[:, 1], body[:, 2] = factor * free + offset, factor * (Z - newest * past[:, 0]) + offset
    body[:, 3 : 3 + hold] = past
    due = np.stack((np.maximum(((behind + 1) * dx - position) / speed[kind_of], 0.0), (dx / speed)[kind_of]))
    first_due, step = due
    whole = np.stack((np.lexsort((-number, -first_due, behind)), behind + 1, np.zeros_like(number), number))
    order, place, crossed, number = whole
    cars = (whole, due, kind_of.astype(np.uint64), flat)
    plans = (
        np.empty((5, fleet.count), dtype=np.int64), np.zeros(nodes, dtype=np.int32), np.zeros(1, dtype=np.int64),
        np.empty((2 * fleet.count, 4), dtype=np.int64), np.empty(2 * fleet.count, dtype=np.int64),
    )  # fmt: skip
    work = workspace()
    # a crossing on the very edge of an interval belongs to it, whatever its rounding
    slack = 1e-9 * step.min()
    relax = LineRelaxation(scene.road.diffusivity, length)
    # of the start: the same wherever a run goes on from
    stretch = _stretch(scene.headway_time, nodes, whole, due, plans)
    # without relaxation an interval is only what is done at a time
    interval = scene.headway_time * (max(1, AT_A_TIME // nodes) if relax.still else relax_every)

    arrays = {"road": road, "body": body, "order": order, "place": place, "crossed": crossed}

    def sample(time):
        contact = body[:, 3].copy()
        heights = (body[:, 2] - offset) / factor + newest * contact
        pressed = force(scene, contact, heights, frequency[kind_of], mass[kind_of])
        where = (place - 1) % nodes * dx
        cars_now = (values[back] for values in (heights + level, pressed, where))
        return Sample(float(time), road + level, *cars_now, updates, int(body[:, 0].sum()))

    def leave():
        counts = {"taken": taken, "part": i, "updates": updates, "level": level}
        return counts | {name: values.copy() for name, values in arrays.items()}

    taken = i = updates = 0  # i: parts of the stretch between two samples
    level = 0.0  # what has been taken off all heights
    if left is not None:
        taken, i, updates, level = (left[k] for k in ("taken", "part", "updates", "level"))
        for name, values in arrays.items():
            values[:] = left[name]
    else:
        yield sample(0.0)
        taken = 1
    sink, pace = sink_rate(scene), Pace()
    while taken < len(times):
        begin, end = times[taken - 1], times[taken]
        parts = max(1, round((end - begin) / interval))
        span = (end - begin) / parts
        if i == 0:
            relax(road, span / 2)
        while i < parts:
            i += 1
            until = begin + i * span if i < parts else end
            updates += cross_until(
                begin + (i - 1) * span + slack, until + slack, stretch, road, cars, table, plans, work, (0,) * hold,
                (0,) * kind, (value, shape), scene.lift_off,
            )  # fmt: skip
            relax(road, span if i < parts else span / 2)
            if sink * until // 1 != sink * (until - span) // 1:
                sunk = level_of(road)
                for heights in (road, body[:, 3 : 3 + hold]):
                    heights -= sunk
                body[:, 1:3] -= (factor * (1.0 - newest) * sunk)[:, None]  # z* is Z less newest times a contact height
                level += sunk
            if pace.due():
                yield Breath(float(until), leave, lambda: road)
        yield sample(end)
        taken, i = taken + 1, 0


def _stretch(headway_time, nodes, whole, due, plans) -> float:
    """How long units last: longer ones cost less a node, until they wait for each other. By a trial of the first."""
    best, stretch = np.inf, STRETCHES[-1] * headway_time
    for headways in STRETCHES:
        *trial, number = whole.copy()
        units, ranking, total = plan(headways * headway_time, nodes, *trial, *due, number, *plans, 0)
        if total < 1:
            continue
        units = units[ranking[:total]]
        place_in_level = np.arange(total) - np.searchsorted(units[:, LEVEL], units[:, LEVEL])
        first = np.flatnonzero(place_in_level % LANES == 0)
        width = np.diff(first, append=total)
        cost = (units[first, LENGTH] * (ROW + LANE * width)).sum() + UNIT * total
        cost += OVERTAKE * (total - np.count_nonzero(trial[2] > whole[2]))
        if cost < best * units[:, LENGTH].sum():
            best, stretch = cost / units[:, LENGTH].sum(), headways * headway_time
    return stretch
