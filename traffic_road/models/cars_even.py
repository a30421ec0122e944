"""The run of an even fleet: some headways at a time in the layout of `even_layout`, the road relaxing in between."""

from __future__ import annotations

import numba
import numpy as np

from ..laws import BOUNDED, CONSTANT, EXPONENTIAL
from ..schemes import oscillator
from . import Breath, Pace, Sample
from .cars_state import force, kinds, level_of, sink_rate, start
from .even_kernels import FIELDS, recursion, scaled, sweep_even
from .even_layout import aligned, get, last_of, layout, on_huge_pages, put, slots
from .even_passages import passage, passage_about
from .even_relaxation import Relaxation, margin

FAINT = 1e-9  # softness of a passage below which a force is lost in the rounding of the road, and no count of it kept

STRETCH = 64  # headways between looks at the clock and the level, where the road relaxes by itself or not at all


def even_samples(scene, times, order, first_node, left=None, *, nodes, hold, relax_every):
    """The samples of an even fleet; `left` is the state of a Breath to go on from."""
    fleet, count = scene.fleet, scene.fleet.count
    speed, frequency, _, mass = kinds(fleet)[0][0]
    rows = nodes // count
    dx = scene.road.length / nodes
    node = (first_node + rows * np.arange(count)) % nodes
    where_in = layout(count, rows, margin(scene, nodes, layout(count, rows), (relax_every / 2, relax_every)))
    threads = min(numba.get_num_threads(), where_in.panels)
    relaxation = Relaxation(scene, nodes, where_in, threads)
    cars = _Cars(scene, node, hold, where_in, threads > 1, relaxation.few)
    road = on_huge_pages(where_in.size)
    put(road, scene.road.profile.sample(scene.road.length, nodes), first_node + 1, where_in)
    stretch = relax_every if relaxation.acts else STRETCH
    back = np.argsort(order)

    def heights():
        out = np.empty(nodes)
        get(out, road, first_node + 1, where_in)
        return out

    def sample():
        Z, contact, airborne = cars.read(done)
        where = (node[back] + done * rows) % nodes * dx
        pressed = force(scene, contact[back], Z[back], frequency, mass)
        time = done * scene.headway / speed
        return Sample(time, heights() + level, Z[back] + level, pressed, where, done * nodes, airborne)

    def leave():
        counts = {"taken": taken, "done": done, "pending": pending, "level": level}
        return counts | {"road": road.copy(), "cars": cars.flat.copy(), "contacts": cars.contacts.copy()}

    taken = done = 0
    pending = level = 0.0  # headways of relaxation that are due; what has been taken off all heights
    if left is not None:
        taken, done, pending, level = (left[k] for k in ("taken", "done", "pending", "level"))
        road[:], cars.flat[:], cars.contacts[:] = left["road"], left["cars"], left["contacts"]
    else:
        yield sample()
        taken = 1
    sink, pace = sink_rate(scene) * scene.headway / speed, Pace()
    most = STRETCH if sink * STRETCH < 1 else 1 / sink  # headways in which the level hardly changes
    for target in np.rint(np.asarray(times[taken:]) * speed / scene.headway).astype(int).tolist():
        while done < target:
            chunk = min(stretch, target - done)
            if pace.due():
                yield Breath(done * scene.headway / speed, leave, heights)
            often = int(min(most, target - done) // stretch) if pending == stretch / 2 else 0
            inside = relaxation.inside(stretch) if often > 1 else None
            if inside:
                crossed, band = often * chunk, (often, *inside)
            else:
                crossed, band = chunk, relaxation.ahead(road, pending + chunk / 2)
            cars.cross(road, done, chunk, band, crossed)
            done += crossed
            pending = chunk / 2
            if sink * done // 1 != sink * (done - crossed) // 1:
                sunk = level_of(heights())
                road -= sunk
                cars.lower(sunk)
                level += sunk
        relaxation.relax(road, pending)
        pending = 0.0
        yield sample()
        taken += 1


class _Cars:
    """State of the cars, and how they cross blocks."""

    def __init__(self, scene, node, hold, where_in, parallel, few):
        fleet, count = scene.fleet, scene.fleet.count
        distinct, _ = kinds(fleet)
        speed, frequency, damping, mass = distinct[0]
        self.layout, rows = where_in, where_in.rows
        dx = scene.headway / rows
        A, B = (c[0] for c in oscillator.propagator(dx / speed, frequency, damping, hold))
        kind, value, shape = scene.road.softness.kernel
        half, omega2 = 0.5 * mass * scene.headway / speed, frequency**2
        if kind == CONSTANT and half * value * omega2 < FAINT:
            kind = BOUNDED  # of shape 0: the same law, its passages decided one by one
        if kind == CONSTANT:
            self.coefficients, s, self.factor, self.offset = scaled(A, B, half * value, omega2)
        else:
            T, D, e = recursion(A, B)
            s, self.factor, self.offset = 1.0, omega2 if kind == EXPONENTIAL else 1.0, 0.0
            self.coefficients = np.concatenate(([0.0, T, D], self.factor * e))
        self.passage = s, B[0, 0], half, omega2, (kind, value, shape)
        self.law = passage(*self.passage, 0.0)
        self.newest = B[0, 0]
        self.lift_off, self.rows = scene.lift_off, rows
        self.kernel = where_in.width, hold, kind, rows, parallel, kind == CONSTANT and not scene.lift_off, few

        height = scene.road.profile.sample(scene.road.length, node.size * rows)
        Z, P, past = start(scene, height, node, np.zeros(count, dtype=int), distinct, hold)
        f = self.factor * (A[0, 0] * Z + A[0, 1] * P + past @ B[0, 1:]) + self.offset
        before = self.factor * (Z - self.newest * past[:, 0]) + self.offset
        c, T, D, *e = self.coefficients
        fields = FIELDS + hold
        self.flat = on_huge_pages(self.layout.panels * self.layout.tiles * fields * self.layout.width)
        self.state = self.flat.reshape(-1, fields, self.layout.width)
        # less one for each contact. Each panel's at cache lines of its own: two threads that write to one wait for each other
        self.contacts = aligned(self.layout.panels * self.layout.width).view(np.int64)
        self.where = slot, lane = slots(0, self.layout)  # of all cars, in the order of their places
        self.exponential = kind == EXPONENTIAL
        for field, values in ((0, f), (-2, past[:, 0]), (-1, before)):
            self.state[slot, field, lane] = values
        for j in range(1, hold + 1):  # what passages behind add to those ahead
            self.state[slot, j, lane] = c + past[:, : hold + 1 - j] @ e[j:]
        self.state[slot, 1, lane] += D * before

    def read(self, done):
        """Z and the last contact height (cars,) of each car, and the number of passages without contact so far."""
        contact, f = last_of(self.state, done, self.layout)
        airborne = int(done * self.rows * f.size + np.add.reduce(self.contacts)) if self.lift_off else 0
        return (f - self.offset) / self.factor + self.newest * contact, contact, airborne

    def lower(self, level):
        """Takes `level` off all heights of the cars."""
        _, _, D, *e = self.coefficients
        sunk = self.factor * (1.0 - self.newest) * level  # z* is Z less newest times a contact height
        self.state[:, [0, -1]] -= sunk
        self.state[:, -2] -= level
        for j in range(1, len(e)):
            self.state[:, j] -= level * sum(e[j:])
        self.state[:, 1] -= D * sunk

    def cross(self, road, done, headways, band, crossed):
        """All cars cross `headways` blocks, the first of them being headway `done`, once or more often: `crossed` in all.

        band: of `Relaxation.ahead`, or how often, and of `Relaxation.inside`.
        """
        slot, lane = self.where
        short = False
        if self.exponential:
            cars = self.state[slot, -2, lane], self.state[slot, 0, lane]
            self.law, short = passage_about(self.passage, *cars, crossed * self.rows * slot.size)
        sweep = sweep_even(*self.kernel, short)
        least = 0.0 if self.lift_off else -np.inf
        sweep(road, self.flat, self.contacts, self.layout, headways, done, self.coefficients, self.law, least, *band)
