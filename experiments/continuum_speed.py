"""The continuum against solve_ivp: error of the road against computing time, one wave of the paper's road for T = 400.

Two scenes, k = 0.9, Gamma = 0.1, Delta = 0.01, alpha = 0.006. Smooth: amplitude 1e-3, cars never take off; the reference
is the matrix exponential of one wave. Bouncing: amplitude 1.5, cars take off at every wave; the reference is this package
with 511 nodes and step 0.5, whose own error is about 3e-9 (errors fall as nodes^-3.3: the road's curvature has corners).

Beside `tr.simulate` as a user calls it (error estimate and Dataset included) and the bare time stepping, all methods of
solve_ivp over sweeps of tolerance and grid. Their right-hand side is spectral, in numpy, on the nodes; derivatives by
transforms or by a matrix, whichever is faster on that grid. On a grid, tolerances are tightened until the error stays
the same; a method is given up, and finer grids with it, at a run that takes longer than 8 s: that run stands as a cross
at the edge of the chart, with its reason in the data. Times are CPU times of one core, the best of 5 or more after a
warm-up, ours of 30, of as many scenes, made beforehand as the right-hand sides are, that differ by a rounding, so that no
run finds what another has left in memory (a grid's table of cosines apart, as transforms keep theirs);
runs of solve_ivp that take too long for 5 within half a second, and are not
among the fastest to any of the errors compared, within a factor of two, have fewer (`repeats`). The error is that of the
corrugation: L2 over the road, mean removed, relative. A comparison at equal error takes the fastest run of each that is
at least as good. Errors of Radau and BDF under bouncing cars change by several times with the last bit of the right-hand
side, and so with the machine, which chooses how to differentiate: do not read much into one point.

The last panel shows the order in the step, on 63 nodes: cars take off and land inside the grid, and the order stays four.

Run: python experiments/continuum_speed.py [--quick]        (about 5 min; 8 s)
"""

import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}  # read when numpy is loaded: times are of one core

import numpy as np
import xarray as xr
from common import options, store
from continuum_rivals import EXPLICIT, METHODS, TooLong, one_wave, solver
from discrete_ring import best
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.estimate import corrugation_difference
from traffic_road.models import continuum
from traffic_road.models.continuum_state import linear_throughout
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED

K, DAMPING, DIFFUSIVITY, SOFTNESS, END = 0.9, 0.1, 0.01, 0.006, 400.0
STYLES = dict(zip(METHODS, [(ORANGE, "v"), (GREEN, "^"), (PURPLE, "s"), (RED, "D"), (BLACK, "p")], strict=True))
AMPLITUDE = {"smooth": 1e-3, "bouncing": 1.5}
TARGETS = {
    "smooth": 10.0 ** -np.arange(2, 11),
    "bouncing": 10.0 ** -np.arange(2, 7),
}  # errors at which times are compared
SHOWN = {"smooth": (1e-6,), "bouncing": (1e-4, 1e-6)}  # in the figure
LIMIT = 8.0  # seconds
PATIENCE = 0.5  # seconds for the repeats of a run that is not among the fastest
REPEATS, OURS = 5, 30
STEPS = (25.0, 20.0, 16.0, 12.5, 10.0, 8.0, 6.25, 5.0, 4.0, 2.5, 2.0, 1.0)
COLUMNS = {  # of the Dataset: long_name, units
    "who": ("tr.simulate, the bare stepping, or the method of solve_ivp",),
    "nodes": ("nodes", "1"),
    "setting": ("longest step of ours, rtol of solve_ivp", "1"),
    "error": ("relative error of the corrugation", "1"),
    "seconds": ("shortest time of the run; where it took too long, the limit", "s"),
    "repeats": ("runs timed", "1"),
    "steps": ("time steps, by solve_ivp those accepted; 1 where one matrix leads to the end", "1"),
    "calls": ("calls of the right-hand side, by solve_ivp", "1"),
    "reason": ("why the run failed; empty if it did not",),
}


def scene(name: str, roundings: int = 0) -> tr.Scene:
    """roundings: of the phase, that make it another scene, of which no run before this has left anything in memory."""
    profile = tr.Sine(AMPLITUDE[name], K, np.pi / 2 - roundings * np.spacing(np.pi / 2))
    return tr.Scene(tr.Road(2 * np.pi / K, SOFTNESS, DIFFUSIVITY, profile), tr.Fleet(1, DAMPING), duration=END)


def reference(name: str, quick: bool) -> np.ndarray:
    """The road at the end, on nodes."""
    if name == "bouncing":
        return road(scene(name), *((255, 1.0) if quick else (511, 0.5)))
    return one_wave(scene(name))


def road(case, nodes: int, step: float, unit: float | None = None) -> np.ndarray:
    numerics = {"nodes": nodes, "step": step, "unit": unit or step}
    *_, last = continuum.samples(case, np.array([0.0, END]), numerics)
    return last.road_height


class Runs:
    """The runs of a scene, in `rows`, a dict of COLUMNS each."""

    def __init__(self, name: str, quick: bool):
        self.name, self.case, self.quick = name, scene(name), quick
        self.exact, self.limit, self.rows, self.calls = reference(name, quick), 0.2 if quick else LIMIT, [], {}

    def add(self, who, nodes, setting, seconds, repeats, height, *, steps, calls=0, reason=""):
        error = corrugation_difference(self.exact, height) if np.all(np.isfinite(height)) else np.nan
        if not reason and not error < 1:
            reason = "wrong by more than the road itself" if np.isfinite(error) else "diverged"
        values = (who, nodes, setting, error, seconds, repeats, steps, calls, reason)
        self.rows.append(dict(zip(COLUMNS, values, strict=True)))

    def ours(self, nodes: int, step: float) -> None:
        """`simulate` and the bare stepping."""
        repeats = 3 if self.quick else OURS
        call = {"model": "continuum", "samples": 2, "progress": False, "nodes": nodes, "step": step}
        scenes = iter([scene(self.name, 1 + i) for i in range(2 * repeats + 2)])
        seconds, ds, count = best(lambda: tr.simulate(next(scenes), **call), repeats)
        steps = 1 if linear_throughout(self.case, nodes, END) else ds.attrs["updates"] // nodes
        self.add("simulate", nodes, step, seconds, count, ds.road_height.values[-1], steps=steps)
        seconds, height, count = best(lambda: road(next(scenes), nodes, step), repeats)
        self.add("stepping", nodes, step, seconds, count, height, steps=steps)

    def theirs(self, method: str, nodes: int, rtol: float) -> bool:
        """A run of solve_ivp; whether it ends within the limit."""
        call = self.calls[method, nodes, rtol] = solver(self.case, method, nodes, rtol)
        try:
            seconds, done, count = best(lambda: call(self.limit), REPEATS, 0.1 if self.quick else PATIENCE)
        except TooLong:
            values = (method, nodes, rtol, np.nan, self.limit, 1, 0, 0, f"takes longer than {self.limit:g} s")
            self.rows.append(dict(zip(COLUMNS, values, strict=True)))
            return False
        counts = {"steps": done.steps, "calls": done.calls, "reason": done.reason}
        self.add(method, nodes, rtol, seconds, count, done.roads[-1], **counts)
        return True

    def contend(self) -> None:
        """More repeats for each run of solve_ivp that could be the fastest to one of the TARGETS."""
        for target in TARGETS[self.name]:
            fit = [row for row in self.rows if row["who"] in METHODS and row["error"] <= target]
            least = min((row["seconds"] for row in fit), default=0.0)
            for row in fit:
                if row["seconds"] <= 2 * least and row["repeats"] < REPEATS:
                    seconds, _, count = best(self.calls[row["who"], row["nodes"], row["setting"]], REPEATS)
                    row["seconds"], row["repeats"] = min(row["seconds"], seconds), row["repeats"] + count


def sweep(name: str, quick: bool) -> list[dict]:
    runs = Runs(name, quick)
    if name == "smooth":
        grids, tolerances, mine = (4, 6, 8), np.logspace(-2, -8, 13), [(nodes, END) for nodes in (4, 8, 16, 32)]
    else:
        grids, tolerances = (16, 24, 32, 40, 48, 64, 96, 128, 192, 256, 320), np.logspace(-2, -7, 11)
        mine = [(n, step) for n in (11, 15, 19, 21, 23, 27, 33, 41, 55, 71, 81, 91, 101) for step in STEPS]
    if quick:
        grids, tolerances, mine = grids[:2], tolerances[::6], mine[::6]
    for nodes, step in mine:
        runs.ours(nodes, step)
    for method in METHODS:
        in_time = True
        for nodes in grids:
            before = np.inf
            for rtol in tolerances[2::4] if method in EXPLICIT else tolerances[:: 2 if nodes > 64 else 1]:
                in_time = runs.theirs(method, nodes, rtol)
                if not in_time or abs(runs.rows[-1]["error"] / before - 1) < 0.03:  # what is left is the grid's
                    break
                before = runs.rows[-1]["error"]
            if not in_time:  # and longer still on finer grids
                break
    if not quick:
        runs.contend()
        # ours once more, minutes later: what a machine gives changes by the second
        leading = [fastest(runs.rows, (who,), target) for who in ("simulate", "stepping") for target in TARGETS[name]]
        for nodes, step in sorted({(row["nodes"], row["setting"]) for row in leading if row}):
            runs.ours(nodes, step)
    return runs.rows


def fastest(rows, names, target):
    """The row that takes the least time to an error of `target` or less."""
    fit = [row for row in rows if row["who"] in names and row["error"] <= target and not row["reason"]]
    return min(fit, key=lambda row: row["seconds"]) if fit else None


def compared(name: str, rows: list[dict], quick: bool) -> np.ndarray:
    """By how much ours is faster, `simulate` and stepping, (targets, 2), printed; at least, where none of solve_ivp gets there
    within LIMIT, NaN where ours does not."""
    ratios = np.full((len(TARGETS[name]), 2), np.nan)
    for i, target in enumerate(TARGETS[name]):
        other, *ours = (fastest(rows, names, target) for names in (METHODS, ("simulate",), ("stepping",)))
        assert quick or all(row["repeats"] >= REPEATS for row in (other, *ours) if row), (other, *ours)
        if all(ours):
            ratios[i] = [(other["seconds"] if other else LIMIT) / row["seconds"] for row in ours]
        texts = [
            f"{row['who']} {row['nodes']} nodes, {row['setting']:.2g}: {row['error']:.1e} in {row['seconds'] * 1e3:.2f} ms"
            if row
            else "none"
            for row in (other, *ours)
        ]
        least = "" if other else "more than "
        print(f"{name:<8} {target:.0e}  {least}{ratios[i, 0]:.0f}, {ratios[i, 1]:.0f} times  {'; '.join(texts)}")
    return ratios


def orders(quick: bool):
    steps = np.array([10.0, 8.0, 5.0, 4.0, 2.5, 2.0, 1.0, 0.5][:: 2 if quick else 1])
    case = scene("bouncing")
    exact = road(case, 63, 0.25)
    # equal steps from the start: none shorter to begin with
    return steps, np.array([corrugation_difference(exact, road(case, 63, step, 1e-3)) for step in steps])


def main() -> None:
    chosen = options(__doc__)
    data, ratios = {}, {}
    tr.simulate(scene("smooth"), "continuum", samples=2)  # compiled code is loaded
    for name in AMPLITUDE:
        rows = sweep(name, chosen.quick)
        for what, (text, *units) in COLUMNS.items():
            label = {"long_name": f"{text}; {name} scene"} | ({"units": units[0]} if units else {})
            data[f"{name}_{what}"] = (f"{name}_run", np.array([row[what] for row in rows]), label)
        ratios[name] = compared(name, rows, chosen.quick)
        label = {"long_name": "relative error of the corrugation, or less", "units": "1"}
        data[f"{name}_target"] = (f"{name}_target", TARGETS[name], label)
        for j, ours in enumerate(("simulate", "stepping")):
            label = {"long_name": f"time of the fastest of solve_ivp over that of {ours}", "units": "1"}
            data[f"{name}_ratio_{ours}"] = (f"{name}_target", ratios[name][:, j], label)
    steps, errors = orders(chosen.quick)
    regular = (errors > 1e-10) & (steps <= 5)
    order = float(np.polyfit(np.log(steps[regular]), np.log(errors[regular]), 1)[0])
    print(f"order in the step, bouncing, step <= 5: {order:.2f}")
    data["step"] = ("step", steps, {"long_name": "longest time step", "units": "1"})
    text = "error of the road, bouncing, by the step"
    data["step_error"] = ("step", errors, {"long_name": text, "units": "1", "fitted_order": order})
    ds = xr.Dataset(data)
    ds.attrs = {"Conventions": "CF-1.11", "title": "Continuum against solve_ivp: error against time"}
    store("continuum_speed", chosen.output, ds, draw(ds))
    check(ds, order, chosen.quick)


def check(ds, order: float, quick: bool) -> None:
    assert order > 3.5, order
    for name in AMPLITUDE:
        who, steps, calls, reason = (ds[f"{name}_{what}"].values for what in ("who", "steps", "calls", "reason"))
        assert np.all(steps[reason == ""] > 0)
        assert np.array_equal(calls[reason == ""] > 0, np.isin(who, METHODS)[reason == ""])
    assert any("takes longer" in reason for reason in ds.bouncing_reason.values)
    if not quick:  # measured several times that; the coarser targets are dominated by the making of the Dataset
        assert ds.bouncing_ratio_simulate.values[-1] > 100, ds.bouncing_ratio_simulate


def draw(ds) -> Figure:
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 0.7))
    for axis, name, low in zip(axes, AMPLITUDE, (1e-14, 1e-7), strict=False):
        who, error, seconds, reason = (ds[f"{name}_{what}"].values for what in ("who", "error", "seconds", "reason"))
        edge = 3.0
        for one, (colour, marker) in STYLES.items():
            good, bad = (who == one) & (reason == ""), (who == one) & (reason != "")
            style = {"color": colour, "ms": 4, "ls": "none"}
            axis.plot(seconds[good] * 1e3, error[good], marker=marker, mfc="none", mew=0.8, label=one, **style)
            axis.plot(seconds[bad] * 1e3, np.full(bad.sum(), edge), marker="x", **style)
            edge *= 0.5 if bad.any() else 1.0  # so that none hides another
        for one, text, mark in (("stepping", "without Dataset", "."), ("simulate", "tr.simulate", "o")):
            mine = who == one
            axis.plot(seconds[mine] * 1e3, error[mine], mark, ms=4, mfc="none", color=BLUE, label=text)
        for target in SHOWN[name]:
            axis.axhline(target, lw=0.6, ls=":", color=BLACK)
            ratio = float(ds[f"{name}_ratio_simulate"][np.isclose(TARGETS[name], target, rtol=1e-6)].item())
            if np.isfinite(ratio):
                axis.text(1.01, target, f"{ratio:.0f}×", transform=axis.get_yaxis_transform(), va="center")
        axis.set(xscale="log", yscale="log", xlabel="time (ms)", ylabel="error of the road", ylim=(low / 2, 8.0))
        axis.set_title(f"{name.capitalize()}, amplitude {AMPLITUDE[name]:g}")
    figure.suptitle(
        "Error against time; crosses failed; n×: tr.simulate reaches that error n times as fast as solve_ivp"
    )
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, frameon=False)
    steps, errors = ds.step.values, ds.step_error.values
    axes[2].loglog(steps, errors, "o-", color=BLUE, ms=4)
    axes[2].loglog(steps, errors[-1] * (steps / steps[-1]) ** 4, "--", lw=0.8, color=BLACK, label="order 4")
    axes[2].set(title="Bouncing: order in the step", xlabel="step", ylabel="error of the road")
    axes[2].legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
