"""The continuum against solve_ivp: error of the road against computing time, one wave of the paper's road for T = 400.

Two scenes, k = 0.9, Gamma = 0.1, Delta = 0.01, alpha = 0.006. Smooth: amplitude 1e-3, cars never take off; the reference
is the matrix exponential of one wave. Bouncing: amplitude 1.5, cars take off at every wave; the reference is this package
with 511 nodes and step 0.5, whose own error is about 3e-9 (errors fall as nodes^-3.3: the road's curvature has corners).

Beside `tr.simulate` as a user calls it (error estimate and Dataset included) and the bare time stepping, all methods of
solve_ivp over sweeps of tolerance and grid. Their right-hand side is spectral, in numpy, on the nodes; derivatives by
transforms or by a matrix, whichever is faster on that grid. On a grid, tolerances are tightened until the error stays
the same; a method is given up, and finer grids with it, at a run that takes longer than 8 s. Times are the best of
several; ours of as many scenes, made beforehand as the right-hand sides are, that differ by a rounding, so that no run
finds what another has left in memory. The error is that of the corrugation: L2 over the road, mean removed, relative. A
comparison at equal error takes the fastest run of each that is at least as good; where no run of solve_ivp is, 8 s stand
for one.

The last panel shows the order in the step, on 63 nodes: cars take off and land inside the grid, and the order stays four.

Run: python experiments/continuum_speed.py [--quick]        (about 4 min; 8 s)
"""

from time import perf_counter

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import traffic_road as tr
from traffic_road.estimate import corrugation_difference
from traffic_road.models import continuum
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED

K, DAMPING, DIFFUSIVITY, SOFTNESS, END = 0.9, 0.1, 0.01, 0.006, 400.0
LENGTH = 2 * np.pi / K
METHODS = {"RK45": ORANGE, "DOP853": GREEN, "LSODA": PURPLE, "BDF": RED, "Radau": BLACK}
AMPLITUDE = {"smooth": 1e-3, "bouncing": 1.5}
TARGETS = {"smooth": (1e-6,), "bouncing": (1e-4, 1e-6)}
LIMIT = 8.0  # seconds
STEPS = (16.0, 12.5, 10.0, 8.0, 6.25, 5.0, 4.0, 2.5, 2.0, 1.0)


class TooLong(Exception):
    pass


def scene(name: str, roundings: int = 0) -> tr.Scene:
    """roundings: of the phase, that make it another scene, of which no run before this has left anything in memory."""
    profile = tr.Sine(AMPLITUDE[name], K, np.pi / 2 - roundings * np.spacing(np.pi / 2))
    return tr.Scene(tr.Road(LENGTH, SOFTNESS, DIFFUSIVITY, profile), tr.Fleet(1, DAMPING), duration=END)


def reference(name: str, quick: bool) -> np.ndarray:
    """The road at the end, on nodes."""
    if name == "bouncing":
        return road(name, *((255, 1.0) if quick else (511, 0.5)))
    # H, Z, P of the wave exp(ikx), in contact: from the settled start by one matrix exponential
    ik = 1j * K
    system = np.array(
        [
            [-DIFFUSIVITY * K**2 - SOFTNESS, SOFTNESS, 0],
            [2 * DAMPING, -2 * DAMPING - ik, 1],
            [1, -1, -ik],
        ]
    )
    start = np.array([1, (1 + 2 * DAMPING * ik) / (1 - K**2 + 2 * DAMPING * ik), ik / (1 - K**2 + 2 * DAMPING * ik)])
    wave = AMPLITUDE[name] * (expm(END * system) @ start)[0]
    return (wave * np.exp(1j * K * np.arange(64) * LENGTH / 64)).real


def road(name: str, nodes: int, step: float) -> np.ndarray:
    *_, last = continuum.samples(scene(name), np.array([0.0, END]), {"nodes": nodes, "step": step})
    return last.road_height


# --- the other side: the equations on the nodes, for solve_ivp


def right_hand_side(nodes: int, by_matrix: bool):
    wave = 2j * np.pi / LENGTH * np.arange(nodes // 2 + 1)
    second = (wave**2).real * DIFFUSIVITY
    if nodes % 2 == 0:
        wave[-1] = 0.0
    weights = np.array([second, -wave, -wave])
    of_nodes = np.fft.irfft(
        np.fft.rfft(np.eye(nodes)) * weights[:, None], nodes
    ).copy()  # row j: derivative of node j's peak

    def derivatives(y):
        if by_matrix:
            return np.matmul(y[:, None], of_nodes)[:, 0]
        return np.fft.irfft(np.fft.rfft(y) * weights, nodes)

    def rhs(t, state):
        y = state.reshape(3, nodes)
        out = derivatives(y)
        compression = y[0] - y[1]
        out[0] -= SOFTNESS * np.maximum(0.0, 1.0 + compression)
        out[1] += y[2] + 2 * DAMPING * compression
        out[2] += compression
        return out.ravel()

    return rhs


def start_of(name: str, nodes: int) -> np.ndarray:
    phase = K * np.arange(nodes) * LENGTH / nodes
    response = 1 / (1 - K**2 + 2j * DAMPING * K)
    waves = np.array([1, (1 + 2j * DAMPING * K) * response, 1j * K * response])
    state = AMPLITUDE[name] * (waves[:, None] * np.exp(1j * phase)).real
    state[2] -= SOFTNESS  # the road sinks steadily
    return state.ravel()


def faster_rhs(name: str, nodes: int):
    """Of derivatives by transforms and by a matrix the faster."""
    state = start_of(name, nodes)
    both = [right_hand_side(nodes, by_matrix) for by_matrix in (False, True)]
    times = [best(lambda f=f: [f(0.0, state) for _ in range(20)], 5)[0] for f in both]
    return both[int(np.argmin(times))]


def best(call, most: int, patience: float = 0.5):
    """The shortest of up to `most` times of call(), none after `patience` seconds in all; and what it returned."""
    shortest, spent = np.inf, 0.0
    for _ in range(most):
        begin = perf_counter()
        result = call()
        took = perf_counter() - begin
        shortest, spent = min(shortest, took), spent + took
        if spent > patience:
            break
    return shortest, result


def integrate(name, method, nodes, rtol, limit):
    rhs, start = faster_rhs(name, nodes), start_of(name, nodes)

    def call():
        end = perf_counter() + limit

        def watched(t, y):
            if perf_counter() > end:
                raise TooLong
            return rhs(t, y)

        atol = 0.1 * rtol * AMPLITUDE[name]
        return solve_ivp(watched, (0.0, END), start, method=method, t_eval=[END], rtol=rtol, atol=atol).y[:nodes, -1]

    return best(call, 3)


def sweep(name: str, quick: bool):
    """Rows (who, nodes, step or rtol, error, seconds)."""
    exact, rows = reference(name, quick), []
    tr.simulate(scene(name), "continuum", samples=2)  # compiled code is loaded

    def add(who, nodes, setting, seconds, height):
        error = corrugation_difference(exact, height) if np.all(np.isfinite(height)) else np.nan
        rows.append((who, nodes, setting, error, seconds))

    if name == "smooth":
        grids, tolerances, mine = (4, 6, 8), np.logspace(-2, -8, 13), [(nodes, END) for nodes in (4, 8, 16, 32)]
    else:
        grids, tolerances = (16, 24, 32, 40, 48, 64, 96, 128, 192, 256, 320), np.logspace(-2, -6, 9)
        mine = [(n, step) for n in (11, 15, 19, 21, 23, 27, 33, 41, 55, 71, 81, 91, 101) for step in STEPS]
    if quick:
        grids, tolerances, mine = grids[:3], tolerances[::6], mine[::6]
    for nodes, step in mine:
        call = {"model": "continuum", "samples": 2, "progress": False, "nodes": nodes, "step": step}
        scenes = iter([scene(name, 1 + i) for i in range(15)])
        seconds, ds = best(lambda call=call, scenes=scenes: tr.simulate(next(scenes), **call), 3 if quick else 15)
        add("simulate", nodes, step, seconds, ds.road_height.values[-1])
        seconds, height = best(lambda n=nodes, s=step: road(name, n, s), 3 if quick else 15)
        add("stepping", nodes, step, seconds, height)
    for method in METHODS:
        too_long = False
        for nodes in grids:
            explicit = method in ("RK45", "DOP853")  # their steps are set by stability, whatever the tolerance
            before = np.inf
            for rtol in tolerances[2::4] if explicit else tolerances[:: 2 if nodes > 64 else 1]:
                try:
                    seconds, height = integrate(name, method, nodes, rtol, 0.2 if quick else LIMIT)
                except TooLong:
                    too_long = True
                    break
                add(method, nodes, rtol, seconds, height)
                if abs(rows[-1][3] / before - 1) < 0.03:  # what is left is the grid's
                    break
                before = rows[-1][3]
            if too_long:  # and longer still on finer grids
                break
    return rows


def fastest(rows, names, target):
    """The row that takes the least time to an error of `target` or less."""
    fit = [row for row in rows if row[0] in names and row[3] <= target]
    return min(fit, key=lambda row: row[4]) if fit else None


def orders(quick: bool):
    steps = np.array([10.0, 8.0, 5.0, 4.0, 2.5, 2.0, 1.0, 0.5][:: 2 if quick else 1])
    exact = road("bouncing", 63, 0.25)
    return steps, np.array([corrugation_difference(exact, road("bouncing", 63, step)) for step in steps])


def main() -> None:
    chosen = options(__doc__)
    data, ratios = {}, {}
    for name in AMPLITUDE:
        rows = sweep(name, chosen.quick)
        label = {"long_name": f"who, {name} scene"}
        data[f"{name}_who"] = (f"{name}_run", np.array([row[0] for row in rows]), label)
        texts = ("nodes", "step of ours, rtol of solve_ivp", "relative error of the corrugation", "time, s")
        for i, (what, text) in enumerate(zip(("nodes", "setting", "error", "seconds"), texts, strict=True), 1):
            data[f"{name}_{what}"] = (f"{name}_run", np.array([row[i] for row in rows]), {"long_name": text})
        for target in TARGETS[name]:
            other, ours, bare = (fastest(rows, names, target) for names in (METHODS, ("simulate",), ("stepping",)))
            for who, nodes, setting, error, seconds in filter(None, (other, ours, bare)):
                text = f"{who:<9} nodes {nodes:<4} {setting:<8.2g} {error:.1e} {seconds * 1e3:9.2f} ms"
                print(f"{name:<9} {target:.0e} {text}")
            if ours and (other or not chosen.quick):
                seconds = other[4] if other else LIMIT
                ratio, of_bare = ratios[name, target] = seconds / ours[4], seconds / bare[4]
                print(
                    f"{name:<9} {target:.0e} ratio{'' if other else ' >'} {ratio:.0f}, of bare stepping {of_bare:.0f}"
                )
    steps, errors = orders(chosen.quick)
    regular = (errors > 1e-10) & (steps <= 5)
    order = float(np.polyfit(np.log(steps[regular]), np.log(errors[regular]), 1)[0])
    print(f"order in the step, bouncing, step <= 5: {order:.2f}")
    data["step"] = ("step", steps, {"long_name": "longest time step", "units": "1"})
    text = "error of the road, bouncing, by the step"
    data["step_error"] = ("step", errors, {"long_name": text, "units": "1", "fitted_order": order})
    ds = xr.Dataset(data)
    ds.attrs = {"Conventions": "CF-1.11", "title": "Continuum against solve_ivp: error against time"}
    for (name, target), (ratio, bare) in ratios.items():
        ds.attrs[f"ratio_{name}_{target:.0e}"], ds.attrs[f"ratio_{name}_{target:.0e}_stepping"] = ratio, bare
    store("continuum_speed", chosen.output, ds, draw(ds, ratios))
    assert order > 3.5, order
    if not chosen.quick:  # measured several times that; the coarser targets are dominated by the making of the Dataset
        assert ratios["bouncing", 1e-6][0] > 100, ratios


def draw(ds, ratios) -> Figure:
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 0.7))
    for axis, name, low in zip(axes, AMPLITUDE, (1e-14, 1e-7), strict=False):
        who, error, seconds = (ds[f"{name}_{what}"].values for what in ("who", "error", "seconds"))
        shown = np.clip(np.nan_to_num(error, nan=1.0), low, 1.0)  # what has blown up stands at the edge
        for one, colour in METHODS.items():
            axis.loglog(seconds[who == one] * 1e3, shown[who == one], "x", ms=4, color=colour, label=one)
        for one, text, mark in (("stepping", "without Dataset", "."), ("simulate", "tr.simulate", "o")):
            mine = who == one
            axis.loglog(seconds[mine] * 1e3, shown[mine], mark, ms=4, mfc="none", color=BLUE, label=text)
        for target in TARGETS[name]:
            axis.axhline(target, lw=0.6, ls=":", color=BLACK)
            if (name, target) in ratios:
                ratio = f"{ratios[name, target][0]:.0f} times"
                axis.text(0.99, target, ratio, transform=axis.get_yaxis_transform(), ha="right", va="bottom")
        axis.set(
            title=f"{name.capitalize()}, amplitude {AMPLITUDE[name]:g}", xlabel="time (ms)", ylabel="error of the road"
        )
        axis.set_ylim(low / 2, 2.0)
    axes[1].legend(frameon=False, fontsize="small", loc="upper left", ncols=2)
    steps, errors = ds.step.values, ds.step_error.values
    axes[2].loglog(steps, errors, "o-", color=BLUE, ms=4)
    axes[2].loglog(steps, errors[-1] * (steps / steps[-1]) ** 4, "--", lw=0.8, color=BLACK, label="order 4")
    axes[2].set(title="Bouncing: order in the step", xlabel="step", ylabel="error of the road")
    axes[2].legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
