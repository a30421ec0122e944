"""Fleets that are not even, for `benchmark.py`: random headways with cars of their own, and cars that overtake."""

import numpy as np

import traffic_road as tr

K, SOFTNESS, DIFFUSIVITY, ROWS = 0.9, 0.006, 0.01, 32
HEADWAY = 2 * np.pi / K / 8


def mixed_cases(cars: int, headways: int, seed=0):
    """(label, scene, numerics of the cars model) of each case: `cars` at 8 a wavelength, 32 nodes a mean headway."""
    draw = np.random.default_rng(seed)
    length = HEADWAY * cars
    own = {
        "position": tuple(draw.uniform(0.0, length, cars)),
        "damping": tuple(draw.uniform(0.1, 0.3, cars)),
        "frequency": tuple(draw.uniform(0.8, 1.2, cars)),
        "mass": tuple(draw.uniform(0.5, 1.5, cars)),
    }
    speeds = tuple(draw.uniform(0.8, 1.2, cars))
    for label, diffusivity, fleet in (
        ("random headways, per-car coefficients", 0.0, tr.Fleet(cars, **own)),
        ("the same, relaxation every headway", DIFFUSIVITY, tr.Fleet(cars, **own)),
        ("mixed speeds, 0.8 to 1.2", 0.0, tr.Fleet(cars, speed=speeds, **own)),
        ("the same, relaxation every headway", DIFFUSIVITY, tr.Fleet(cars, speed=speeds, **own)),
    ):
        road = tr.Road(length, SOFTNESS, diffusivity, tr.Sine(0.1, K))
        scene = tr.Scene(road, fleet, duration=headways * HEADWAY)
        yield label, scene, {"nodes": ROWS * cars, "hold": 1, "relax_every": 1}
