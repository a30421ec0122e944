"""Error against time for every method there is: how a car steps, how the road relaxes, which continuum, which model.

Four scenes of one wavelength, 8 cars on it: smooth and linear; hardening (alpha = 0.02 exp(0.1 H)); bouncing (amplitude
1.5, cars take off at every wave); resonance (Gamma = 0.02, k = 0.98, near its neutral softness). Four questions to each:

    cars        a stepper with n nodes a headway; reference: quintic hold on the finest grid, held to the trapezoid on it
    relaxation  a scheme, every 8 headways to 32 steps a headway, with n nodes (exact cars, cubic hold); the same reference
    continuum   this package, solve_ivp's five with a spectral right-hand side, and cars of either passage, 4 to 96 a
                wavelength; reference: a matrix exponential (linear scenes), DOP853 at 1e-12, or this package on 511 nodes
    model       linear, continuum and cars as approximations of the scene of 8 cars; the first reference. In the linear
                scenes closed forms of the growth rate, too

The error is that of the road at the end: L2 at 32 places (continuum: 64), mean removed, relative; in the linear scenes those
of growth rate and velocity, too, from roads after 5, 6, 7 and 8 eighths of the time, against closed forms: the continuum's
cubic, and for cars the Floquet matrix, extrapolated in its nodes. The ring of the cars from the start is taken out
(`discrete_ring.rate`): in the resonance it moves the rate over the second half by 1e-4 of itself.

Time is that of one core, best of 5 or more after a warm-up: for cars (passages alone) and relaxation, and cars in the
continuum, counted passages and relaxation steps times the cost of each, measured on a long road (`discrete_ring`); else
CPU time of the run, the making of the Dataset left out. What fails stands as a cross at the upper edge, with its reason in
the data. The grey line is the front: no method is both faster and more accurate.

Run: python experiments/work_precision.py [--quick]        (about 2 min; 11 s)
"""

import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}  # read when numpy is loaded: times are of one core

from functools import cache
from time import process_time

import numpy as np
from common import options, store
from continuum_rivals import METHODS, TooLong, one_wave, solver
from discrete_ring import at_points, best, cost_of_passage, cost_of_relaxation, difference, rate, run
from work_precision_data import LINEAR, Chart, check, dataset, eighths, orders, table
from work_precision_figure import draw, draw_growth

import traffic_road as tr
from traffic_road.errors import StabilityError, TrafficRoadError
from traffic_road.models import model
from traffic_road.models.continuum_state import linear_throughout
from traffic_road.plots import save_figure
from traffic_road.schemes.relaxation import RELAXATIONS, refuse_diffusion
from traffic_road.schemes.steppers import STEPPERS, refuse_interval
from traffic_road.theory.dispersion import dispersion_roots

#         k, damping, softness, diffusivity, amplitude, wavelengths of time
CASES = {
    "smooth": (0.9, 0.1, 0.006, 0.01, 0.04, 32),
    "hardening": (0.9, 0.1, tr.Exponential(0.02, 0.1), 0.01, 0.002, 32),
    "bouncing": (0.9, 0.1, 0.006, 0.01, 1.5, 32),
    "resonance": (0.98, 0.02, 2e-4, 0.0023, 0.01, 96),
}
CARS = 8  # a wavelength
LIMIT = 0.3  # seconds after which a run of solve_ivp is given up


def scene(name: str, cars: int = CARS) -> tr.Scene:
    k, damping, softness, diffusivity, amplitude, waves = CASES[name]
    length = 2 * np.pi / k
    road = tr.Road(length, softness, diffusivity, tr.Sine(amplitude, k, np.pi / 2))
    return tr.Scene(road, tr.Fleet(cars, damping), duration=waves * length)


@cache
def of_the_continuum(name: str):
    """In a linear scene sigma of the continuum, by its cubic, and (2,) of the two other modes; else None."""
    if name not in LINEAR:
        return None
    k, damping, softness, diffusivity, *_ = CASES[name]
    roots = dispersion_roots(k, softness=softness, diffusivity=diffusivity, damping=damping)
    return roots[0], roots[1:]


@cache
def of_the_cars(name: str, rows: int = 64):
    """As of_the_continuum for the discrete cars: of their Floquet matrix with `rows` and twice as many nodes a headway.

    Between passages and relaxations in turn that is of order 2 in the nodes. The two other modes are the continuum's.
    """
    if name not in LINEAR:
        return None
    case, k = scene(name), CASES[name][0]
    coarse, fine = (tr.theory.floquet(case, k, nodes=n * CARS, hold=5) for n in (rows, 2 * rows))
    return fine + (fine - coarse) / 3, of_the_continuum(name)[1]


def coefficients(stepper: str, case, rows: int):
    return tuple(c[0] for c in STEPPERS[stepper].step(case.headway / rows, 1.0, case.fleet.damping))


# ---- discrete cars: steppers and relaxations


def of_cars(name: str, rows: list, reference, quick: bool) -> None:
    case = scene(name)
    chart = Chart(rows, name, case, "cars", reference, of_the_cars(name))
    finest = 128 if quick else 2048
    for stepper, scheme in STEPPERS.items():
        for n in (8, 32, finest) if quick else (4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048):
            if n > 256 and scheme.order > 1:
                break
            found = coefficients(stepper, case, n)
            hold = found[1].shape[1] - 1
            reason = refusal(refuse_interval, stepper, case.headway / n, 1.0, case.fleet.damping)
            roads, updates, relaxations = run(case, found, n)
            counts = {"updates": updates, "steps": updates // CARS, "relaxations": relaxations, "reason": reason}
            seconds = updates * cost_of_passage(hold, case.road.softness.kernel, False)
            chart.add(stepper, f"{n} nodes a headway", seconds, roads, **counts)


def of_relaxations(name: str, rows: list, reference, quick: bool) -> None:
    case = scene(name)
    chart = Chart(rows, name, case, "relaxation", reference, of_the_cars(name))
    passage = cost_of_passage(3, case.road.softness.kernel, False)
    for method in RELAXATIONS:
        for n in (8, 32) if quick else (4, 8, 16, 32, 64, 128):
            found, nodes = coefficients("exact, cubic hold", case, n), CARS * n
            for interval, parts in ((4, 1), (1, 1)) if quick else ((8, 1), (4, 1), (2, 1), (1, 1), (1, 4), (1, 32)):
                if method == "exact" and parts > 1:
                    continue  # it is exact
                diffusion = case.road.diffusivity.value * interval * case.headway_time / parts
                reason = refusal(refuse_diffusion, method, diffusion, case.road.length / nodes)
                roads, updates, relaxations = run(case, found, n, method, interval, parts)
                counts = {"updates": updates, "steps": updates // CARS, "relaxations": relaxations, "reason": reason}
                seconds = updates * passage + relaxations * cost_of_relaxation(method, nodes)
                setting = f"{n} nodes, every {interval} headways" if interval > 1 else f"{n} nodes, {parts} a headway"
                chart.add(method, setting, seconds, roads, **counts)


def refusal(refuse, *arguments) -> str:
    try:
        refuse(*arguments)
    except StabilityError as error:
        return str(error)
    return ""


# ---- the continuum: this package, solve_ivp, and cars that are ever more


def of_continuum(name: str, rows: list, quick: bool) -> float:
    """Returns how far the reference is from another method."""
    case = scene(name)
    reference, checked = continuum_reference(name, case, quick)
    chart = Chart(rows, name, case, "continuum", reference, of_the_continuum(name), points=64)
    grids = {"smooth": (8,), "resonance": (8,), "hardening": (8, 16), "bouncing": (16, 32, 64, 128)}[name]
    for nodes in grids[:2] if quick else grids:
        for step in (2.0, 0.5) if quick or name in LINEAR else (16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25):
            add_model(
                chart, "this package", f"{nodes} nodes, step {step:g}", "continuum", {"nodes": nodes, "step": step}
            )
    tolerances = (1e-2, 1e-3, 1e-4, 1e-6) if name == "bouncing" else (1e-2, 1e-4, 1e-6, 1e-8)
    tolerances = (1e-3,) if quick else tolerances
    for method in METHODS[-1:] if quick else METHODS:
        for nodes in grids[:1] if quick else grids:
            for rtol in tolerances:
                setting = f"{nodes} nodes, rtol {rtol:.0e}"
                call = solver(case, method, nodes, rtol)
                try:
                    seconds, done, _ = best(lambda call=call: call(LIMIT), 5)
                except TooLong:
                    chart.fail(method, setting, f"takes longer than {LIMIT:g} s", LIMIT)
                    break
                counts = {
                    "updates": done.calls * nodes,
                    "steps": done.steps,
                    "calls": done.calls,
                    "reason": done.reason,
                }
                roads, end = done.roads, done.roads[-1]
                if name in LINEAR:
                    roads = solver(case, method, nodes, rtol, eighths(case.duration))().roads
                chart.add(method, setting, seconds, roads, end=end, **counts)
    for passage in ("midpoint", "force from before"):
        for cars in (8, 16) if quick else (4, 6, 8, 12, 16, 24, 32, 48, 64, 96):
            many, n = scene(name, cars), max(4, 192 // cars)
            before = passage != "midpoint"
            roads, updates, relaxations = run(many, coefficients("exact, quintic hold", many, n), n, from_before=before)
            seconds = updates * cost_of_passage(5, many.road.softness.kernel, before)
            seconds += relaxations * cost_of_relaxation("exact", cars * n)
            counts = {"updates": updates, "steps": updates // cars, "relaxations": relaxations}
            # at the wheels' own places, so that the continuum is asked there
            chart.add(f"cars, {passage}", f"{cars} a wave", seconds, roads, **counts)
    return checked


def continuum_reference(name, case, quick):
    if name in LINEAR:
        exact = one_wave(case)
        other = at_end(case, 16, 0.5)
    elif name == "hardening":
        rtol, nodes = (1e-8, 16) if quick else (1e-12, 64)
        exact = solver(case, "DOP853", nodes, rtol)().roads[-1]
        other = at_end(case, 64, 0.125)
    else:
        exact = at_end(case, 127 if quick else 511, 0.25)
        rtol, nodes = (1e-4, 32) if quick else (1e-8, 256)
        other = solver(case, "DOP853", nodes, rtol)().roads[-1]
    return exact, difference(at_points(other, 64), at_points(exact, 64))


def at_end(case, nodes, step):
    return of_model("continuum", case, {"nodes": nodes, "step": step})[-1].road_height


# ---- models of the discrete scene


def of_model(name: str, case, numerics, times=None) -> list:
    """The Samples at `times`, by default the end."""
    times = [case.duration] if times is None else times
    return list(model(name).samples(case, np.array([0.0, *times]), numerics))[1:]


def add_model(chart, method: str, setting: str, name: str, numerics: dict) -> None:
    case = chart.case

    def call():
        model("linear").takes_off.cache_clear()  # of the run before
        return of_model(name, case, numerics)[-1]

    try:
        if name == "linear":
            model(name).numerics(case, numerics)
        seconds, last, _ = best(call, 5)
    except TrafficRoadError as error:  # the linear model, where laws vary or cars take off
        chart.fail(method, setting, str(error))
        return
    end, nodes = last.road_height, last.road_height.size
    roads = [end]
    if chart.closed is not None:
        roads = [sample.road_height for sample in of_model(name, case, numerics, eighths(case.duration))]
    counts = {"updates": last.updates, "steps": last.updates // nodes}
    if name == "cars":  # half a relaxation opens and closes the run
        relaxations = round(case.duration / case.headway / numerics["relax_every"]) + 1
        counts = {"updates": last.updates, "steps": last.updates // CARS, "relaxations": relaxations}
    elif name == "linear" or linear_throughout(case, nodes, case.duration):
        counts = {"updates": nodes, "steps": 1}
    chart.add(method, setting, seconds, np.array(roads), end=end, **counts)


def of_models(name: str, rows: list, reference, quick: bool) -> None:
    chart = Chart(rows, name, scene(name), "model", reference, of_the_cars(name))
    for n in (8, 32) if quick else (8, 16, 32, 64):
        add_model(chart, "linear", f"{n} nodes", "linear", {"nodes": n * CARS})
    for nodes, step in ((16, 4.0), (32, 0.5)) if quick else ((8, 8.0), (16, 4.0), (16, 1.0), (32, 0.5)):
        add_model(chart, "continuum", f"{nodes} nodes, step {step:g}", "continuum", {"nodes": nodes, "step": step})
    for hold in (3,) if quick else (1, 3, 5):
        for n in (8, 16) if quick else (4, 8, 16, 32, 64, 128):
            for interval in (1,) if quick else (8, 4, 2, 1):
                numerics = {"nodes": n * CARS, "hold": hold, "relax_every": interval}
                add_model(chart, f"cars, hold {hold}", f"{n} nodes, every {interval}", "cars", numerics)


def of_theory(name: str, rows: list, quick: bool) -> None:
    """Closed forms of the growth rate, beside the models of the discrete scene."""
    case, (k, damping, softness, diffusivity, *_) = scene(name), CASES[name]
    chart = Chart(rows, name, case, "model", None, of_the_cars(name))
    road = {"softness": softness, "diffusivity": diffusivity, "damping": damping}
    forms = {
        ("theory: leading order", "closed form"): lambda: tr.theory.dispersion_leading(k, **road),
        ("theory: cubic", "closed form"): lambda: tr.theory.dispersion(k, **road),
        ("theory: with headway", "closed form"): lambda: tr.theory.dispersion(k, **road, headway=case.headway),
    }
    for n in (4, 32) if quick else (4, 8, 16, 32, 64):
        forms["theory: Floquet", f"{n} nodes"] = lambda n=n: tr.theory.floquet(case, k, nodes=n * CARS, hold=5)
    for (method, setting), form in forms.items():
        seconds, sigma, _ = best(form, 5)
        chart.add_theory(method, setting, seconds, sigma)


def main() -> None:
    chosen = options(__doc__)
    quick, rows, checked = chosen.quick, [], {}
    for name in CASES:
        case, finest = scene(name), 512 if quick else 12_800
        roads, _, _ = run(case, coefficients("exact, quintic hold", case, finest), finest)
        other, _, _ = run(case, coefficients("trapezoid", case, finest), finest)
        reference = roads[-1]
        checked[name, "cars"] = difference(at_points(other[-1]), at_points(reference))
        if name in LINEAR:
            sigma, others = of_the_cars(name)
            checked[name, "sigma"] = abs(rate(roads, case.duration / 8, sigma, others) - sigma) / sigma.real
            checked[name, "floquet"] = abs(of_the_cars(name, 32)[0] - sigma) / sigma.real
        of_cars(name, rows, reference, quick)
        of_relaxations(name, rows, reference, quick)
        checked[name, "continuum"] = of_continuum(name, rows, quick)
        of_models(name, rows, reference, quick)
        if name in LINEAR:
            of_theory(name, rows, quick)
        print(f"{name}: {process_time():.0f} s")
    ds = dataset(rows)
    ds.attrs |= {f"reference_{name}_{what}": value for (name, what), value in checked.items()}
    if not quick:
        orders(ds)
    for what in ("error", "growth_error", "velocity_error"):
        table(ds, what)
    store("work_precision", chosen.output, ds, draw(ds))
    save_figure(draw_growth(ds), chosen.output / "work_precision_growth.png")
    for key, value in checked.items():
        print(f"reference of {', '.join(key)}: another method differs by {value:.1e}")
    check(ds, checked, quick)


if __name__ == "__main__":
    main()
