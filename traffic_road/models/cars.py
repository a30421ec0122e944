"""Discrete cars: each crosses the road node by node and compacts it; between passages the road relaxes.

Two layouts. An even fleet (identical cars, equal headways of a whole number of nodes) goes headway by headway in
`cars_even`, and every sample is taken after a whole number of relaxation intervals; one that is longer than the run, to
the nearest headway, is refused. Any other fleet goes car by car in the order of time in `cars_mixed`, and is sampled at the
very times that were asked for.

The relaxation acts every `relax_every` mean headways. Half of one opens and closes the run and each sample (Strang), so
that the road is second order in the interval at every sample.

Where both laws are constant nothing depends on how far the road has sunk, and a whole level is taken off all heights from
time to time (`cars_state.sink_rate`): a road that has sunk by 1e5 resolves what a fresh one does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..errors import SceneError, StabilityError
from ..laws import whole
from ..memory import refuse_beyond_memory
from ..schemes import oscillator
from . import Breath, Sample
from .cars_even import even_samples
from .cars_mixed import mixed_samples
from .cars_state import even_start, evenly_spaced, kinds

MOST_NODES = 10**9  # 8 GB for the road alone
VALUES_PER_NODE = 16  # held at once at most, measured: road, transforms, the second run of the estimate
MOST_PASSAGES = 1e16  # a year of computing
NODES_PER_WAVE = 8  # of the shortest wave of the profile, in the default grid
PAIR_RATIO = 1.0  # a pair of runs differs by the error of the better one at order 1: the steps that wheels leave
PHASE_PER_NODE = 0.15  # omega dx / u of the quickest car, in the default grid


def numerics(scene, given: dict) -> dict:
    """nodes (road nodes in all), hold (1, 3, 5), relax_every (whole headways): given or default, checked.

    SceneError names a value that cannot be used, StabilityError a grid too coarse for the fleet.
    """
    chosen = unstable_numerics(scene, given)
    every, headways = chosen["relax_every"], max(1, _headways(scene))
    if every > headways and evenly_spaced(scene, chosen["nodes"]) is not None:
        raise SceneError(
            f"relax_every = {every}: evenly spaced cars are sampled after whole intervals, and one of "
            f"{every * scene.headway_time:.4g} is longer than the duration, {scene.duration:g}; use relax_every <= {headways} "
            "or a longer duration"
        )
    _refuse_coarse_grid(scene, chosen["nodes"], chosen["hold"])
    return chosen


def scheme(scene, given: dict) -> dict:
    """`numerics` of no run, but of its growth rates: with any relaxation interval, however short the duration."""
    chosen = unstable_numerics(scene, given)
    _refuse_coarse_grid(scene, chosen["nodes"], chosen["hold"])
    return chosen


def unstable_numerics(scene, given: dict) -> dict:
    """`numerics` on any grid on which a passage still has one solution, however its short waves grow: for study."""
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
    refuse_beyond_memory(VALUES_PER_NODE * nodes, f"nodes = {nodes}", "use fewer nodes or a shorter ring")
    scene.road.profile.sample(length, nodes)  # SceneError where the grid does not resolve it
    _refuse_insoluble(scene, nodes, hold)
    return {"nodes": nodes, "hold": hold, "relax_every": relax_every}


def coarser(scene, chosen: dict) -> dict | None:
    """Half the nodes and, where relaxation is less often than every headway, twice the interval; None if impossible, or if
    the run is so short that its intervals would be the same, or if there would be one node a headway, which has no ripple."""
    count = scene.fleet.count
    if chosen["nodes"] < 4 * count and evenly_spaced(scene, chosen["nodes"]) is not None:
        return None
    if chosen["relax_every"] > 1 and _headways(scene) < 2 * chosen["relax_every"]:
        return None
    nodes = chosen["nodes"] // 2
    if chosen["nodes"] % count == 0 and chosen["nodes"] > count:
        nodes = count * (chosen["nodes"] // count // 2)  # an even fleet stays one
    elif nodes % count == 0:
        nodes -= 1  # and one that stands between nodes does, or it would be seen at another time
    relax_every = 2 * chosen["relax_every"] if chosen["relax_every"] > 1 else 1
    try:
        return numerics(scene, {**chosen, "nodes": nodes, "relax_every": relax_every})
    except (SceneError, StabilityError):
        return None


def _headways(scene) -> int:
    return round(scene.duration / scene.headway_time)


def finer(scene, chosen: dict, given: dict, times: float = 2) -> dict:
    """So many times the nodes, in whole pairs a headway, and half the relaxation interval; what was given stays."""
    pair, nodes, every = 2 * scene.fleet.count, chosen["nodes"], chosen["relax_every"]
    if "nodes" not in given:
        nodes = 2 * nodes if times == 2 else pair * math.ceil(times * nodes / pair)
    if "relax_every" not in given:
        every = max(1, min(every, _headways(scene)) // 2)
    return {**chosen, "nodes": nodes, "relax_every": every}


def _refuse_insoluble(scene, nodes: int, hold: int) -> None:
    """StabilityError where the newest contact height weighs so much that a passage has no solution, or several."""
    distinct, _ = kinds(scene.fleet)
    speed, frequency, damping, mass = distinct.T
    _, B = oscillator.propagator(scene.road.length / nodes / speed, frequency, damping, hold)
    height = scene.road.profile.sample(scene.road.length, nodes).max()
    with np.errstate(over="ignore"):  # what overflows is refused or caught where it is used
        push = 0.5 * mass * scene.headway / speed * float(scene.road.softness(height))
    excess = np.max(push * frequency**2 * (B[:, 0, 0] - 1))
    if not excess < 1:
        raise StabilityError(
            f"nodes = {nodes}: a passage of softness {2 * np.max(push):.3g} on so coarse a grid has no single solution: "
            f"(b - 1) delta m omega^2/2 = {excess:.3g}, b the weight of the newest contact height, must be < 1; use more nodes"
        )


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


def samples(scene, times, numerics: dict, state: dict | None = None) -> Iterator[Sample | Breath]:
    """Run the scene; see `models` for the contract. A car between two nodes starts from the node behind it, earlier."""
    even = even_start(scene, numerics["nodes"])
    if even is not None:
        return even_samples(scene, times, *even, state, **numerics)
    return mixed_samples(scene, times, state, **numerics)


def sample_times(scene, times, numerics: dict) -> np.ndarray:
    """The times at which samples will be taken: of evenly spaced cars whole relaxation intervals, without repeats.

    Then all wheels are on nodes. At any other time all are as far beyond one, a part of dx that is another on every grid,
    and errors do not fall with dx as two grids would tell.
    """
    if evenly_spaced(scene, numerics["nodes"]) is None:
        return np.asarray(times, dtype=float)
    interval = scene.headway_time * numerics["relax_every"]
    whole = np.rint(np.asarray(times) / interval)
    whole[-1] = max(whole[-1], 1)  # the shortest run there is
    return np.unique(whole) * interval
