"""Linear cars and road in closed form, `linear_state`: no time step is taken.

Laws must be constant and cars must not take off (lift_off=False lets them pull).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..errors import SceneError, StabilityError
from ..laws import Constant
from . import Breath, Pace, Sample, cars
from .cars_state import even_start
from .linear_state import HOLD, Blocks, MeanField

PAIR_RATIO = 1.5  # half the resolution differs by 3 times the error at order 2; 1.5 allows for order 1.3
ROWS = 8  # nodes a headway, in the default grid
LOOKS = 64  # times at which a road is asked whether its cars take off
MOST_ROWS = 256  # nodes a headway beyond which a matrix costs more than a run of cars
DENSE = 2.5  # wavenumber, times u/omega, from which on no wave grows but on a road far softer than those that saturate


def numerics(scene, given: dict) -> dict:
    """`nodes` (road nodes in all), by default 8 a headway and what the profile needs.

    SceneError: an unknown keyword, laws that vary, nodes that do not resolve the profile.
    """
    unknown = sorted(set(given) - {"nodes"})
    if unknown:
        raise SceneError(f"{unknown[0]}: not a parameter of the linear model; it takes nodes")
    for name in ("softness", "diffusivity"):
        if not isinstance(getattr(scene.road, name), Constant):
            raise SceneError(
                f"Road.{name}: the linear model needs a Constant law; use model='continuum' or 'cars', or freeze it"
            )
    count, waves = scene.fleet.count, scene.road.profile.highest_wave(scene.road.length)
    if "nodes" not in given:
        rows = max(ROWS, -(-(2 * waves + 1) // count))
        given = {"nodes": count * rows if is_even(scene) else max(32, 2 * waves + 2)}
    if is_even(scene):
        nodes = cars.numerics(scene, {**given, "hold": HOLD})["nodes"]
        if nodes % count or nodes > MOST_ROWS * count:
            raise SceneError(
                f"nodes = {nodes}: the linear model takes a multiple of the {count} cars, up to {MOST_ROWS} a headway; "
                "use such a one, or model='cars'"
            )
    else:
        nodes = cars.whole("nodes", given["nodes"], 1, cars.MOST_NODES)
    if nodes <= 2 * waves:
        raise SceneError(f"nodes = {nodes}: the profile has {waves} waves on the ring; use nodes >= {2 * waves + 1}")
    return {"nodes": nodes}


def is_even(scene) -> bool:
    """Whether the cars are identical and their headways equal."""
    return even_start(scene, scene.fleet.count) is not None


def coarser(scene, chosen: dict) -> dict | None:
    """Half the nodes; None where that is too few, or where the grid is only looked at (any fleet but an even one)."""
    count = scene.fleet.count
    rows = chosen["nodes"] // count // 2
    try:
        return numerics(scene, {"nodes": count * rows}) if is_even(scene) and rows else None
    except (SceneError, StabilityError):
        return None


def finer(scene, chosen: dict, given: dict) -> dict:
    """Twice the nodes, unless they were given or are only looked at, or there are as many as the model takes."""
    most = 2 * chosen["nodes"] > MOST_ROWS * scene.fleet.count
    return chosen if "nodes" in given or most or not is_even(scene) else {"nodes": 2 * chosen["nodes"]}


def sample_times(scene, times, numerics: dict) -> np.ndarray:
    """Whole headways, without repeats, for an even fleet; else the times asked for."""
    return cars.sample_times(scene, times, {**numerics, "relax_every": 1}) if is_even(scene) else np.asarray(times)


def samples(scene, times, numerics: dict, state: dict | None = None):
    """Yield a Sample at each of `times`; fields on x = j length/nodes. StabilityError, at once, where cars take off.

    An even fleet's `car_height` and `contact_force` are those of the cars at that moment, by waves between them.
    Between samples a Breath, see `models`; `state` is that of one.
    """
    lost = takes_off(scene, float(times[-1]))
    if lost is not None:
        raise StabilityError(
            f"model = 'linear': cars take off at about time {lost:.4g}, which it does not know; "
            "use model='continuum' or 'cars', a shorter duration, or lift_off=False"
        )
    nodes, pace = numerics["nodes"], Pace()
    run = Blocks(scene, nodes // scene.fleet.count) if is_even(scene) else MeanField(scene)
    y, now, taken = run.y, 0.0, 0
    if state is not None:
        y, now, taken = state["y"], state["now"], state["taken"]
    for time in map(float, times[taken:]):
        y, now = run.advance(y, now, time)
        taken += 1
        sample = Sample(now, *run.fields(y, nodes), None, 0)
        yield sample
        if taken < len(times) and pace.due():
            state = {"y": y.copy(), "now": now, "taken": taken}
            yield Breath(now, lambda state=state: state, lambda sample=sample: sample.road_height)


def sparse(scene) -> bool:
    """Whether what the cars' steps make of the road's waves, a headway's wave away, may be long enough to grow itself."""
    road, fleet = scene.road, scene.fleet
    if not is_even(scene) or road.softness.value == 0:
        return False
    aliased = 2 * np.pi * (1 / scene.headway - road.profile.highest_wave(road.length) / road.length)
    return aliased * fleet.per_car("speed")[0] / fleet.per_car("frequency")[0] < DENSE


@lru_cache(maxsize=8)
def takes_off(scene, duration: float) -> float | None:
    """The time at which the first car loses contact, or about to; None if none does within `duration`.

    Looked for at 64 times: in the mean field, on a grid of 4 points or more for the shortest wave; where cars are few for the
    waves that grow, so that the ripple does, in the passages of the scheme itself.
    """
    if not scene.lift_off:
        return None
    lost = _rippled_off(scene, duration) if sparse(scene) else None
    field = MeanField(scene)
    nodes = max(32, 4 * int(field.waves[-1]) + 4)
    speed = scene.fleet.per_car("speed").min()
    # a wheel rolls down a step, and presses less by it: as deep as one passage
    step = field.square * field.mass.max() * scene.road.softness.value * scene.headway / speed
    y = field.y
    for look in range(LOOKS + 1):
        *_, force = field.by_kind(y, nodes)
        if not np.all(force.min(axis=1) / field.mass > step):
            time = look * duration / LOOKS
            return time if lost is None else min(time, lost)
        y = field.after(y, duration / LOOKS)
    return lost


def _rippled_off(scene, duration: float) -> float | None:
    """The same by the passages of an even fleet."""
    waves, count = scene.road.profile.highest_wave(scene.road.length), scene.fleet.count
    rows = max(ROWS, -(-(2 * waves + 1) // count))
    while True:
        try:
            cars.numerics(scene, {"nodes": rows * count, "hold": HOLD})
            break
        except StabilityError:
            rows *= 2
            if rows > MOST_ROWS:
                return None  # nor does the model run
    blocks, done = Blocks(scene, rows), 0
    headways = max(1, round(duration / scene.headway_time))
    y, some = blocks.y, max(1, headways // LOOKS)
    with np.errstate(all="ignore"):
        while np.min(blocks.forces(y)) > 0:
            if done == headways:
                return None
            step = min(some, headways - done)
            y, done = blocks.after(y, step), done + step
    return done * scene.headway_time
