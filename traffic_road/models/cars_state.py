"""What even and mixed fleets have in common: kinds of car, how cars start, the force of a wheel."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..laws import Constant
from ..schemes import oscillator


@lru_cache(maxsize=4)  # asked for ten times a run
def kinds(fleet) -> tuple[np.ndarray, np.ndarray]:
    """Distinct (speed, frequency, damping, mass), shape (kinds, 4), and the kind of each car, shape (count,)."""
    columns = np.stack([fleet.per_car(name) for name in ("speed", "frequency", "damping", "mass")], axis=1)
    distinct, kind_of = np.unique(columns, axis=0, return_inverse=True)
    kind_of = kind_of.reshape(-1)
    distinct.setflags(write=False)
    kind_of.setflags(write=False)
    return distinct, kind_of


def evenly_spaced(scene, nodes: int) -> tuple[np.ndarray, int] | None:
    """For cars of one speed, evenly spaced over whole nodes: their order by position, and the node of the first; else None."""
    fleet, length = scene.fleet, scene.road.length
    distinct, _ = kinds(fleet)
    if np.ptp(distinct[:, 0]) > 0 or nodes % fleet.count:
        return None
    position = fleet.positions(length)
    order = np.argsort(position, kind="stable")
    spacing = position[order] - np.arange(fleet.count) * scene.headway
    if np.ptp(spacing) > 1e-9 * scene.headway:
        return None
    return order, int(node_behind(position[order[:1]], length / nodes)[0])


def even_start(scene, nodes: int) -> tuple[np.ndarray, int] | None:
    """The same for an even fleet, of identical cars; None for any other."""
    return evenly_spaced(scene, nodes) if len(kinds(scene.fleet)[0]) == 1 else None


def node_behind(position, dx):
    """The node at or behind a position; a position within rounding of a node is on it."""
    return np.floor(position / dx + 1e-9).astype(np.int64)


def start(scene, road, node, kind_of, distinct, hold):
    """Z, P (cars,) and the contact heights behind each car (cars, hold), newest first, at the start."""
    length, nodes = scene.road.length, road.size
    behind = road[(node[:, None] - np.arange(hold)) % nodes]
    if scene.fleet.start == "rest":
        return road[node], np.zeros(node.size), behind
    sink = float(scene.road.softness(np.mean(road))) * float(np.mean(scene.fleet.per_car("mass")))
    if node.size * oscillator.wave_count(road) < len(distinct) * nodes:
        speed, frequency, damping, _ = distinct[kind_of].T
        Z, P = oscillator.settled_at(node, road, length, speed, frequency, damping, sink)
    else:
        Z, P = np.empty((2, node.size))
        for k, (speed, frequency, damping, _) in enumerate(distinct):
            mine = kind_of == k
            height, momentum = oscillator.settled(road, length, speed, frequency, damping, sink)
            Z[mine], P[mine] = height[node[mine]], momentum[node[mine]]
    return Z, P, behind


def force(scene, contact, Z, frequency, mass):
    pressed = mass * (1.0 + frequency**2 * (contact - Z))
    return np.maximum(pressed, 0.0) if scene.lift_off else pressed


def sink_rate(scene) -> float:
    """How fast the road sinks under the cars' weight where nothing depends on how far it has; 0 where a law does.

    Where this times the time passes a whole number, the road's level is taken off all heights and kept apart.
    """
    laws = scene.road.softness, scene.road.diffusivity
    if not all(isinstance(law, Constant) for law in laws):
        return 0.0
    return laws[0].value * float(np.mean(scene.fleet.per_car("mass")))


def level_of(height) -> float:
    """The whole number nearest to the mean of `height`; 0 where there is none."""
    level = float(np.rint(np.mean(height)))
    return level if np.isfinite(level) else 0.0
