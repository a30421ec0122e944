"""The error of a run: how far its corrugation is, at the end, from what its model's own equations give.

In the L2 norm over the road, mean removed, relative. Where the run is linear (identical evenly spaced cars, settled at the
start, constant laws, no passage without contact) and its waves grow at one rate each it is the sum of two parts, each known
apart from the other: waves, whose growth rates and shapes the Floquet matrix tells for the scheme and for a far finer one;
and the ripple that passages leave on a uniform road, which one car on a ring of one headway shows. Elsewhere a second run
of all at half the resolution tells.

Cars between which the road relaxes less often than every headway are compared with those of half the nodes and every headway,
and with those of half the nodes alone: in few intervals, or where waves decay within one, errors follow no order. Only of a
linear run of many short intervals growth rates tell enough.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .errors import SceneError
from .laws import Constant
from .models import Sample, model
from .models.cars_state import even_start, sink_rate
from .models.continuum_state import SHORT, grown_from_rounding, left_by_rounding, linear_throughout
from .models.continuum_waves import apart
from .scene import Fleet, Road
from .schemes.exponential import eigenvectors
from .schemes.oscillator import settled_waves
from .theory.dispersion import mode_matrix
from .theory.floquet import floquet_modes

EPS = float(np.finfo(float).eps)
STRONGEST = 8  # waves of the final road that stand for all of them, or fewer whose share of it is
SHARE = 1 - 1e-6
OTHERS = 0.1  # of a wave by its growth rate: what may belong to the other rates that it has
# By how many times its error e a run differs from one at half the resolution where nothing smooths the steps that passages
# leave, and it is of order 1/2: by the short waves that grids leave out, of which the squares subtract, 2 e^2 - e^2; and for
# cars by the node at each step, whose error on the waves of both grids is half as large on the finer: e^2/2. At order 1: e.
# The continuum's kinks, where cars take off and land, are of order 3/2 then: 0.6^-1.5 - 1 = 1.15 e on 0.6 of the nodes;
# measured, 1.2 e at least.
STEPS_STAY = {"linear": 1.0, "cars": math.sqrt(0.5), "continuum": 1.15}
LEAVING = 0.1  # of the static load: a force between few nodes below which somewhere there is none
# Where in a step cars take off for the first time, or land for the last, is chance, and so is a part of the error: two runs
# may agree by it. By how many times its error such a run of the continuum differs, measured, from one of twice and from one
# of four times its steps, by the one or by the other; and from one of half of them. Too little by more than a fifth in 4 of
# 426 runs of random scenes, and in 3 of 474.
IN_FLIGHT, FOURFOLD, HALF_STEPS = 1.5, 7.0, 0.6
# A run that relaxes seldom differs from one that relaxes every headway by its error, but for what that of the coarser grid
# takes off: measured, 0.5 to 4 times it, below 0.9 in one of a hundred, where grid and interval tell more, each by itself.
SELDOM = 0.7
SELDOMEST, INTERVALS = 4, 100  # headways between relaxations, and so many such intervals: see `_settles`
FINE_ROWS = 96  # nodes a headway up to which a matrix of twice as many is still cheap
MOST_ROWS = 400  # beyond which the matrices cost more than a second run of all


def error_estimate(scene, name: str, numerics: dict, last: Sample, pair_ratio=None) -> tuple[float, str]:
    """Relative error of the corrugation of `last`, the run's final sample, and how it was found.

    pair_ratio: of a plan that knows it, in place of the model's PAIR_RATIO.
    """
    if last.time != scene.duration:  # samples at times of their own
        scene = replace(scene, duration=last.time)
    module = model(name)
    uneven = last.road_height - np.add.reduce(last.road_height) / last.road_height.size
    size = math.sqrt(uneven @ uneven / uneven.size)
    often = numerics
    linear = name == "cars" and _is_linear(scene, numerics, last)
    if (
        name == "cars"
        and numerics["relax_every"] > 1
        and _relaxes(scene)
        and not (linear and _settles(scene, numerics, last))
    ):
        often = {**numerics, "relax_every": 1}
    if linear and often == numerics:
        other = _compared(scene.fleet.count, numerics)
        error = np.hypot(_of_waves(scene, numerics, other, last), _of_ripple(scene, numerics, other, last))
        method = "growth rates and ripple, of the scheme and of a finer one"
    elif name == "continuum" and linear_throughout(scene, numerics["nodes"], last.time):
        error = left_by_rounding(scene, last.road_height, last.time)
        method = "rounding: linear throughout, one matrix exponential a wave"
    else:
        # half the resolution costs half a run or less; where that is too little to run, or to tell, twice or more
        quick = name == "linear" and numerics["nodes"] <= FINE_ROWS // 2 * scene.fleet.count
        often = numerics if pair_ratio else often
        coarse = None if quick else module.coarser(scene, often)
        other = coarse or module.numerics(scene, module.finer(scene, often, {}))
        if other == numerics:
            error, method = 0.0, "none: the linear mean field is exact on any grid"
        else:
            ratio, how = (pair_ratio or module.PAIR_RATIO, "at half the") if coarse else (0.5, "at twice the")
            how += " resolution"
            if quick:  # a pair differs by 1 - 2^-p of the error: p is 2, but for the steps that stay without diffusion
                ratio = 0.3 if steps_stay(scene, numerics["nodes"]) else 0.6
            elif coarse and not pair_ratio and steps_stay(scene, numerics["nodes"]):
                ratio = STEPS_STAY.get(name, ratio)
            elif coarse and often != numerics:
                ratio = SELDOM
            if name == "continuum":  # every step of the one in so many of the other, the shorter ones at the start, too
                other = other | {"unit": numerics["step"]}
                if coarse:
                    how = "on fewer nodes in steps twice as long"
                if coarse and coarse["step"] < numerics["step"]:
                    ratio, how = HALF_STEPS, "on fewer nodes in steps half as long"
            first, *_, second = module.samples(scene, np.array([0.0, last.time]), other)
            error = _distance(last.road_height, second.road_height) / ratio
            if coarse and often != numerics:
                error = max(
                    error, _of_each(scene, module, coarse | {"relax_every": numerics["relax_every"]}, last, second)
                )
            if name == "continuum" and coarse and coarse["step"] > numerics["step"]:
                error = max(error, _in_flight(scene, module, other, first, last, second))
            method = f"a second run {how}" + ", relaxed every headway" * (often != numerics)
            if name == "continuum":  # a pair begins with the same rounding, and differs by less than that has grown to
                error = math.hypot(error, grown_from_rounding(scene, last.road_height))
    high, low = float(last.road_height.max()), float(last.road_height.min())
    reach = depth = max(high, -low)
    if name != "cars" or sink_rate(scene):  # the mean level is kept apart, and only the sample rounds at its depth
        reach = min(depth, 1.0 + high - low)
    rounding = EPS * (depth + reach * math.sqrt(last.updates / last.road_height.size))
    if max(size, 0.1 * error) <= rounding:
        return 0.0, "none: the road is flat to rounding"
    return float((error + rounding) / max(size, rounding)), method


def steps_stay(scene, nodes: int) -> bool:
    """Whether diffusion is too little to smooth the shortest wave of a grid, to a part in e, in all of the duration."""
    law = scene.road.diffusivity
    return isinstance(law, Constant) and law.value * scene.duration * (np.pi * nodes / scene.road.length) ** 2 < 1


def _of_each(scene, module, coarse, last, often) -> float:
    """Root mean square error of the grid and of the interval, each by itself, by a third run: the two may cancel."""
    *_, third = module.samples(scene, np.array([0.0, last.time]), coarse)
    return _distance(last.road_height, third.road_height) + _distance(third.road_height, often.road_height)


def _in_flight(scene, module, other, first, last, second) -> float:
    """Root mean square error of a run of the continuum whose cars fly at its start or end, by two others; else 0."""
    if not scene.lift_off or min(first.contact_force.min(), last.contact_force.min()) > LEAVING:
        return 0.0
    error = _distance(last.road_height, second.road_height) / IN_FLIGHT
    longer = other | {"step": 2 * other["step"]}
    if longer["step"] >= module.longest_step(scene, longer):
        return error
    *_, third = module.samples(scene, np.array([0.0, last.time]), longer)
    return max(error, _distance(last.road_height, third.road_height) / FOURFOLD)


def _relaxes(scene) -> bool:
    law = scene.road.diffusivity
    return not isinstance(law, Constant) or law.value > 0


def _settles(scene, numerics, last) -> bool:
    """Whether a linear run is of so many intervals, not too long, that what growth rates do not tell is little: how the
    waves that it begins with become those that the scheme has."""
    every = numerics["relax_every"]
    return every <= SELDOMEST and last.time >= INTERVALS * every * scene.headway_time


def _is_linear(scene, numerics, last):
    laws = scene.road.softness, scene.road.diffusivity
    if (scene.lift_off and last.airborne) or not all(isinstance(law, Constant) for law in laws):
        return False
    if not any(law.value for law in laws):
        return False  # nothing changes such a road: all its waves have one rate, and none a shape of its own
    if scene.fleet.start != "settled":
        return False  # before they settle, cars leave steps at every headway of each wave, which its growth rate does not know
    if 2 * scene.road.profile.highest_wave(scene.road.length) >= scene.fleet.count:
        return False  # waves that the cars take for longer ones
    few = numerics["nodes"] <= MOST_ROWS * scene.fleet.count
    if not few or even_start(scene, numerics["nodes"]) is None:
        return False
    return all(_has_one_rate(scene, n + 1, last.time) for n in _strongest(scene, last)[1])


def _has_one_rate(scene, number, time) -> bool:
    """Whether the wave with so many periods a length, its cars settled at the start, is by then what its fastest rate makes
    of it, in the continuum: the fastest may be that at which cars swing, who have not swung so far."""
    fleet, length = scene.fleet, scene.road.length
    laws = {"softness": scene.road.softness.value, "diffusivity": scene.road.diffusivity.value}
    matrix = mode_matrix(2 * np.pi / length * number, fleet, **laws)
    car = (float(fleet.per_car(name)[0]) for name in ("speed", "frequency", "damping"))
    try:
        Z, P = settled_waves(np.ones(1), np.array([number]), length, *car)
    except SceneError:  # a wave of rounding at the resonance of cars without damping
        return False
    rate, shape, inverse = (values[0] for values in eigenvectors(matrix[None]))
    with np.errstate(all="ignore"):
        part = shape[0] * (inverse @ np.concatenate((np.ones(1), Z, P))) * np.exp(rate * time)
    fastest = part[np.argmax(rate.real)]
    return bool(abs(part.sum() - fastest) < OTHERS * abs(fastest))


def _compared(count: int, numerics: dict) -> dict:
    """Numerics of the scheme by whose difference errors are known: of twice the rows, or where that would be costly half."""
    if numerics["nodes"] <= FINE_ROWS * count:
        return {"nodes": 2 * numerics["nodes"], "hold": 5, "relax_every": 1}
    return {**numerics, "nodes": count * (numerics["nodes"] // count // 2)}


def _strongest(scene, last):
    """Root mean square of each wave of the road, from one period a length on, and the places of the strongest among them."""
    # of length two headways and more; shorter ones are the ripple of these and of the uniform road
    wave = np.abs(np.fft.rfft(last.road_height))[1 : (scene.fleet.count + 1) // 2] * (
        np.sqrt(2) / last.road_height.size
    )
    strongest = np.argsort(wave)[::-1][:STRONGEST]
    enough = np.searchsorted(np.cumsum(wave[strongest] ** 2), SHARE * np.sum(wave**2)) + 1
    return wave, strongest[: enough if wave.any() else 0]


def _of_waves(scene, numerics, other, last) -> float:
    """Root mean square difference of the road by the growth rates of its strongest waves in two schemes."""
    wave, strongest = _strongest(scene, last)
    if not strongest.size:
        return 0.0
    k = 2 * np.pi * (strongest + 1) / scene.road.length
    error = 0.0
    modes = zip(strongest, *(floquet_modes(scene, k, **p) for p in (numerics, other)), strict=True)
    for n, (sigma, shape), (finer_sigma, finer_shape) in modes:
        grown = abs(np.expm1((sigma - finer_sigma) * last.time))
        # the wave's own ripple, with steps at the wheels as well: first order in the grid
        rippled = 2 * np.linalg.norm(_of_length(shape, finer_shape.size) - finer_shape)
        error += wave[n] ** 2 * (grown**2 + rippled**2)
    share = np.sum(wave[strongest] ** 2) / np.sum(wave**2)
    return float(np.sqrt(error / share))


def _of_length(shape, size):
    """Components in the order of a transform, short waves added as zeros or left out."""
    kept = (min(shape.size, size) - 1) // 2
    out = np.zeros(size, dtype=complex)
    out[: kept + 1] = shape[: kept + 1]
    if kept:
        out[-kept:] = shape[-kept:]
    return out


def _of_ripple(scene, numerics, other, last) -> float:
    """The same of the ripple, first order in the grid since the wheel rolls down a step."""
    count = scene.fleet.count
    fleet = {name: float(scene.fleet.per_car(name)[0]) for name in ("damping", "speed", "frequency", "mass")}
    one = replace(
        scene,
        road=Road(scene.headway, scene.road.softness, scene.road.diffusivity),
        fleet=Fleet(1, **fleet, start=scene.fleet.start),
    )
    roads = []
    for scheme in (numerics, other):
        scheme = {**scheme, "nodes": scheme["nodes"] // count}
        *_, final = model("cars").samples(one, np.array([0.0, last.time]), scheme)
        roads.append(final.road_height)
    return 2 * _distance(*roads)


def _distance(height: np.ndarray, other: np.ndarray) -> float:
    """Root mean square difference of two roads of the same ring on any two grids, mean removed."""
    if height.size < other.size:
        height, other = other, height
    if height.size <= SHORT:
        return apart(height, other)
    a, b = (np.fft.rfft(h)[1:] * (np.sqrt(2) / h.size) for h in (height, other))
    a[: b.size] -= b
    return float(np.linalg.norm(a))


def corrugation_difference(height: np.ndarray, other: np.ndarray) -> float:
    """Difference of two roads of the same ring on any two grids, mean removed, relative to the first."""
    return _distance(height, other) / _distance(height, np.zeros(1))
