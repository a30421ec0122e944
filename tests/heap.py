"""The cars model node by node: a heap of cars by the time of their next crossing. The order of passages is plain to see."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from traffic_road.compiled import njit
from traffic_road.models.cars_state import kinds, node_behind, start
from traffic_road.models.line_relaxation import LineRelaxation
from traffic_road.schemes import oscillator
from traffic_road.schemes.passage import contact_height


@njit(cache=True, error_model="numpy", fastmath=False)
def _sift_down(heap, due):
    """Restore the heap (earliest `due` first, then lowest car) after its top has become later."""
    car = heap[0]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= heap.size:
            break
        if child + 1 < heap.size:
            a, b = heap[child], heap[child + 1]
            if due[b] < due[a] or (due[b] == due[a] and b < a):
                child += 1
        other = heap[child]
        if due[car] < due[other] or (due[car] == due[other] and car < other):
            break
        heap[at] = other
        at = child
    heap[at] = car


@njit(cache=True, error_model="numpy", fastmath=False)
def cross_in_order(
    road, until, heap, due, first_due, crossed, node, Z, P, past, kind_of, A, B, interval, half, omega2, law, lift_off
):
    """Any fleet: cars cross nodes one by one in the order of time, up to the time `until`.

    heap (cars,): cars by the time `due` (cars,) of their next crossing, which is first_due + crossed * interval: no sum
    drifts. node: the next node of each car. past (cars, hold): contact heights, newest first. kind_of (cars,) numbers the
    kinds; A (kinds, 2, 2), B (kinds, 2, hold + 1), interval, half, omega2 (kinds,). law: (kind, value, shape).
    Returns the passages done and those without contact.
    """
    hold = past.shape[1]
    done = 0
    airborne = 0
    while due[heap[0]] <= until:
        car = heap[0]
        k = kind_of[car]
        z_star = A[k, 0, 0] * Z[car] + A[k, 0, 1] * P[car]
        p_star = A[k, 1, 0] * Z[car] + A[k, 1, 1] * P[car]
        for q in range(hold):
            z_star += B[k, 0, q + 1] * past[car, q]
            p_star += B[k, 1, q + 1] * past[car, q]
        before = road[node[car]]
        contact = contact_height(before, z_star, B[k, 0, 0], half[k], omega2[k], law[0], law[1], law[2], lift_off)
        if lift_off and 1.0 + omega2[k] * (before - z_star - B[k, 0, 0] * before) <= 0.0:
            airborne += 1
        road[node[car]] = 2.0 * contact - before
        Z[car] = z_star + B[k, 0, 0] * contact
        P[car] = p_star + B[k, 1, 0] * contact
        for q in range(hold - 1, 0, -1):
            past[car, q] = past[car, q - 1]
        past[car, 0] = contact
        node[car] = node[car] + 1 if node[car] + 1 < road.size else 0
        crossed[car] += 1
        due[car] = first_due[car] + crossed[car] * interval[k]
        _sift_down(heap, due)
        done += 1
    return done, airborne


def heap_cars(scene, times, *, nodes, hold, relax_every=1):
    """Road, Z (cars,), last node of each, passages done and those without contact, at `times` (from 0)."""
    fleet, dx = scene.fleet, scene.road.length / nodes
    distinct, kind_of = kinds(fleet)
    speed, frequency, damping, mass = distinct.T
    A, B = oscillator.propagator(dx / speed, frequency, damping, hold)
    road = scene.road.profile.sample(scene.road.length, nodes).copy()
    position = fleet.positions(scene.road.length)
    behind = node_behind(position, dx)
    Z, P, past = start(scene, road, behind % nodes, kind_of, distinct, hold)
    node = (behind + 1) % nodes
    first_due = np.maximum(((behind + 1) * dx - position) / speed[kind_of], 0.0)
    due, crossed, interval = first_due.copy(), np.zeros(fleet.count, dtype=np.int64), dx / speed
    heap = np.lexsort((np.arange(fleet.count), due)).astype(np.int64)  # sorted is a heap
    relax = LineRelaxation(scene.road.diffusivity, scene.road.length)
    half = 0.5 * mass * scene.headway / speed
    updates = airborne = 0
    out = []
    for begin, end in pairwise(times):
        parts = max(1, round((end - begin) / (relax_every * scene.headway_time)))
        edges = np.linspace(begin, end, parts + 1)
        span = (end - begin) / parts
        relax(road, span / 2)
        for i, until in enumerate(edges[1:], start=1):
            done, lost = cross_in_order(
                road, until + 1e-9 * interval.min(), heap, due, first_due, crossed, node, Z, P, past, kind_of, A, B,
                interval, half, frequency**2, scene.road.softness.kernel, scene.lift_off,
            )  # fmt: skip
            updates, airborne = updates + done, airborne + lost
            relax(road, span if i < parts else span / 2)
        out.append((road.copy(), Z.copy(), (node - 1) % nodes, updates, airborne))
    return out
