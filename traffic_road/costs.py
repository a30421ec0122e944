"""What a run costs, in seconds of one core, as far as a choice between runs needs it: within a factor of two.

The constants were measured on one core at 2.9 GHz, and hold, times SLOWER, for a virtual one of AMD Zen 3
(`experiments/planning.py` prints how true they are where it runs); another machine is slower or faster by much the same factor
everywhere, and the choice stays.
"""

from __future__ import annotations

import numpy as np

from .errors import TrafficRoadError
from .laws import Constant, Exponential
from .models import linear
from .models.cars_even import STRETCH
from .models.continuum import stage
from .models.continuum_state import FEW_NODES, FEW_NODES_VARYING, Kinds, constant
from .models.even_layout import MANY, layout
from .models.even_relaxation import FEW
from .models.even_ripple import halvings
from .models.line_relaxation import LEAST
from .schemes.relaxation import ALIASED, SHORT_RING

SLOWER = 1.4
FIXED = {"linear": 0.7e-3, "continuum": 0.06e-3, "cars": 0.9e-3}  # of any run: scene to samples
CALL, CALL_INTERVAL = 0.6e-6, 13e-6  # of a headway of an even fleet; of the loops that cross and relax an interval,
CALL_FEW = 0.3e-6  # many of them at once, of few nodes
FEW_NODE, FEW_PAIR = 1.6e-9, 1.1e-10  # of these a node relaxed, and each pair of its weights
CALL_EXPONENTIAL = 35e-6  # of the polynomial for one, made anew for every interval, or for many
CALL_RELAX, CALL_SHORT = 5e-6, 3e-6  # of a relaxation, and of a short ring's
PAIR = 7e-11  # two nodes of a short ring
UPDATE = {1: 0.8e-9, 3: 1.2e-9, 5: 1.6e-9}  # a node crossed, by the hold
LAW = 6e-9  # the same where the softness varies: 1.5e-9, but 20e-9 where it varies by half along the road
# any fleet but an even one: a headway, a car of it, a node crossed, or one where the softness varies
ANY_CALL, ANY_CAR, ANY_ORDER, ANY_LAW = 10e-6, 0.15e-6, 3e-9, 14e-9
# a node relaxed, constant diffusivity: by way of all waves, or by weights nearby; these along lanes, few of them, in a line,
# and in a long line by levels
TRANSFORM, BAND, NARROW_BAND, LINE_BAND, LINE_LEVELS = 15e-9, 1.5e-9, 4e-9, 3e-9, 2.5e-9
RIPPLES = 6e-9  # of a large even fleet's long road, where there are no such weights for little smoothing
SPREAD, LINE_SPREAD = (
    2.4,
    164.0,
)  # diffusivity times the interval over dx^2 between which there are such weights; beyond, on a
# line of many nodes, by levels
REACH = 17.0  # of the weights along lanes in nodes, over the root of that: below a lane's length
# a step of the continuum; its waves two by two, or transformed
STEP, WAVES, CONTACT, STEP_LAW, WAVES_LAW, WAVES_TRANSFORM = 3e-6, 2.5e-9, 5e-8, 20e-6, 16e-9, 1.0e-6
CALL_LAW, RELAX_LAW = 0.3e-3, 85e-9  # a relaxation where diffusivity varies; a node and a polynomial's degree

LOOK = 3e-9  # when cars take off: a wave, by the exponential or the eigenvalues of a matrix; its size cubed
FREE = 1.0  # seconds that planning may take of any scene
TIMES = 5.0  # the run that is planned, besides: its two coarsest runs seldom take more of the first


class TooDear(TrafficRoadError):
    """A plan's run that would take longer than planning may."""


class Purse:
    """Predicted seconds that a plan's own runs have taken, and may: predicted, so that a scene has one plan anywhere."""

    def __init__(self, allowed: float = FREE):
        self.spent, self.allowed = 0.0, allowed

    def covers(self, cost: float) -> bool:
        return self.spent + cost <= self.allowed

    def pay(self, cost: float) -> None:
        """TooDear, and nothing paid, where that would be more than it may."""
        if not self.covers(cost):
            raise TooDear(f"{self.spent + cost:.2g} s of planning, of {self.allowed:.2g} s allowed")
        self.spent += cost


def of_outlook(scene, matrices: int) -> float:
    """Of `takes_off`, a matrix for every wave and moment that it looks at."""
    return SLOWER * matrices * LOOK * (2 * len(Kinds.of(scene.fleet).speed) + 2) ** 3


def of_cars(scene, numerics: dict, even: bool) -> float:
    """even: identical cars, evenly spaced over whole nodes."""
    road, nodes, hold = scene.road, numerics["nodes"], numerics["hold"]
    headways = scene.duration / scene.headway_time
    varies = not isinstance(road.softness, Constant)
    if even:
        sweep = CALL + nodes * (LAW if varies else UPDATE[hold])
    else:
        sweep = ANY_CALL + scene.fleet.count * ANY_CAR + nodes * (ANY_LAW if varies else ANY_ORDER)
    relax, interval, delta = 0.0, scene.headway_time * numerics["relax_every"], float(road.diffusivity(0.0))
    call, calls = CALL_INTERVAL, 1.0
    if not isinstance(road.diffusivity, Constant):
        reach = 0.5 * interval * delta * (np.pi * nodes / road.length) ** 2
        relax = CALL_LAW + nodes * RELAX_LAW * (1 + np.sqrt(2 * reach))
    elif delta > 0:
        spread, count, short = delta * interval * (nodes / road.length) ** 2, scene.fleet.count, nodes <= SHORT_RING
        by_levels = nodes >= LEAST and spread >= ALIASED
        transform = nodes * PAIR if short else LINE_LEVELS if by_levels else TRANSFORM
        band, most = LINE_LEVELS if by_levels else LINE_BAND, LINE_SPREAD
        if even and not short:
            lanes = layout(count, nodes // count)
            band, most = BAND if count >= MANY else NARROW_BAND, ((lanes.tiles - 1) * lanes.rows / REACH) ** 2
            if spread <= SPREAD and halvings(nodes, lanes):
                transform = RIPPLES
        relax = (CALL_RELAX if even and not short else CALL_SHORT) + nodes * (
            band if SPREAD < spread < most else transform
        )
        if even and nodes <= FEW and (short or SPREAD < spread < LINE_SPREAD):
            call, calls = CALL_FEW, max(1.0, STRETCH / numerics["relax_every"])
            relax = nodes * (FEW_NODE + FEW_PAIR * min(nodes / 2, 10 * np.sqrt(spread)))
    if even:
        relax += call + (CALL_EXPONENTIAL / calls if isinstance(road.softness, Exponential) else 0.0)
    return SLOWER * (FIXED["cars"] + headways * (sweep + relax / numerics["relax_every"]))


def of_linear(scene, numerics: dict, waves: int, even: bool) -> float:
    """`waves`: of the profile, the uniform one included."""
    if not even:
        size = 2 * len(Kinds.of(scene.fleet).speed) + 2
        return SLOWER * (FIXED["linear"] + waves * (5e-6 + 2e-8 * size**3))
    size = numerics["nodes"] / scene.fleet.count + 3 + linear.HOLD
    headways = max(2.0, scene.duration / scene.headway_time)
    products = 1.5 * np.log2(headways) + 2
    return SLOWER * (FIXED["linear"] + waves * (30e-6 + products * (2e-6 + 0.6e-9 * size**3)))


def of_continuum(scene, numerics: dict, leaps: bool) -> float:
    """leaps: no law varies and no car takes off, so that one exponential leads from sample to sample."""
    nodes, kinds = numerics["nodes"], len(Kinds.of(scene.fleet).speed)
    build = nodes * (1e-6 + 6e-9 * (2 * kinds + 4) ** 3)
    if leaps:
        return SLOWER * (FIXED["continuum"] + build)
    if constant(scene.road):
        highest = scene.road.profile.highest_wave(scene.road.length)  # where cars take off and land, on each wave
        step = STEP + nodes * (WAVES * nodes + CONTACT * highest if nodes <= FEW_NODES else WAVES_TRANSFORM)
        step *= kinds
    else:
        step = STEP_LAW + nodes * (WAVES_LAW * nodes if nodes <= FEW_NODES_VARYING else WAVES_TRANSFORM)
        step *= 1 + 0.5 * (kinds - 1)
    until = steps = 0
    while until < scene.duration:
        until, some = stage(until, scene.duration, numerics["step"], numerics["step"])
        steps += some
    return SLOWER * (FIXED["continuum"] + 2 * build + steps * step)
