"""How fast cars cross nodes: car-node updates a second through the cars model, beside a bare loop in the same run.

The bare loop is the arithmetic of the linear hold alone, plain numba over contiguous, aligned arrays: no lift-off, no
relaxation, no sampling. Each rate is that of the second of two samples (what a run costs before its first step is left
out), the best of several, each next to a bare loop of its own; 8 cars a wavelength, k = 0.9, alpha = 0.006, Gamma = 0.1,
Delta = 0.01, and fleets that are not even from `mixed_cases`. What relaxing less often adds to sigma(k = 0.9) is told by
the Floquet matrix.
Bars are what the kernels are held to.

Run: python experiments/benchmark.py [--quick]        (4 to 6 min, as the machine is busy; 10 s)
"""

import time
import tracemalloc
from functools import partial

import numba
import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure
from mixed_cases import mixed_cases
from numba import njit, prange

import traffic_road as tr
from traffic_road.models import cars
from traffic_road.models.even_layout import aligned
from traffic_road.plots import BLUE, ORANGE, RED
from traffic_road.schemes.oscillator import propagator

K, SOFTNESS, DAMPING, DIFFUSIVITY, CARS = 0.9, 0.006, 0.1, 0.01, 4096
HEADWAY = 2 * np.pi / K / 8
HARD = tr.Exponential(SOFTNESS, 0.1)
TWICE = 1.7  # bar of two threads, over the case before it with one
CASES = [  # label, bar, threads, cars, nodes a headway, hold, diffusivity, relax_every, softness
    ("hold 1", 1.5, 1, CARS, 32, 1, 0.0, 1, SOFTNESS),
    ("hold 1, 2 threads", TWICE, 2, CARS, 32, 1, 0.0, 1, SOFTNESS),
    ("hold 3", 1.2, 1, CARS, 32, 3, 0.0, 1, SOFTNESS),
    ("hold 5", 0.95, 1, CARS, 32, 5, 0.0, 1, SOFTNESS),
    ("hold 1, a road of 16 MB", 1.0, 1, 16 * CARS, 32, 1, 0.0, 1, SOFTNESS),
    ("hold 1, a road of 32 kB", np.nan, 1, CARS // 32, 32, 1, 0.0, 1, SOFTNESS),
    ("relaxation every 4th headway, hold 1", 0.65, 1, CARS, 32, 1, DIFFUSIVITY, 4, SOFTNESS),
    ("the same, 2 threads", TWICE, 2, CARS, 32, 1, DIFFUSIVITY, 4, SOFTNESS),
    ("relaxation every 4th, hold 3, 8 nodes", 0.5, 1, CARS, 8, 3, DIFFUSIVITY, 4, SOFTNESS),
    ("the same, 2 threads", TWICE, 2, CARS, 8, 3, DIFFUSIVITY, 4, SOFTNESS),
    ("relaxation every headway, hold 1", np.nan, 1, CARS, 32, 1, DIFFUSIVITY, 1, SOFTNESS),
    ("relaxation every headway, hold 3, 8 nodes", np.nan, 1, CARS, 8, 3, DIFFUSIVITY, 1, SOFTNESS),
    ("exponential law, hold 1", 0.3, 1, CARS, 32, 1, 0.0, 1, HARD),
    ("exponential law, hold 3", 0.3, 1, CARS, 32, 3, 0.0, 1, HARD),
    ("bounded law, hold 3", np.nan, 1, CARS, 32, 3, 0.0, 1, tr.Bounded(SOFTNESS, 30.0)),
]
QUICK = (0, 2, 8, 9)  # of them, in the quick form
LONGEST = 20_000  # headways of a run: without diffusion nothing holds what grows
MIXED_BARS = 0.3, np.nan, 0.1, 0.1
FLEETS = (1, 2, 4, 8, 16, 32, 64)  # of which the fixed cost of a run is told, 256 nodes, and that of a headway
FEW_ROWS, FEW_HOLD, FEW_HEADWAYS = 16, 3, 2000  # of the latter, relaxed every headway
SIZES = (64, 256, 1024, 4096, 16384)  # cars, and
DURATIONS = (100, 1000, 10000)  # headways over which the cost of an update should be flat


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


@njit(error_model="numpy", fastmath={"contract"}, parallel=True)
def bare_side_by_side(road, Z, P, h, A, B, push, scale):
    for n in prange(road.shape[0]):
        bare(road[n], Z[n], P[n], h[n], A, B, push, scale)


def bare_rate(cars: int, repeats: int, threads: int = 1, rows: int = 32) -> float:
    """Updates a second of the bare loop: in each thread on a road of its own."""
    A, B = (c[0] for c in propagator(HEADWAY / rows, 1.0, DAMPING, 1))
    push = 0.5 * SOFTNESS * HEADWAY
    # at the start of cache lines: elsewhere, where numpy may well put them, the loop is up to twice as slow
    road, *car = (aligned(threads * count * cars).reshape(threads, count, cars) for count in (rows, 1, 1, 1))
    road[:] = 1e-3 * np.random.default_rng(0).standard_normal(road.shape)
    state = road, *(values[:, 0] for values in car)
    loop, state = (bare, [values[0] for values in state]) if threads == 1 else (bare_side_by_side, state)
    best = np.inf
    for _ in range(40 * repeats):
        begin = time.perf_counter()
        loop(*state, A, B, push, 1 / (1 + push * (1 - B[0, 0])))
        best = min(best, time.perf_counter() - begin)
    return threads * rows * cars / best


def scene(count, headways, diffusivity, softness):
    length = HEADWAY * count
    road = tr.Road(length, softness, diffusivity, tr.Sine(1e-4, 2 * np.pi * max(1, count // 8) / length))
    return tr.Scene(road, tr.Fleet(count, DAMPING), duration=headways * HEADWAY)


def rate(count, headways, rows, hold, diffusivity, relax_every, softness) -> float:
    """Updates a second between the first sample and the last."""
    case = scene(count, headways, diffusivity, softness)
    return rate_of(case, {"nodes": rows * count, "hold": hold, "relax_every": relax_every})


def rate_of(case, given) -> float:
    numerics = cars.numerics(case, given)
    samples = cars.samples(case, cars.sample_times(case, [0.0, case.duration], numerics), numerics)
    next(samples)
    begin = time.perf_counter()
    *_, last = samples
    return last.updates / (time.perf_counter() - begin)


def runner(updates, count, rows, hold, diffusivity, relax_every, softness):
    """A call that runs a case once, of about so many updates, and gives its rate; compiled already."""
    law = diffusivity, relax_every, softness
    rate(count, 2 * relax_every, rows, hold, *law)
    if isinstance(softness, tr.Exponential):
        updates = min(updates, 3e7)  # before cars take off: passages of many times the load are solved one by one
    headways = max(relax_every, min(LONGEST, int(updates / (rows * count))) // relax_every * relax_every)
    return lambda: rate(count, headways, rows, hold, *law)


def measured(runs: list, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Best rate of each of the (threads, call), and of the bare loop beside it, in as many threads.

    One of each in turn, again and again: what a machine gives changes by the second, and whether its two processors are
    two or share one core may last for several.
    """
    best = np.zeros((2, len(runs)))
    for _ in range(repeats):
        for n, (threads, call) in enumerate(runs):
            numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
            best[:, n] = np.maximum(best[:, n], (call(), bare_rate(CARS, 1, threads)))
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    return best[0], best[1]


def mixed_runs(updates):
    """Labels of the fleets that are not even, and (threads, call) of each."""
    for _, case, given in mixed_cases(CARS, 2):
        rate_of(case, given)  # compiled, or read from the disk
    cases = list(mixed_cases(CARS, max(2, int(0.3 * updates / (32 * CARS)))))
    labels = [label if "same" not in label else f"{cases[n - 1][0]}, relaxed" for n, (label, *_) in enumerate(cases)]
    return labels, [(1, partial(rate_of, case, given)) for _, case, given in cases]


def added_error(rows, hold, diffusivity, relax_every) -> float:
    """What relaxing every `relax_every` headways, not each, adds to sigma(K), relative."""
    if diffusivity == 0 or relax_every == 1:
        return 0.0
    case = scene(8, 100, diffusivity, SOFTNESS)
    every, once = (tr.theory.floquet(case, K, nodes=8 * rows, hold=hold, relax_every=n) for n in (relax_every, 1))
    return abs(every - once) / abs(once)


def fixed_cost(count) -> tuple[float, float]:
    """Seconds of a run of two headways on 256 nodes, and of its error estimate."""
    case = scene(count, 2, DIFFUSIVITY, SOFTNESS)
    runs = [tr.simulate(case, "cars", samples=2, nodes=256, hold=1, progress=False) for _ in range(6)]
    return min(ds.wall_time for ds in runs), min(ds.error_wall_time for ds in runs)


def memory(count, headways) -> float:
    """Most memory between two samples over that of road and cars (Z, P and a contact height of each)."""
    rate(count, 8, 32, 1, DIFFUSIVITY, 4, SOFTNESS)  # compiled: what that takes is not the run's
    case = scene(count, headways, DIFFUSIVITY, SOFTNESS)
    numerics = cars.numerics(case, {"nodes": 32 * count, "hold": 1, "relax_every": 4})
    samples = cars.samples(case, cars.sample_times(case, [0.0, case.duration], numerics), numerics)
    tracemalloc.start()
    first = next(samples)
    del first
    tracemalloc.reset_peak()
    *_, _last = samples
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # the sample itself, handed over, is not the model's
    return (most - 8 * count * 36) / (8 * count * 35)


def main() -> None:
    chosen = options(__doc__)
    updates, repeats = (4e6, 1) if chosen.quick else (6e7, 64)  # short: what a machine gives changes by the second
    sizes, durations = (SIZES[:3], DURATIONS[:2]) if chosen.quick else (SIZES, DURATIONS)
    cases = [CASES[n] for n in QUICK] if chosen.quick else CASES
    runs = [(threads, runner(updates, *case)) for _, _, threads, *case in cases]
    errors = [added_error(rows, hold, *law[:2]) for _, _, _, _, rows, hold, *law in cases]
    bars = [bar for _, bar, *_ in cases]
    labels, threads = [label for label, *_ in cases], [threads for _, _, threads, *_ in cases]
    names, others = mixed_runs(updates)
    rates, bares = measured([*runs, *others], repeats)
    errors = [*errors, *(0.0 for _ in others)]
    bars, labels, threads = [*bars, *MIXED_BARS], [*labels, *names], [*threads, *(1 for _ in others)]
    reference = max(bare for bare, n in zip(bares, threads, strict=True) if n == 1)
    twice = max(bare for bare, n in zip(bares, threads, strict=True) if n == 2) / reference
    ratios = rates / reference
    bars = [bar * ratios[n - 1] if threads[n] == 2 else bar for n, bar in enumerate(bars)]
    for label, bar, found, ratio, error in zip(labels, bars, rates, ratios, errors, strict=True):
        verdict = "" if np.isnan(bar) else f"bar {bar:.2f}, {'met' if ratio >= bar else 'missed'}"
        print(f"{label:<46} {found:.3g} updates/s, {ratio:.2f} of the bare loop, adds {error:.0e} to sigma  {verdict}")
    print(f"{'bare loop':<46} {reference:.3g} updates/s, {twice:.2f} times as many by two on roads of their own")
    fixed = [fixed_cost(count) for count in FLEETS]
    for n, (run, estimate) in zip(FLEETS, fixed, strict=True):
        print(
            f"fixed cost of a run of {n} cars {1e3 * run:.1f} ms (bar 5), of its error estimate {1e3 * estimate:.1f} ms"
        )
    few = [FEW_ROWS, FEW_HOLD, DIFFUSIVITY, 1, SOFTNESS]
    runs = [(1, partial(rate, n, FEW_HEADWAYS, *few)) for n in FLEETS]
    headway = FEW_ROWS * np.array(FLEETS) / measured(runs, 1 if chosen.quick else 8)[0]
    for n, took in zip(FLEETS, headway, strict=True):
        print(
            f"a headway of {n} cars on {FEW_ROWS * n} nodes, hold {FEW_HOLD}, relaxed every headway: {1e6 * took:.2f} us"
        )
    used = [memory(16 * CARS, n) for n in (8, 80)]
    print(f"memory over road and cars: {used[0]:.2f}, ten times as long {used[1]:.2f} (bar 1.5)")
    plain = 32, 1, 0.0, 1, SOFTNESS
    by_size = 1 / measured([(1, runner(updates, n, *plain)) for n in sizes], repeats)[0]
    by_duration = 1 / measured([(1, partial(rate, CARS // 4, n, *plain)) for n in durations], repeats)[0]
    ds = xr.Dataset(
        {
            "rate": ("case", rates, {"long_name": "car-node updates a second", "units": "s-1"}),
            "ratio": ("case", ratios, {"long_name": "rate over that of the bare loop", "units": "1"}),
            "bar": ("case", bars, {"long_name": "ratio asked for", "units": "1"}),
            "threads": ("case", threads, {"long_name": "threads", "units": "1"}),
            "added_error": ("case", errors, {"long_name": "relative error added to sigma(0.9)", "units": "1"}),
            "fixed_cost": (("fleet", "part"), fixed, {"long_name": "time of a run of two headways", "units": "s"}),
            "headway_cost": (
                "fleet",
                headway,
                {"long_name": "time of a relaxed headway, 16 nodes a car", "units": "s"},
            ),
            "memory": ("length", used, {"long_name": "most memory over road and cars", "units": "1"}),
            "cost_by_size": ("size", by_size, {"long_name": "time of an update", "units": "s"}),
            "cost_by_duration": ("duration", by_duration, {"long_name": "time of an update", "units": "s"}),
        },
        {
            "case": ("case", [f"{n + 1}. {label}" for n, label in enumerate(labels)], {"long_name": "what was run"}),
            "part": ("part", ["run", "error estimate"], {"long_name": "what takes the time"}),
            "fleet": ("fleet", list(FLEETS), {"long_name": "cars", "units": "1"}),
            "size": ("size", list(sizes), {"long_name": "cars", "units": "1"}),
            "duration": ("duration", list(durations), {"long_name": "headways", "units": "1"}),
        },
        {
            "Conventions": "CF-1.11",
            "title": "Speed of the cars model",
            "bare_rate": reference,
            "bare_rate_of_two": twice,
            "cars": CARS,
        },
    )
    store("benchmark", chosen.output, ds, draw(ds))
    assert max(errors) < 1e-4 and max(used) < 1.5, (errors, used)
    assert chosen.quick or np.all(ratios > 0.01), ratios  # rates of the quick form say nothing beside other jobs


def draw(ds) -> Figure:
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    place = np.arange(ds.case.size)[::-1]
    left.barh(place, ds.ratio, color=BLUE, height=0.6)
    left.plot(ds.bar, place, "|", color=RED, ms=16, mew=2.5, label="bar")
    left.axvline(1.0, color="0.4", ls="--", lw=1, label="bare loop, hold 1, one thread")
    left.set_yticks(place, ds.case.values)
    left.set(xlabel="car-node updates a second over those of the bare loop", title="Speed of the cars model, 4096 cars")
    left.legend(frameon=False, loc="lower right")
    right.plot(ds.size * 32, ds.cost_by_size * 1e9, "o-", color=BLUE, label="by nodes of the road")
    right.plot(ds.duration, ds.cost_by_duration * 1e9, "s--", color=ORANGE, label="by headways, 32768 nodes")
    right.set(
        xscale="log", ylim=(0, None), xlabel="nodes or headways", ylabel="time of an update (ns)",
        title="Cost of an update (hold 1)",
    )  # fmt: skip
    right.grid(lw=0.4)
    right.legend(frameon=False, loc="lower left")
    return figure


if __name__ == "__main__":
    main()
