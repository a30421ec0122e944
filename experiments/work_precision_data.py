"""What is made of the runs of work_precision: errors, the Dataset, its fronts, fitted orders, tables, and what is asserted."""

import numpy as np
import xarray as xr
from continuum_rivals import METHODS
from discrete_ring import EIGHTHS, POINTS, at_points, difference, rate

from traffic_road.schemes.steppers import STEPPERS

LINEAR = ("smooth", "resonance")  # scenes that have closed forms
DECADES = 10.0 ** -np.arange(1, 10)
OF = {  # of what orders are fitted: scene and error
    "smooth growth": ("smooth", "growth_error"),
    "smooth wave": ("smooth", "wave_error"),
    "bouncing wave": ("bouncing", "wave_error"),
    "smooth road": ("smooth", "error"),
    "bouncing road": ("bouncing", "error"),
}
COLUMNS = {  # of the Dataset: long_name, units
    "scene": ("what was run",),
    "question": ("what it is compared with",),
    "method": ("method",),
    "setting": ("resolution",),
    "seconds": ("time of the run", "s"),
    "error": ("relative error of the road", "1"),
    "growth_error": ("relative error of the growth rate, against the closed form", "1"),
    "velocity_error": ("relative error of the phase velocity, against the closed form", "1"),
    "wave_error": ("relative error of the first harmonic", "1"),
    "updates": ("node updates: passages of cars; else nodes times steps, of solve_ivp nodes times calls", "1"),
    "steps": (
        "steps in time: of each car from node to node; of an integrator, those accepted; 1 if by one matrix",
        "1",
    ),
    "relaxations": ("steps of the road's relaxation; 0 where it is part of the steps", "1"),
    "calls": ("calls of the right-hand side, by solve_ivp", "1"),
    "reason": ("why the run failed; empty if it did not",),
}
TEXTS = tuple(name for name, (_, *units) in COLUMNS.items() if not units)
ERRORS = ("error", "growth_error", "velocity_error", "wave_error")
COUNTS = ("updates", "steps", "relaxations", "calls")


class Chart:
    """The runs of one scene and one question, each added to `rows` as a dict of COLUMNS.

    reference: the road at the end (nodes,), compared at `points` places; closed: in a linear scene sigma and that of
    the two other modes. Closed forms need no reference.
    """

    def __init__(self, rows: list, scene_name: str, case, question: str, reference, closed=None, points=POINTS):
        self.rows, self.key = rows, {"scene": scene_name, "question": question}
        self.case, self.closed, self.points = case, closed, points
        if reference is not None:
            self.road, self.wave = at_points(reference, points), first_wave(reference)

    def add(self, method: str, setting: str, seconds: float, roads, *, end=None, reason="", **counts) -> None:
        """roads: (times, nodes); in a linear scene four, after five to eight EIGHTHS. end: the last, if of another run."""
        with np.errstate(all="ignore"):
            end, found = roads[-1] if end is None else end, dict.fromkeys(ERRORS, np.nan)
            found["error"] = difference(at_points(end, self.points), self.road)
            found["wave_error"] = abs(first_wave(end) / self.wave - 1)
            if self.closed is not None and len(roads) == len(EIGHTHS):
                found |= self._off(rate(roads, self.case.duration / 8, *self.closed))
        if not reason and not found["error"] < 1:  # NaN, too
            reason = "wrong by more than the road itself" if np.isfinite(found["error"]) else "diverged"
        self._append(method, setting, seconds, reason, found, counts)

    def add_theory(self, method: str, setting: str, seconds: float, sigma: complex) -> None:
        """A closed form of sigma, which has no road."""
        self._append(method, setting, seconds, "", dict.fromkeys(ERRORS, np.nan) | self._off(sigma), {})

    def _off(self, found: complex) -> dict:
        sigma, _ = self.closed
        off = found - sigma
        return {"growth_error": abs(off.real / sigma.real), "velocity_error": abs(off.imag / sigma.imag)}

    def fail(self, method: str, setting: str, reason: str, seconds: float = np.nan, **counts) -> None:
        self._append(method, setting, seconds, reason, dict.fromkeys(ERRORS, np.nan), counts)

    def _append(self, method, setting, seconds, reason, found, counts):
        made = {"method": method, "setting": setting, "seconds": seconds, "reason": reason}
        self.rows.append(self.key | made | found | dict.fromkeys(COUNTS, 0) | counts)


def first_wave(height) -> complex:
    return np.fft.rfft(height, norm="forward")[1]


def eighths(duration: float) -> np.ndarray:
    """The times of the four roads."""
    return duration / 8 * np.array(EIGHTHS)


def dataset(rows: list) -> xr.Dataset:
    data = {}
    for name, (long_name, *units) in COLUMNS.items():
        values = np.array([row[name] for row in rows])
        data[name] = ("run", values, {"long_name": long_name} | ({"units": units[0]} if units else {}))
    ds = xr.Dataset(data, attrs={"Conventions": "CF-1.11", "title": "Error against time, for every method"})
    on = np.zeros(ds.run.size, dtype=bool)
    for mine in groups(ds).values():
        mine = mine[(ds.reason.values[mine] == "") & np.isfinite(ds.error.values[mine])]
        on[mine] = front(ds.seconds.values[mine], ds.error.values[mine])
    ds["front"] = ("run", on, {"long_name": "no run of its scene and question is both faster and more accurate"})
    return ds


def groups(ds) -> dict:
    """The runs of each scene and question: {(scene, question): indices}."""
    keys = list(zip(ds.scene.values, ds.question.values, strict=True))
    return {key: np.array([i for i, k in enumerate(keys) if k == key]) for key in dict.fromkeys(keys)}


def front(seconds: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Which runs (runs,) have none beside them that is both faster and more accurate."""
    order = np.lexsort((error, seconds))
    least = np.minimum.accumulate(error[order])
    on = np.zeros(error.size, dtype=bool)
    on[order] = np.diff(least, prepend=np.inf) < 0
    return on


def table(ds, what: str) -> None:
    """For each scene and question, and each decade of the error `what`: the cheapest run that meets it, and its cost."""
    print(f"cheapest to each {COLUMNS[what][0]}")
    error, seconds = ds[what].values, ds.seconds.values * 1e3
    for (name, question), mine in groups(ds).items():
        mine, to = mine[ds.reason.values[mine] == ""], {}
        for decade in DECADES:
            good = mine[error[mine] <= decade]
            if good.size:
                to.setdefault(good[np.argmin(seconds[good])], []).append(f"{decade:.0e}")
        for i, decades in to.items():
            text = f"{ds.method.values[i]}, {ds.setting.values[i]}"
            span = " to ".join(decades[:: max(1, len(decades) - 1)])  # the first and the last
            print(f"{name:<10} {question:<10} {span:<14} {seconds[i]:9.3f} ms  {text}")


def fitted(nodes: np.ndarray, error: np.ndarray) -> float:
    """The order over the four finest grids whose errors are between rounding and a tenth; NaN where there are fewer."""
    use = np.flatnonzero((error > 1e-10) & (error < 0.1))[-4:]
    return float(-np.polyfit(np.log(nodes[use]), np.log(error[use]), 1)[0]) if use.size >= 3 else np.nan


def orders(ds) -> None:
    """Orders in the grid, by what they are of: added to `ds`, and printed."""
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


def check(ds, checked: dict, quick: bool) -> None:
    """checked: by how much the references differ from another method, by scene and question."""
    # of the best run of each question; in the linear scenes for growth rate and velocity, too
    bounds = {"error": 0.05, "growth_error": 1e-6, "velocity_error": 1e-7}
    bounds = bounds if quick else {"error": 0.01, "growth_error": 1e-8, "velocity_error": 1e-9}
    sound = ds.isel(
        run=np.flatnonzero((ds.reason == "") & np.isfinite(ds.error))
    )  # all but closed forms, without a road
    for (name, question), mine in groups(sound).items():
        for what in bounds if name in LINEAR else ["error"]:
            values = sound[what].values[mine]
            print(f"{name:<10} {question:<10} {what:<14} {values.min():.1e}")
            assert values.min() < bounds[what], (name, question, what, values)  # NaN is not less
            # a reference is known better than what is judged by it
            if not quick and (what, question) == ("error", "cars"):
                assert checked[name, "cars"] < values.min(), (name, checked)
    for name in LINEAR:  # the finest run has the closed form's rate, which its own grid does not move
        assert checked[name, "sigma"] < 5e-9 and checked[name, "floquet"] < 1e-10, checked
        ours = (sound.scene == name) & (sound.method == "this package")
        assert np.all(sound.growth_error.values[ours] < 1e-10), "the package's growth rate is not the cubic's"
    assert np.all(sound.steps > 0) and np.all(sound.updates > 0)
    assert np.array_equal(sound.calls > 0, np.isin(sound.method, METHODS))
    if not quick:
        check_orders(ds)
    failed = ds.reason.values[ds.reason.values != ""]
    mine = ds.isel(run=np.flatnonzero(ds.method == "theory: Floquet"))  # the smallest matrix: 4 nodes a headway
    assert 0 < mine.growth_error.values.max() < 1e-4, mine.growth_error
    assert any("stable up to" in reason for reason in failed)


def check_orders(ds) -> None:
    # of the long wave: under bouncing cars, high orders fall to 1 on fine grids, low ones stay
    found = dict(zip(ds.stepper.values, ds.order.sel(of="bouncing wave").values, strict=True))
    assert all(abs(found[n] - s.order) < 0.15 for n, s in STEPPERS.items() if s.order < 3), found
    assert all(0.85 < found[n] < 2.15 for n, s in STEPPERS.items() if s.order > 3), found
    for passage, order in {"midpoint": 2, "force from before": 1}.items():  # in the headway, to the continuum
        mine = (ds.scene == "smooth") & (ds.question == "continuum") & (ds.method == f"cars, {passage}")
        cars = np.array([float(text.split()[0]) for text in ds.setting.values[mine]])
        found = fitted(cars, ds.growth_error.values[mine])
        print(f"cars, {passage}: growth rate of order {found:.2f} in the headway")
        assert abs(found - order) < 0.15, (passage, found)
