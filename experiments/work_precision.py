"""Error against time for every method there is: how a car steps, how the road relaxes, which continuum, which model.

Four scenes of one wavelength, 8 cars on it: smooth and linear; hardening (alpha = 0.02 exp(0.1 H)); bouncing (amplitude
1.5, cars take off at every wave); resonance (Gamma = 0.02, k = 0.98, near its neutral softness). Four questions to each:

    cars        a stepper with n nodes a headway; reference: quintic hold on the finest grid, held to the trapezoid on it
    relaxation  a scheme, every 8 headways to 32 steps a headway, with n nodes (exact cars, cubic hold); the same reference
    continuum   this package, solve_ivp's five with a spectral right-hand side, and cars of either passage, 4 to 96 a
                wavelength; reference: a matrix exponential (linear scenes), DOP853 at 1e-12, or this package on 511 nodes
    model       linear, continuum and cars as approximations of the scene of 8 cars; the first reference

The error is that of the road at the end: L2 at 32 places (continuum: 64), mean removed, relative; in the linear scenes that
of the growth rate and of the velocity, too, over the second half. Time is that of one core, best of 5 or more after a
warm-up: for cars (passages alone) and relaxation, and cars in the continuum, counted passages and relaxation steps times
the cost of each, measured on a long road (`discrete_ring`); else CPU time of the run, the making of the Dataset left out. What
fails stands as a cross at the upper edge, with its reason in the data. The grey line is the front: no method is both faster
and more accurate.

Run: python experiments/work_precision.py [--quick]        (about 3 min; 12 s)
"""

from functools import cache
from time import process_time

import numpy as np
import xarray as xr
from common import options, store
from continuum_rivals import LIMIT, by_solve_ivp, one_wave
from discrete_ring import at_points, best, cost_of_passage, cost_of_relaxation, difference, rate, run
from work_precision_figure import draw, draw_growth

import traffic_road as tr
from traffic_road.errors import StabilityError, TrafficRoadError
from traffic_road.models import continuum, model
from traffic_road.plots import save_figure
from traffic_road.schemes.relaxation import RELAXATIONS, refuse_diffusion
from traffic_road.schemes.steppers import STEPPERS, refuse_interval

#         k, damping, softness, diffusivity, amplitude, wavelengths of time
CASES = {
    "smooth": (0.9, 0.1, 0.006, 0.01, 0.04, 32),
    "hardening": (0.9, 0.1, tr.Exponential(0.02, 0.1), 0.01, 0.002, 32),
    "bouncing": (0.9, 0.1, 0.006, 0.01, 1.5, 32),
    "resonance": (0.98, 0.02, 2e-4, 0.0023, 0.01, 96),
}
LINEAR = ("smooth", "resonance")
RIVALS = ("RK45", "DOP853", "LSODA", "BDF", "Radau")
CARS = 8  # a wavelength
OF = {  # of what orders are fitted: scene and error
    "smooth wave": ("smooth", "wave_error"),
    "bouncing wave": ("bouncing", "wave_error"),
    "smooth road": ("smooth", "error"),
    "bouncing road": ("bouncing", "error"),
}
DECADES = 10.0 ** -np.arange(1, 10)


def scene(name: str, cars: int = CARS) -> tr.Scene:
    k, damping, softness, diffusivity, amplitude, waves = CASES[name]
    length = 2 * np.pi / k
    road = tr.Road(length, softness, diffusivity, tr.Sine(amplitude, k, np.pi / 2))
    return tr.Scene(road, tr.Fleet(cars, damping), duration=waves * length)


def coefficients(stepper: str, case, rows: int):
    return tuple(c[0] for c in STEPPERS[stepper].step(case.headway / rows, 1.0, case.fleet.damping))


class Chart:
    """The runs of one scene and one question, a row of the Dataset each."""

    def __init__(self, rows: list, scene_name: str, question: str):
        self.rows, self.key = rows, (scene_name, question)

    def add(self, method, setting, seconds, error, *, growth=(np.nan,) * 3, updates=0, steps=0, reason=""):
        if not reason and not error < 1:  # NaN, too
            reason = "diverged" if not np.isfinite(error) else "wrong by more than the road itself"
        self.rows.append((*self.key, method, setting, seconds, error, *growth, updates, steps, reason))


# ---- discrete cars: steppers and relaxations


def of_cars(name: str, rows: list, reference, quick: bool) -> None:
    case, chart = scene(name), Chart(rows, name, "cars")
    finest = 128 if quick else 2048
    for stepper, scheme in STEPPERS.items():
        for n in (8, 32, finest) if quick else (4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048):
            if n > 256 and scheme.order > 1:
                break
            found = coefficients(stepper, case, n)
            hold = found[1].shape[1] - 1
            reason = refusal(refuse_interval, stepper, case.headway / n, 1.0, case.fleet.damping)
            roads, updates, _ = run(case, found, n)
            seconds = updates * cost_of_passage(hold, case.road.softness.kernel, False)
            judge(chart, name, case, stepper, f"{n} nodes a headway", seconds, roads, reference, updates, 0, reason)


def of_relaxations(name: str, rows: list, reference, quick: bool) -> None:
    case, chart = scene(name), Chart(rows, name, "relaxation")
    passage = cost_of_passage(3, case.road.softness.kernel, False)
    for method in RELAXATIONS:
        for n in (8, 32) if quick else (4, 8, 16, 32, 64, 128):
            found, nodes = coefficients("exact, cubic hold", case, n), CARS * n
            for interval, parts in ((4, 1), (1, 1)) if quick else ((8, 1), (4, 1), (2, 1), (1, 1), (1, 4), (1, 32)):
                if method == "exact" and parts > 1:
                    continue  # it is exact
                diffusion = case.road.diffusivity.value * interval * case.headway_time / parts
                reason = refusal(refuse_diffusion, method, diffusion, case.road.length / nodes)
                roads, updates, steps = run(case, found, n, method, interval, parts)
                seconds = updates * passage + steps * cost_of_relaxation(method, nodes)
                setting = f"{n} nodes, every {interval} headways" if interval > 1 else f"{n} nodes, {parts} a headway"
                judge(chart, name, case, method, setting, seconds, roads, reference, updates, steps, reason)


def judge(chart, name, case, method, setting, seconds, roads, reference, updates, steps, reason):
    growth, half = (np.nan, np.nan), case.duration / 2
    with np.errstate(all="ignore"):
        error = difference(at_points(roads[1]), at_points(reference[1]))
        wave = abs(first_wave(roads[1]) / first_wave(reference[1]) - 1)
        if name in LINEAR:
            sigma = rate(reference, half, theory(case))
            off = rate(roads, half, sigma) - sigma
            growth = abs(off.real / sigma.real), abs(off.imag / sigma.imag)
    growth = (*growth, wave)
    chart.add(method, setting, seconds, error, growth=growth, updates=updates, steps=steps, reason=reason)


def first_wave(height) -> complex:
    return np.fft.rfft(height, norm="forward")[1]


@cache
def theory(case) -> complex:
    """sigma of the discrete cars by the Floquet matrix of their finest grid that a matrix allows."""
    return tr.theory.floquet(case, 2 * np.pi / case.road.length, nodes=128 * CARS, hold=5)


def refusal(refuse, *arguments) -> str:
    try:
        refuse(*arguments)
    except StabilityError as error:
        return str(error)
    return ""


# ---- the continuum: this package, solve_ivp, and cars that are ever more


def of_continuum(name: str, rows: list, quick: bool) -> float:
    """Returns how far the reference is from another method."""
    case, chart = scene(name), Chart(rows, name, "continuum")
    reference, checked = continuum_reference(name, case, quick)

    def off(height):
        return difference(at_points(height, 64), reference)

    grids = {"smooth": (8,), "resonance": (8,), "hardening": (8, 16), "bouncing": (16, 32, 64, 128)}[name]
    for nodes in grids[:2] if quick else grids:
        for step in (2.0, 0.5) if quick or name in LINEAR else (16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25):
            seconds, last = best(lambda n=nodes, s=step: of_model(continuum, case, {"nodes": n, "step": s}), 5)
            steps = last.updates // nodes
            chart.add("this package", f"{nodes} nodes, step {step:g}", seconds, off(last.road_height), steps=steps)
    tolerances = (1e-2, 1e-3, 1e-4, 1e-6) if name == "bouncing" else (1e-2, 1e-4, 1e-6, 1e-8)
    tolerances = (1e-3,) if quick else tolerances
    for method in RIVALS[:1] if quick else RIVALS:
        for nodes in grids[:1] if quick else grids:
            for rtol in tolerances:
                setting = f"{nodes} nodes, rtol {rtol:.0e}"
                seconds, height, calls = by_solve_ivp(case, method, nodes, rtol)
                if height is None:
                    chart.add(method, setting, LIMIT, np.nan, reason=f"takes longer than {LIMIT:g} s")
                    break
                chart.add(method, setting, seconds, off(height), steps=calls)
    for passage in ("midpoint", "force from before"):
        for cars in (8, 16) if quick else (4, 6, 8, 12, 16, 24, 32, 48, 64, 96):
            many, n = scene(name, cars), max(4, 192 // cars)
            before = passage != "midpoint"
            roads, updates, steps = run(many, coefficients("exact, quintic hold", many, n), n, from_before=before)
            seconds = updates * cost_of_passage(5, many.road.softness.kernel, before)
            seconds += steps * cost_of_relaxation("exact", cars * n)
            # at the wheels' own places, so that the continuum is asked there
            chart.add(f"cars, {passage}", f"{cars} a wave", seconds, off(roads[1]), updates=updates, steps=steps)
    return checked


def continuum_reference(name, case, quick):
    if name in LINEAR:
        exact = at_points(one_wave(case), 64)
        other = of_model(continuum, case, {"nodes": 16, "step": 0.5}).road_height
    elif name == "hardening":
        rtol, nodes = (1e-8, 16) if quick else (1e-12, 64)
        exact = at_points(by_solve_ivp(case, "DOP853", nodes, rtol, np.inf)[1], 64)
        other = of_model(continuum, case, {"nodes": 64, "step": 0.125}).road_height
    else:
        exact = at_points(of_model(continuum, case, {"nodes": 127 if quick else 511, "step": 0.25}).road_height, 64)
        rtol, nodes = (1e-4, 32) if quick else (1e-8, 256)
        other = by_solve_ivp(case, "DOP853", nodes, rtol, np.inf)[1]
    return exact, difference(at_points(other, 64), exact)


def of_model(module, case, numerics):
    *_, last = module.samples(case, np.array([0.0, case.duration]), numerics)
    return last


# ---- models of the discrete scene


def of_models(name: str, rows: list, reference, quick: bool) -> None:
    case, chart = scene(name), Chart(rows, name, "model")

    def add(method, setting, call):
        try:
            seconds, last = best(call, 5)
        except TrafficRoadError as error:  # the linear model, where laws vary or cars take off
            chart.add(method, setting, np.nan, np.nan, reason=str(error))
            return
        error = difference(at_points(last.road_height), at_points(reference[1]))
        chart.add(method, setting, seconds, error, updates=last.updates)

    linear = model("linear")
    for n in (8, 32) if quick else (8, 16, 32, 64):

        def closed_form(n=n):
            linear.takes_off.cache_clear()  # of the run before
            return of_model(linear, case, linear.numerics(case, {"nodes": n * CARS}))

        add("linear", f"{n} nodes", closed_form)
    for nodes, step in ((16, 4.0), (32, 0.5)) if quick else ((8, 8.0), (16, 4.0), (16, 1.0), (32, 0.5)):
        numerics = {"nodes": nodes, "step": step}
        add("continuum", f"{nodes} nodes, step {step:g}", lambda p=numerics: of_model(continuum, case, p))
    for hold in (3,) if quick else (1, 3, 5):
        for n in (8, 16) if quick else (4, 8, 16, 32, 64, 128):
            for interval in (1,) if quick else (8, 4, 2, 1):
                numerics = {"nodes": n * CARS, "hold": hold, "relax_every": interval}
                setting = f"{n} nodes, every {interval}"
                add(f"cars, hold {hold}", setting, lambda p=numerics: of_model(model("cars"), case, p))


# ---- what is made of the runs


def front(seconds: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Which runs (runs,) have none beside them that is both faster and more accurate."""
    order = np.lexsort((error, seconds))
    least = np.minimum.accumulate(error[order])
    on = np.zeros(error.size, dtype=bool)
    on[order] = np.diff(least, prepend=np.inf) < 0
    return on


def fitted(nodes: np.ndarray, error: np.ndarray) -> float:
    """The order over the four finest grids whose errors are between rounding and a tenth; NaN where there are fewer."""
    use = np.flatnonzero((error > 1e-10) & (error < 0.1))[-4:]
    return float(-np.polyfit(np.log(nodes[use]), np.log(error[use]), 1)[0]) if use.size >= 3 else np.nan


def table(ds) -> None:
    """For each scene and question, and each decade of error: the cheapest run that meets it."""
    for name in CASES:
        for question in ("cars", "relaxation", "continuum", "model"):
            mine = np.flatnonzero((ds.scene == name) & (ds.question == question) & ds.front)
            for decade in DECADES:
                good = mine[ds.error.values[mine] <= decade]
                if good.size:
                    one = ds.isel(run=good[np.argmin(ds.seconds.values[good])])
                    what = f"{one.method.item()}, {one.setting.item()}"
                    print(f"{name:<10} {question:<10} {decade:.0e}  {one.seconds.item() * 1e3:9.3f} ms  {what}")


COLUMNS = {  # of the Dataset: long_name, units
    "scene": ("what was run",),
    "question": ("what it is compared with",),
    "method": ("method",),
    "setting": ("resolution",),
    "seconds": ("time of the run", "s"),
    "error": ("relative error of the road", "1"),
    "growth_error": ("error of the growth rate", "1"),
    "velocity_error": ("error of the phase velocity", "1"),
    "wave_error": ("relative error of the first harmonic", "1"),
    "updates": ("node updates", "1"),
    "steps": ("time steps", "1"),
    "reason": ("why the run failed; empty if it did not",),
}


def main() -> None:
    chosen = options(__doc__)
    quick, rows, checked = chosen.quick, [], {}
    for name in CASES:
        case, finest = scene(name), 512 if quick else 12_800
        reference, _, _ = run(case, coefficients("exact, quintic hold", case, finest), finest)
        other, _, _ = run(case, coefficients("trapezoid", case, finest), finest)
        checked[name, "cars"] = difference(at_points(other[1]), at_points(reference[1]))
        of_cars(name, rows, reference, quick)
        of_relaxations(name, rows, reference, quick)
        checked[name, "continuum"] = of_continuum(name, rows, quick)
        of_models(name, rows, reference, quick)
        print(f"{name}: {process_time():.0f} s")
    columns = dict(zip(COLUMNS, map(np.array, zip(*rows, strict=True)), strict=True))
    data = {}
    for name, (long_name, *units) in COLUMNS.items():
        data[name] = ("run", columns[name], {"long_name": long_name} | ({"units": units[0]} if units else {}))
    ds = xr.Dataset(data)
    on = np.zeros(ds.run.size, dtype=bool)
    for key in sorted(set(zip(columns["scene"], columns["question"], strict=True))):
        mine = (columns["scene"] == key[0]) & (columns["question"] == key[1]) & (columns["reason"] == "")
        on[mine] = front(columns["seconds"][mine], columns["error"][mine])
    ds["front"] = ("run", on, {"long_name": "no run of its scene and question is both faster and more accurate"})
    ds.attrs = {"Conventions": "CF-1.11", "title": "Error against time, for every method"}
    ds.attrs |= {f"reference_{name}_{question}": value for (name, question), value in checked.items()}
    if not quick:
        orders(ds)
    table(ds)
    store("work_precision", chosen.output, ds, draw(ds))
    save_figure(draw_growth(ds), chosen.output / "work_precision_growth.png")
    for key, value in checked.items():
        print(f"reference of {', '.join(key)}: another method differs by {value:.1e}")
    check(ds, checked, quick)


def orders(ds) -> None:
    """Orders in the grid: of the first harmonic of the smooth scene and of the bouncing one, and of the roads."""
    found = []
    for stepper, scheme in STEPPERS.items():
        row = []
        for name, what in OF.values():
            mine = (ds.scene == name) & (ds.question == "cars") & (ds.method == stepper) & (ds.reason == "")
            nodes = np.array([float(s.split()[0]) for s in ds.setting.values[mine]])
            row.append(fitted(nodes, ds[what].values[mine]))
        found.append(row)
        print(f"{stepper:<38} order {scheme.order}: " + ", ".join(f"{o} {n:.2f}" for o, n in zip(OF, row, strict=True)))
    ds.coords["stepper"], ds.coords["of"] = ("stepper", list(STEPPERS)), ("of", list(OF))
    ds["order"] = (("stepper", "of"), np.array(found), {"long_name": "fitted order in the grid"})


def check(ds, checked, quick) -> None:
    error = ds.error.where(ds.reason == "")
    for name in CASES:
        best_of = {q: float(error[(ds.scene == name) & (ds.question == q)].min()) for q in np.unique(ds.question)}
        print(name, best_of)
        assert max(best_of.values()) < (0.05 if quick else 0.01), (name, best_of)
        # a reference is known better than what is judged by it
        assert quick or checked[name, "cars"] < best_of["cars"], (name, checked, best_of)
    if not quick:  # of the long wave: under bouncing cars, high orders fall to 1 on fine grids, low ones stay
        found = dict(zip(ds.stepper.values, ds.order.sel(of="bouncing wave").values, strict=True))
        assert all(abs(found[n] - s.order) < 0.15 for n, s in STEPPERS.items() if s.order < 3), found
        assert all(0.85 < found[n] < 2.15 for n, s in STEPPERS.items() if s.order > 3), found
    failed = ds.reason.values[ds.reason.values != ""]
    assert any("stable up to" in reason for reason in failed)


if __name__ == "__main__":
    main()
