"""How fast cars cross nodes: car-node updates a second through `simulate`, beside a bare loop in the same run.

The bare loop is the linear hold's arithmetic alone, plain numba over contiguous arrays: no lift-off, no relaxation, no
sampling. Each figure is the best of several runs after a warm-up, one thread; the error estimate of the run stands beside
its speed. Even fleet of 4096 cars, 8 a wavelength, 32 nodes a headway, k = 0.9, alpha = 0.006, Gamma = 0.1.

Run: python experiments/benchmark.py [--quick]        (about 50 s; 6 s)
"""

import time

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure
from numba import njit

import traffic_road as tr
from traffic_road.plots import BLUE, ORANGE, RED
from traffic_road.schemes.oscillator import propagator

K, SOFTNESS, DAMPING, DIFFUSIVITY, ROWS = 0.9, 0.006, 0.1, 0.01, 32
HEADWAY = 2 * np.pi / K / 8
CASES = (  # label, hold, diffusivity, relax_every, law
    ("hold 1, no relaxation", 1, 0.0, 1, SOFTNESS),
    ("hold 3, no relaxation", 3, 0.0, 1, SOFTNESS),
    ("hold 5, no relaxation", 5, 0.0, 1, SOFTNESS),
    ("hold 1, relaxation every headway", 1, DIFFUSIVITY, 1, SOFTNESS),
    ("hold 3, relaxation every headway", 3, DIFFUSIVITY, 1, SOFTNESS),
    ("hold 3, relaxation every 2nd", 3, DIFFUSIVITY, 2, SOFTNESS),
    ("hold 3, exponential law", 3, 0.0, 1, tr.Exponential(SOFTNESS, 0.1)),
)


@njit(error_model="numpy", fastmath={"contract"})
def bare(road, Z, P, h, A, B, push, scale):
    a00, a01, a10, a11 = A[0, 0], A[0, 1], A[1, 0], A[1, 1]
    b0, b1, c0, c1 = B[0, 0], B[0, 1], B[1, 0], B[1, 1]
    for r in range(road.shape[0]):
        row = road[r]
        for i in range(row.size):
            z = a00 * Z[i] + a01 * P[i] + b1 * h[i]
            p = a10 * Z[i] + a11 * P[i] + c1 * h[i]
            before = row[i]
            contact = (before - push * (1.0 - z)) * scale
            row[i] = 2.0 * contact - before
            Z[i] = z + b0 * contact
            P[i] = p + c0 * contact
            h[i] = contact


def bare_rate(cars: int, repeats: int) -> float:
    A, B = (c[0] for c in propagator(HEADWAY / ROWS, 1.0, DAMPING, 1))
    push = 0.5 * SOFTNESS * HEADWAY
    road = 1e-3 * np.random.default_rng(0).standard_normal((ROWS, cars))
    Z, P, h = np.zeros((3, cars))
    best = np.inf
    for _ in range(40 * repeats):
        begin = time.perf_counter()
        bare(road, Z, P, h, A, B, push, 1 / (1 + push * (1 - B[0, 0])))
        best = min(best, time.perf_counter() - begin)
    return ROWS * cars / best


def run(cars: int, headways: int, hold, diffusivity, relax_every, law) -> xr.Dataset:
    road = tr.Road(HEADWAY * cars, law, diffusivity, tr.Sine(0.1, K))
    scene = tr.Scene(road, tr.Fleet(cars, DAMPING), duration=headways * HEADWAY)
    return tr.simulate(scene, "cars", samples=2, nodes=ROWS * cars, hold=hold, relax_every=relax_every, progress=False)


def main() -> None:
    chosen = options(__doc__)
    cars, headways, repeats = (256, 40, 2) if chosen.quick else (4096, 2000, 5)
    reference = bare_rate(cars, repeats)
    rates, errors = [], []
    for label, *case in CASES:
        run(cars, 4, *case)
        # long enough that the fixed cost of a run is lost in it; the exponential law, solved car by car, takes its time
        length = headways if isinstance(case[-1], float) else headways // 10
        results = [run(cars, length, *case) for _ in range(repeats)]
        rates.append(max(ds.updates / ds.wall_time for ds in results))
        errors.append(results[0].error_estimate)
        print(
            f"{label:<34} {rates[-1]:.3g} updates/s, {rates[-1] / reference:.2f} of the bare loop, error {errors[-1]:.1e}"
        )
    print(f"{'bare loop':<34} {reference:.3g} updates/s")
    ds = xr.Dataset(
        {
            "rate": ("case", rates, {"long_name": "car-node updates a second", "units": "s-1"}),
            "ratio": (
                "case",
                np.array(rates) / reference,
                {"long_name": "rate over that of the bare loop", "units": "1"},
            ),
            "error": ("case", errors, {"long_name": "error estimate of the corrugation", "units": "1"}),
        },
        {"case": ("case", np.array([label for label, *_ in CASES]), {"long_name": "what was run"})},
        {"Conventions": "CF-1.11", "title": "Speed of the cars model", "bare_rate": reference, "cars": cars},
    )
    store("benchmark", chosen.output, ds, draw(ds))
    assert np.all(np.isfinite(ds.error)) and float(ds.error.max()) < 0.1, ds.error.values


def draw(ds) -> Figure:
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    place = np.arange(ds.case.size)[::-1]
    left.barh(place, ds.rate / 1e6, color=BLUE)
    left.axvline(ds.attrs["bare_rate"] / 1e6, color=RED, ls="--", label="bare loop, hold 1")
    left.set_yticks(place, ds.case.values)
    left.set(xlabel="million car-node updates a second", title=f"Speed on one core, {ds.attrs['cars']} cars")
    left.legend(frameon=False, loc="lower center")
    right.plot(ds.error, place, "o", color=ORANGE)
    right.set(xscale="log", xlabel="relative error estimate", title="and the error beside it")
    right.grid(axis="x", lw=0.4)
    return figure


if __name__ == "__main__":
    main()
