"""One wavelength of even cars on their road with every piece exchangeable, and what each piece costs: for work_precision.

What a run costs is counted, not timed: passages times the measured cost of one, plus relaxations times the measured cost
of one on its grid, as on a long road. Both are the best of several CPU times of compiled loops (the exact relaxation:
scipy's transforms).
"""

from functools import cache
from time import process_time

import numpy as np
from scipy import fft

from traffic_road.schemes.oscillator import propagator, settled
from traffic_road.schemes.relaxation import RELAXATIONS, relax_transform
from traffic_road.schemes.ring_kernel import cross_headway, implicit_factors, relax_explicit, solve_implicit

EIGHTHS = (5, 6, 7, 8)  # of the duration, when roads are looked at
POINTS = 32  # places a wavelength that every grid has, where roads are compared
REPEATS = 7
WARM = 0.05  # seconds
LONG = 16_384  # nodes of the road on which relaxations are timed


def best(call, repeats: int = REPEATS, patience: float = np.inf):
    """The shortest CPU time of `repeats` calls after a warm-up, what the last returned, and how many were timed.

    A warm-up of 50 ms or more counts among them: nothing of it is the warming. No call after `patience` seconds in all.
    """
    times = []
    while len(times) < repeats + 1:
        begin = process_time()
        result = call()
        times.append(process_time() - begin)
        if sum(times) > patience or (times[0] > WARM and len(times) == repeats):
            break
    timed = times if times[0] > WARM else times[1:]
    return min(timed), result, len(timed)


def run(
    scene, coefficients, rows: int, relaxation: str = "exact", interval: int = 1, parts: int = 1, from_before=False
):
    """Road after five to eight EIGHTHS of the time, (4, nodes), and the numbers of passages and of relaxation steps.

    coefficients: (A, B) of a stepper. The road relaxes every `interval` headways in `parts` steps, half of it before and
    after each sample.
    """
    A, B = map(np.ascontiguousarray, coefficients)  # in one order in memory: `cross_headway` is compiled once
    cars, hold, length = scene.fleet.count, B.shape[1] - 1, scene.road.length
    nodes, alpha = cars * rows, scene.road.softness
    height = scene.road.profile.sample(length, nodes)
    Z, P = (
        y[::rows].copy() for y in settled(height, length, 1.0, 1.0, scene.fleet.damping, float(alpha(height.mean())))
    )
    held = np.zeros((rows + hold, cars))
    for q in range(hold):
        held[hold - 1 - q] = height[(np.arange(cars) * rows - q) % nodes]
    diffusion = scene.road.diffusivity.value * interval * scene.headway_time
    step = RELAXATIONS[relaxation].step
    whole, half = (step(share * diffusion / parts, length, nodes) ** parts for share in (1.0, 0.5))

    def relax(road, factor):
        return np.ascontiguousarray(relax_transform(road.T.ravel(), factor).reshape(cars, rows).T)

    road = np.ascontiguousarray(np.roll(height, -1).reshape(cars, rows).T)
    blocks = round(scene.duration / scene.headway / interval)
    samples = [blocks * eighth // 8 for eighth in EIGHTHS]
    roads = []
    with np.errstate(all="ignore"):
        for block in range(blocks):
            road = relax(road, half if block in (0, *samples) else whole)
            for _ in range(interval):
                cross_headway(road, Z, P, held, A, B, scene.headway / 2, alpha.kernel, from_before, scene.lift_off)
            if block + 1 in samples:
                road = relax(road, half)
                roads.append(np.roll(road.T.ravel(), 1))
    return np.array(roads), blocks * interval * nodes, (blocks + len(samples)) * parts


@cache
def cost_of_passage(hold: int, law: tuple, from_before: bool, repeats: int = REPEATS) -> float:
    """Seconds, on a ring of 64 cars and 64 nodes a headway, all in contact."""
    rows = cars = 64
    A, B = (np.ascontiguousarray(c[0]) for c in propagator(0.1, 1.0, 0.1, hold))
    road = 1e-3 * np.random.default_rng(0).standard_normal((rows, cars))
    Z, P, held = np.zeros(cars), np.zeros(cars), np.zeros((rows + hold, cars))

    def call():
        for _ in range(20):
            cross_headway(road, Z, P, held, A, B, 0.4, law, from_before, False)

    return best(call, 5 * repeats)[0] / (20 * rows * cars)


@cache
def cost_of_relaxation(name: str, nodes: int, repeats: int = REPEATS) -> float:
    """Seconds of one step on `nodes` of a long road: LONG nodes or a little more, so that no call's overhead counts."""
    copies = -(-LONG // nodes)
    seconds = _relaxation_on(name, copies * nodes, repeats)
    return seconds / copies


def _relaxation_on(name, nodes, repeats):
    height = np.random.default_rng(0).standard_normal(nodes)
    factors, factor = implicit_factors(nodes, 1.0), np.full(nodes // 2 + 1, 0.5)
    pieces = {
        "explicit": [lambda: relax_explicit(height, 0.1)],
        "backward Euler": [lambda: solve_implicit(height, 1.0, *factors)],
        "exact": [lambda: fft.irfft(fft.rfft(height) * factor, n=nodes)],
    }
    pieces["Crank-Nicolson"] = pieces["explicit"] + pieces["backward Euler"]
    return best(lambda: [piece() for piece in pieces[name]], repeats)[0]


def at_points(height: np.ndarray, points: int = POINTS) -> np.ndarray:
    """A road on any grid of the wavelength at x = j length/points, along the last axis: its nodes, or its Fourier series."""
    nodes = height.shape[-1]
    if nodes % points == 0:
        return height[..., :: nodes // points]
    wave = np.fft.rfft(height, norm="forward")
    if nodes % 2 == 0:
        wave[..., -1] /= 2
    turn = np.exp(2j * np.pi * np.outer(np.arange(wave.shape[-1]), np.arange(points)) / points)
    weight = np.full(wave.shape[-1], 2.0)
    weight[0] = 1.0
    return ((wave * weight) @ turn).real


def difference(height: np.ndarray, reference: np.ndarray) -> float:
    """L2 of two roads at the same points, means removed, relative to the second."""
    a, b = (h - h.mean() for h in (height, reference))
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def rate(roads: np.ndarray, apart: float, sigma: complex, others) -> complex:
    """Growth rate of the longest wave from four roads, (4, nodes), at times `apart`; sigma: that within pi/apart.

    others: those of the two other modes that this wave has, in which cars ring as exp(-Gamma t): with Gamma = 0.02 that
    is still seen after hundreds of times. w(t + apart) - exp(other apart) w(t) is without them.
    """
    wave = np.fft.rfft(roads)[:, 1]
    for other in others:
        wave = wave[1:] - np.exp(other * apart) * wave[:-1]
    return sigma + np.log(wave[1] / wave[0] * np.exp(-sigma * apart)) / apart
