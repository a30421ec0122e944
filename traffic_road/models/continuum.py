"""The continuum of cars and road, Eqs. (4)-(5) of Both, Hong and Kurtze, *Corrugation of Roads*: fields on a ring.

For every kind of car (speed u, frequency omega, damping Gamma, mass m), in first-order form, free of road derivatives,

    (d/dt + u d/dx) Z = P - 2 Gamma omega (Z - H)
    (d/dt + u d/dx) P = -omega^2 (Z - H)
    dH/dt = Delta(H) d2H/dx2 - alpha(H) < m max(0, 1 + omega^2 (H - Z)) >,        < > the mean over the cars.

Fourier in x. The state of a wave is H, then Y = Z - H and P of each kind: with Y instead of Z nothing that acts on the
road depends on how far it has sunk, and precision stays. With alpha and Delta frozen at reference values, and without
the clip, the system of each wave is linear and small; `schemes.exponential` solves it exactly and steps what is left,

    N = (Delta(H) - Delta_ref) d2H/dx2 - (alpha(H) - alpha_ref) < m (1 - omega^2 Y) >
        - alpha(H) < m max(0, omega^2 Y - 1) >,

truncated. N is formed on a grid four times as fine. On few nodes the clip is exact, from the places where cars take off
and land (`continuum_clip`); on many it is taken on that grid, an error of order 2 in its spacing. N is constant where
the laws are and no car is airborne: where that is certain for a whole sample interval, one matrix exponential leads over
it, and there are no steps. Else the error of a step is of order 4, or about 2 with the clip on many nodes.
alpha_ref is the softness at the mean height. Delta_ref is the largest Delta on the road, because a remainder that takes
diffusion back is stable and one that adds more than two thirds of the reference is not. Both are renewed after a drift
of 10 %.
"""

from __future__ import annotations

import math
from functools import lru_cache
from time import perf_counter

import numpy as np
from numpy.fft import rfft  # less overhead a call than scipy.fft on the short transforms of one wave

from ..errors import SceneError, StabilityError
from ..laws import finite
from ..memory import refuse_beyond_memory
from ..schemes.exponential import SAFE, step_limit
from . import Breath, Pace, Sample
from .continuum_kernels import longest_taken
from .continuum_state import EPS, Continuum, Kinds, constant, linear_throughout, modes, start

KEYWORDS = ("nodes", "step")
RESOLVED = 0.625  # of `resolving`: a grid with room for that wave, and a quarter more
PAIR_RATIO = 2.0  # a pair of runs differs by 3 times the error of the better one at order 2, by more at order 4
# When, in steps, the first of them end, and how long these are: cars that fly from the start swing about their way through
# the air, by their own frequency, until their damping has ended that; the steps that follow need to resolve it no more.
BEGINNING = (0.5, 0.125), (1.5, 0.25), (3.5, 0.5)
LONG_STEP = 8  # default steps: in longer ones cars take off and land, and longer still say too little of their error
FEWER = 0.6  # of the nodes has a run that is compared with: where cars fly its error is 5 times as large, by its order of 3.3
MOST = 0.7  # of the nodes that it may have where the profile needs more
MANY = 0.75  # of the nodes that a run of half the step has: an error of the grid 2.6 times as large
LARGEST = 2e9  # multiplications in one product of all matrices: about a minute for a rebuild
MOST_STEPS = 1e10
MOST_WAVES = 64  # that are looked at for the longest step
FIRST_BATCH = 4096  # nodes' steps taken at a time, at first
LONGEST_BATCH = 0.05  # seconds within which that is doubled
MOST_KEPT = 1 << 16  # numbers of the states that are kept for samples to come
FIRST_REACH = 16  # samples that are looked at to be taken together, at first; twice as many if they can be


def numerics(scene, given: dict) -> dict:
    """`nodes` (road nodes) and `step` (longest time step, default 0.5/omega of the quickest car), with defaults filled in.

    The default of `nodes` is 16 a wave for a profile of one wave (room for seven harmonics), 4 for the shortest wave of
    any other, at least 32 and what `resolving` says; where harmonics cannot arise (constant laws, lift_off=False), what
    the profile needs and at least 16.
    SceneError: an unknown keyword, a value out of range, nodes that do not resolve the profile, more work than can be
    done, laws that overflow, an undamped car in resonance with the road it is to be settled on. StabilityError: a step
    beyond `longest_step`.
    """
    chosen = unstable_numerics(scene, given)
    limit = longest_step(scene, chosen)
    if chosen["step"] >= limit:
        raise StabilityError(
            f"step = {chosen['step']:g}: with cars in the air half the time the road blows up from {limit:.4g} on; "
            "use a shorter step"
        )
    return chosen


def unstable_numerics(scene, given: dict) -> dict:
    """As `numerics`, and no StabilityError."""
    unknown = sorted(set(given) - set(KEYWORDS))
    if unknown:
        raise SceneError(f"unknown keyword {unknown[0]!r} for the continuum; allowed are {', '.join(KEYWORDS)}")
    step = finite("step", given["step"] if "step" in given else default_step(scene), above=0)
    if scene.duration / step > MOST_STEPS:
        raise SceneError(
            f"step = {step:g}: more than {MOST_STEPS:.0e} steps in a duration of {scene.duration:g}; use a longer step"
        )
    nodes = given["nodes"] if "nodes" in given else _default_nodes(scene)
    if isinstance(nodes, (bool, np.bool_)) or not isinstance(nodes, (int, np.integer)) or nodes < 1:
        raise SceneError(f"nodes = {nodes!r}: must be a whole number >= {_least_nodes(scene)} for this profile")
    nodes, kinds = int(nodes), Kinds.of(scene.fleet)
    if modes(nodes) * (2 * len(kinds.speed) + 4) ** 3 > LARGEST:
        raise SceneError(
            f"nodes = {nodes} with {len(kinds.speed)} distinct kinds of car: too large for the continuum; "
            f"use fewer of either, or model='cars'"
        )
    size = 2 * len(kinds.speed) + 4  # four complex matrices a wave at most
    refuse_beyond_memory(4 * nodes * size**2, f"nodes = {nodes}", "use fewer nodes or a shorter ring")
    begin = start(scene, nodes)
    if nodes % 2 == 0 and begin.highest == nodes // 2:  # its motion cannot be told
        raise SceneError(f"nodes = {nodes}: the profile has {nodes // 2} waves on the ring; use nodes >= {nodes + 1}")
    if not begin.finite:
        raise SceneError(
            f"Road: softness {begin.alpha:g} and diffusivity {begin.delta:g} at the start are too large; "
            f"use a lower value or hardening, or a lower profile"
        )
    return {"nodes": nodes, "step": step}


def longest_step(scene, numerics: dict) -> float:
    """The step from which on a high wave grows that should decay, or twice as fast as it should; inf if not below
    `numerics["step"]`.

    However high it gets, a wave is clipped half the time: the remainder takes back half of what contact does (the same
    half by which the saturation limit is twice the neutral softness). This is exact but for harmonics, which move it by
    tenths; lower waves, clipped less, have no lower limit.
    """
    step, nodes = numerics["step"], numerics["nodes"]
    if not scene.lift_off or linear_throughout(scene, nodes, scene.duration):
        return np.inf
    begin = start(scene, nodes)
    if step * 0.5 * begin.alpha * float(begin.kinds.weight @ begin.kinds.square) < SAFE:  # the rate at which that acts
        return np.inf
    system, source = begin.linear
    cars = slice(1, 1 + len(begin.kinds.speed))
    row = np.zeros(system.shape[:2], dtype=complex)
    row[:, cars] = -0.5 * system[:, 0, cars]
    # waves that cars answer to, and no more than tell where the limit is
    longest = max(2, np.count_nonzero(begin.k <= 3 * begin.kinds.quickest))
    some = np.unique(np.linspace(0, min(longest, begin.k.size) - 1, MOST_WAVES).astype(int))
    return step_limit(system[some], source, row[some], step)


def default_step(scene) -> float:
    """0.5/omega of the quickest car."""
    return 0.5 / float(Kinds.of(scene.fleet).frequency.max())


def resolving(scene) -> int:
    """Nodes that give four to the shortest wave that cars answer to, 2 pi u/omega: on fewer than two, bouncing is lost."""
    return math.ceil(4 * scene.road.length * Kinds.of(scene.fleet).quickest / (2 * np.pi))


def coarser(scene, numerics: dict) -> dict | None:
    """A cheaper run to compare with: fewer nodes, as many as the profile needs, and twice the step.

    Half of it where steps are too long for any order, and twice would say too little. None where fewer nodes would: both
    grids miss what cars answer to, the profile needs nearly all the nodes, or both hold as many harmonics of its waves, all
    of which are multiples of one; and where the run ends before it has come to its full step: a finer one is cheap, too.
    The step may be beyond `longest_step`: half of it is as wrong as that run tells, where a finer one would say too little.
    """
    step = numerics["step"]
    if scene.duration < BEGINNING[-1][0] * step:
        return None
    long = step > LONG_STEP * default_step(scene)
    fewer, most = (MANY, MANY) if long else (FEWER, MOST)
    begin = start(scene, numerics["nodes"])
    nodes = max(int(fewer * numerics["nodes"]), 2 * begin.highest + 1)
    blind = (modes(nodes) - 1) // begin.base == (modes(numerics["nodes"]) - 1) // begin.base
    if blind or numerics["nodes"] < RESOLVED * resolving(scene) or nodes > most * numerics["nodes"]:
        return None
    return {"nodes": nodes, "step": step / 2 if long else 2 * step}


def finer(scene, numerics: dict, given: dict) -> dict:
    """Half the step and twice the nodes, and no fewer than `resolving`, but for what was given."""
    finest = {"nodes": max(2 * numerics["nodes"], resolving(scene)), "step": numerics["step"] / 2}
    return numerics | {name: value for name, value in finest.items() if name not in given}


def fitted(times, numerics: dict) -> dict:
    """With the longest `step` that is taken where equal ones lead from one sample to the next, shorter ones from the start."""
    # a copy: compiled anew for every kind of array, read-only or strided
    longest = longest_taken(np.array(times, dtype=float), numerics["step"], BEGINNING[-1][0])
    return numerics | {"step": longest} if longest < (1 - 1e-9) * numerics["step"] else numerics


def stage(now: float, time: float, step: float, unit: float) -> tuple[float, int]:
    """Until when equal steps lead, `time` at most, and how many: the fewest that are no longer than `step` or, at the start
    of a run, than shares of it, but for rounding. unit: what BEGINNING counts in, the `step` of the run or of that which it
    is compared with."""
    for end, share in BEGINNING:
        if now < (1 - 1e-9) * end * unit:
            if time > (1 + 1e-9) * end * unit:
                time = end * unit
            step *= share
            break
    return time, max(1, math.ceil((time - now) / step * (1 - 1e-12)))


def sample_times(scene, times, numerics: dict) -> np.ndarray:
    """Samples are taken at exactly the times asked for."""
    return np.asarray(times, dtype=float)


def samples(scene, times, numerics: dict, state: dict | None = None):
    """Yield a Sample at each of `times` (increasing, from 0); fields on x = j length/nodes, shape (nodes,).

    With several kinds of car `car_height` is the mean over the cars and `contact_force` the mean of mass times force.
    Equal steps, none longer than `step`, lead from one sample to the next, shorter ones from the start (BEGINNING); they
    are counted, but taken all in one where that is exact. An overflowed state is yielded as it is. Between samples a
    Breath, see `models`; `state` is that of one.
    """
    times, continuum = np.asarray(times, dtype=float), Continuum(scene, numerics["nodes"])
    always_linear = linear_throughout(scene, numerics["nodes"], float(times[-1]))

    def leave():
        return {"taken": taken, "until": until, "updates": updates, "left": left, "length": length} | continuum.leave()

    def heights():
        return continuum.fields(continuum.now())[0, 0]

    unit = numerics.get("unit", numerics["step"])
    taken = updates = left = 0  # left: of the equal steps that lead to the time `until`
    until = length = 0.0
    if state is not None:
        taken, until, updates, left, length = (state[k] for k in ("taken", "until", "updates", "left", "length"))
        continuum.take_up(state)
    pace, batch, reach = Pace(), max(1, FIRST_BATCH // numerics["nodes"]), FIRST_REACH
    while taken < len(times):
        time, now, before, record, together = float(times[taken]), until - left * length, updates, None, 1
        many = 1  # samples that may be taken together: equal steps have begun, and the next is as far away
        if not left and now >= (1 - 1e-9) * BEGINNING[-1][0] * unit and _equal(times[taken - 1 : taken + 2]):
            many = max(1, min(reach, MOST_KEPT // continuum.state.size))
        # not asked again for the whole run
        if not left and (always_linear or (0 < time - now < times[-1] and continuum.stays_linear(time - now))):
            while until < time:
                until, steps = stage(until, time, numerics["step"], unit)
                updates += steps * numerics["nodes"]
            if time > now:
                length = continuum.as_before(time - now, time)
                if many > 1 and always_linear:
                    together = _alike(times[taken - 1 :], length, 1, many)
                record = continuum.leap(length, together)
        while left or until < time:
            if not left:
                begun = until
                until, left = stage(begun, time, numerics["step"], unit)
                updates += left * numerics["nodes"]
                length = continuum.as_before((until - begun) / left, time / left)
                many = min(many, batch // left)
                if many > 1 and continuum.steady:
                    together = _alike(times[taken - 1 :], length, left, many, numerics["step"])
            begin, some = perf_counter(), min(batch, left)
            record = continuum.advance(length, some, together)
            left -= some
            batch *= 2 if 2 * some * together > batch and perf_counter() - begin < LONGEST_BATCH else 1
            if left and pace.due():
                yield Breath(until - left * length, leave, heights)
        reach = 2 * reach if together == many > 1 else FIRST_REACH
        added, updates = updates - before, before
        for height, car, force in zip(*continuum.fields(continuum.now() if record is None else record), strict=True):
            if until < times[taken]:  # together with the first
                until, steps = stage(until, float(times[taken]), numerics["step"], unit)
                added = steps * numerics["nodes"]
            updates += added
            yield Sample(until, height, car, force, None, updates)
            taken += 1
        if taken < len(times) and pace.due():
            yield Breath(until, leave, heights)


def _equal(times) -> bool:
    """Whether three times are about as far apart; others need not be looked at closely."""
    return len(times) == 3 and abs(times[2] - 2 * times[1] + times[0]) < 1e-9 * times[2]


def _alike(times, length: float, parts: int, most: int, step: float = math.inf) -> int:
    """How many of the intervals between `times`, `most` or less, are led over just as the first is: by as many `parts`, if
    none is longer than `step`, that `Continuum.as_before` takes for `length`."""
    times = times[: most + 1]
    gaps = np.diff(times)
    alike = np.abs(gaps / parts - length) <= 8 * EPS * (times[1:] / parts)
    if step < math.inf:
        alike &= np.maximum(1, np.ceil(gaps / step * (1 - 1e-12))) == parts
    return alike.size if alike.all() else max(1, int(alike.argmin()))


@lru_cache(maxsize=4)
def _highest_wave(scene) -> int:
    """Waves on the ring of the shortest wave that the profile really has."""
    length, profile = scene.road.length, scene.road.profile
    wave = np.abs(rfft(profile.sample(length, 2 * profile.highest_wave(length) + 3), norm="forward"))
    return int(np.flatnonzero(wave >= 1e-14 * wave.max())[-1]) if wave.max() > 0 else 0


def _least_nodes(scene) -> int:
    return 2 * _highest_wave(scene) + 1


def _default_nodes(scene) -> int:
    road, waves = scene.road, _highest_wave(scene)
    if constant(road) and not scene.lift_off:
        return max(16, 2 * waves + 2)
    wave = np.abs(rfft(road.profile.sample(road.length, 2 * waves + 1))[1:])
    single = np.count_nonzero(wave > 1e-14 * wave.max(initial=0)) == 1
    nodes = max(32, (16 if single else 4) * waves)
    least = resolving(scene)
    return nodes if nodes >= least or linear_throughout(scene, nodes, scene.duration) else least
