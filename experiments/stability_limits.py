"""Where steppers, relaxations and passages blow up: closed forms, and runs of cars on their road.

    car        a one-step map y' = A y + B h of (Z, P) from node to node: |eigenvalues of A| < 1
    relaxation explicit: |1 - 4 Delta dt/dx^2| < 1 at the grid's shortest wave
    passage    force from the height before: |1 - delta R| < 1 on every wave that fits on the ring, R = (h - Z)/h,
               where a headway later the car sees the wave multiplied: e^(i phi rows) = e^(2 pi i n/N) (1 - delta R)
               midpoint: none of its own; at delta = 4 Gamma cot(l/2) inverted bumps look to a car like its resonance

Each point is the least step, diffusion or softness at which a run grows, found by trying the whole range of runs side by
side. Cars of speed, frequency and mass 1. Of every run the roads are such that no true corrugation grows on them.

Run: python experiments/stability_limits.py [--quick]        (about 2 min; 8 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure

from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from traffic_road.schemes.oscillator import HOLDS, propagator
from traffic_road.schemes.passage import from_before, midpoint, response
from traffic_road.schemes.relaxation import RELAXATIONS, symbol
from traffic_road.schemes.ring import Ring, threshold
from traffic_road.schemes.steppers import STEPPERS

LENGTH = 1.6  # of the ring on which the road relaxes: its longest wave, k = 3.9, is damped
HEAVY, LIGHT = 2.0, 0.1  # dampings of the two charts of passages
STEEP = 2  # cars on the ring of the chart in dx, and nodes a headway
ROWS = 16  # nodes a headway in the chart in the headway


def along(matrix):
    """(..., 2, n) -> (2, n, ...), as `Ring` takes it."""
    return np.moveaxis(matrix, (-2, -1), (0, 1))


def car_limits(damping, headways, ways):
    """(steppers, damping): the longest step of a car; the road is well smoothed, so that cars do not corrugate it."""
    factor = symbol(1.0, 8, 8).reshape(-1, 1, 1)

    def grows(scheme, x):
        A, B = scheme.step(x, 1.0, damping)
        return Ring(2, 4, along(A), along(B), np.full(x.shape, 3e-4), factor=factor).grows(headways)

    ones = np.ones(damping.size)
    return np.array([threshold(lambda x, s=s: grows(s, x), 1e-2 * ones, 20 * ones, ways) for s in STEPPERS.values()])


def relaxation_limits(spacing, headways, ways):
    """(relaxations, spacing): the largest Delta dt of one relaxation a headway."""

    def grows(scheme, dx, x):
        nodes = round(LENGTH / dx)
        A, B = (c[0][..., None, None] for c in propagator(dx, 1.0, LIGHT, 3))
        factor = np.stack([scheme.step(d, LENGTH, nodes) for d in x.ravel()], axis=-1)[..., None]
        return Ring(2, nodes // 2, A, B, np.full(x.shape, 1e-3), factor=factor).grows(headways)

    return np.array(
        [
            [threshold(lambda x, s=s, dx=dx: grows(s, dx, x), 1e-2 * dx**2, 1e2 * dx**2, ways)[0] for dx in spacing]
            for s in RELAXATIONS.values()
        ]
    )


def passage_limits(passage, count, rows, spacing, damping, hold, headways, ways, high=10.0):
    """(spacing,): the largest softness of a passage."""
    A, B = map(along, propagator(spacing, 1.0, damping, hold))
    ones = np.ones(spacing.size)
    return threshold(
        lambda x: Ring(count, rows, A[:, :, None], B[:, :, None], x, passage).grows(headways),
        1e-2 * ones,
        high * ones,
        ways,
    )


def softest(count, rows, spacing, damping, hold):
    """The closed form for the force from before: the least delta = 2 Re 1/R(phi) over the waves that fit on the ring."""
    A, B = (c[0] for c in propagator(spacing, 1.0, damping, hold))
    # where the true R(ik) presses down, k > 1; to the shortest wave and a little beyond, to find it by a change of sign
    phi = np.geomspace(1.0001 * spacing, np.pi + 1e-3, 10_001)
    inverse = 1 / response(A, B, np.exp(1j * phi))
    delta = 2 * inverse.real
    left = 1 - delta / inverse
    turns = (rows * phi - np.unwrap(np.angle(left))) * count / (2 * np.pi)  # whole where the wave fits
    low, high = turns[:-1], turns[1:]
    whole = np.rint((low + high) / 2)
    fits = ((low - whole) * (high - whole) <= 0) & (delta[:-1] > 0)
    share = (whole - low)[fits] / (high - low)[fits]
    return np.min(delta[:-1][fits] + share * np.diff(delta)[fits])


def main() -> None:
    chosen = options(__doc__)
    quick = chosen.quick
    ways = 32 if quick else 64
    damping = np.geomspace(0.3, 3.0, 4) if quick else np.geomspace(0.05, 3.0, 13)
    spacing = np.array([0.1]) if quick else np.array([0.025, 0.05, 0.1, 0.2, 0.4])
    dx = np.geomspace(0.01, 0.3, 4 if quick else 9)
    headway = np.array([0.5, 1.0, 2.0]) if quick else np.geomspace(0.2, 2.5, 10)
    long, short, far = (300, 200, 400) if quick else (6000, 1000, 3000)

    ds = xr.Dataset(
        coords={
            "stepper": ("stepper", list(STEPPERS), {"long_name": "how the car crosses from node to node"}),
            "relaxation": ("relaxation", list(RELAXATIONS), {"long_name": "how the road relaxes"}),
            "hold": ("hold", list(HOLDS), {"long_name": "degree of the contact height's polynomial", "units": "1"}),
            "count": ("count", [1, 2], {"long_name": "cars on the ring", "units": "1"}),
            "damping": ("damping", damping, {"long_name": "damping of the car", "units": "1"}),
            "spacing": ("spacing", spacing, {"long_name": "node spacing of the relaxing road", "units": "1"}),
            "dx": ("dx", dx, {"long_name": "node spacing under the passages", "units": "1"}),
            "headway": ("headway", headway, {"long_name": "headway", "units": "1"}),
        },
        attrs={
            "Conventions": "CF-1.11",
            "title": "Stability limits of steppers, relaxations and passages, closed forms and measured",
            "damping_in_dx": HEAVY,
            "damping_in_headway": LIGHT,
        },
    )

    def put(name, dims, what, closed, measured):
        ds[name] = (dims, closed, {"long_name": f"largest stable {what}", "units": "1"})
        ds[f"{name}_measured"] = (dims, measured, {"long_name": f"largest stable {what}, of runs", "units": "1"})

    limits = [s.limit(1.0, damping) for s in STEPPERS.values()]
    put("step", ("stepper", "damping"), "step of the car", limits, car_limits(damping, long, ways))
    limits = [[s.limit(h) for h in spacing] for s in RELAXATIONS.values()]
    measured = relaxation_limits(spacing, short, ways)
    put("diffusion", ("relaxation", "spacing"), "diffusivity * interval", limits, measured)
    limits = [[softest(STEEP, STEEP, h, HEAVY, hold) for h in dx] for hold in HOLDS]
    measured = [passage_limits(from_before, STEEP, STEEP, dx, HEAVY, hold, short, ways) for hold in HOLDS]
    put("softness_in_dx", ("hold", "dx"), "softness of a passage, force from before", limits, measured)
    limits = [[softest(n, ROWS, ell / ROWS, LIGHT, 5) for ell in headway] for n in (1, 2)]
    grid = headway / ROWS
    measured = [passage_limits(from_before, n, ROWS, grid, LIGHT, 5, far, ways) for n in (1, 2)]
    put("softness_in_headway", ("count", "headway"), "softness of a passage, force from before", limits, measured)
    measured = passage_limits(midpoint, 2, ROWS, grid, LIGHT, 5, far, ways)
    put("softness_midpoint", "headway", "softness of a passage, midpoint", 4 * LIGHT / np.tan(headway / 2), measured)

    store("stability_limits", chosen.output, ds, draw(ds))
    for name in ("step", "diffusion", "softness_in_dx", "softness_in_headway", "softness_midpoint"):
        closed, measured = ds[name].values, ds[f"{name}_measured"].values
        finite = np.isfinite(closed)
        error = np.abs(measured[finite] / closed[finite] - 1).max()
        print(f"{name}: {finite.sum()} limits measured, at most {error:.2%} from the closed form")
        # the runs' own resolution: 0.2 % in the range tried (quick: 0.7 %), and the growth that they have time for
        assert error < (0.01 if quick else 0.005), (name, measured, closed)
        assert np.all(np.isinf(measured[~finite])), (name, measured)


def draw(ds) -> Figure:
    figure = Figure(figsize=(7.3, 6.4), layout="constrained")
    (car, road), (fine, far) = figure.subplots(2, 2)

    limited = [name for name, scheme in STEPPERS.items() if np.isfinite(scheme.limit(1.0, 1.0))]
    for name, colour, marker in zip(limited, (RED, ORANGE, GREEN, BLUE, PURPLE), "os^Dv", strict=True):
        gamma = np.geomspace(ds.damping[0], ds.damping[-1], 300)
        car.loglog(gamma, STEPPERS[name].limit(1.0, gamma), "-", color=colour, lw=1)
        car.plot(ds.damping, ds.step_measured.sel(stepper=name), marker, color=colour, mfc="none", label=name)
    car.set(
        xlabel="damping $\\Gamma$",
        ylabel="longest stable step $\\omega\\,dt$",
        title="Cars: trapezoid and exact steps have no limit",
        ylim=(None, 60),
    )
    car.legend(fontsize="small", frameon=False, loc="upper left")

    h = np.geomspace(ds.spacing[0] / 1.3, ds.spacing[-1] * 1.3, 50)
    road.loglog(h, h**2 / 2, "-", color=BLUE, lw=1)
    road.plot(
        ds.spacing, ds.diffusion_measured.sel(relaxation="explicit"), "o", color=BLUE, mfc="none", label="explicit"
    )
    top = 100 * h**2
    road.fill_between(h, h**2 / 2, top, color=SKY, alpha=0.25, lw=0, label="explicit blows up, Crank–Nicolson rings")
    for name, marker, shift in (("Crank-Nicolson", "^", 0.93), ("backward Euler", "s", 1.0), ("exact", "v", 1.07)):
        never = np.isinf(ds.diffusion_measured.sel(relaxation=name).values)
        tried = 100 * ds.spacing.values[never] ** 2
        road.plot(
            ds.spacing.values[never] * shift, tried, marker, color=BLACK, ms=5, label=f"{name}: tried to here, stable"
        )
    _ticks(road.xaxis, (0.02, 0.05, 0.1, 0.2, 0.5), h)
    road.set(
        xlabel="node spacing $dx$ $(v/\\omega_0)$",
        ylabel="$\\Delta\\,dt$ of one relaxation $(v^2/\\omega_0^2)$",
        title="Relaxation: the explicit step ends at $dx^2/2$",
    )
    low, high = road.get_ylim()
    road.set_ylim(low, high * 300)
    road.legend(fontsize="small", frameon=False, loc="upper left")

    styles = {1: (BLUE, "o", "linear"), 3: (GREEN, "s", "cubic"), 5: (RED, "^", "quintic")}
    for hold, (colour, marker, name) in styles.items():
        fine.semilogx(ds.dx, ds.softness_in_dx.sel(hold=hold), "-", color=colour, lw=1)
        measured = ds.softness_in_dx_measured.sel(hold=hold)
        fine.plot(ds.dx, measured, marker, color=colour, mfc="none", label=f"{name} hold")
    fine.axhline(2.0, color=BLACK, lw=0.6, ls=":")
    fine.set(
        xlabel="node spacing $dx$ $(v/\\omega_0)$",
        ylabel="softness of a passage $\\delta\\, m\\omega^2$",
        title=f"Force from the height before, shortest waves\n($\\Gamma={HEAVY:g}$): 2 on fine grids, less on coarse",
        ylim=(0.8, 2.3),
    )
    fine.legend(fontsize="small", frameon=False, loc="lower left")

    cases = (
        (ds.softness_midpoint, ds.softness_midpoint_measured, "midpoint, 2 cars on the ring", BLUE, "D"),
        (ds.softness_in_headway[0], ds.softness_in_headway_measured[0], "force from before, 1 car", ORANGE, "o"),
        (ds.softness_in_headway[1], ds.softness_in_headway_measured[1], "force from before, 2 cars", RED, "s"),
    )
    for closed, measured, name, colour, marker in cases:
        far.loglog(ds.headway, closed, "-", color=colour, lw=1)
        far.plot(ds.headway, measured, marker, color=colour, mfc="none", label=name)
    far.axhline(2.0, color=BLACK, lw=0.6, ls=":")
    _ticks(far.xaxis, (0.2, 0.5, 1.0, 2.0), ds.headway.values)
    far.set(
        xlabel="headway $\\ell$ $(v/\\omega_0)$",
        ylabel="softness of a passage $\\delta\\, m\\omega^2$",
        title=f"Force from before, long waves ($\\Gamma={LIGHT:g}$):\nfalse growth while the midpoint's road decays",
    )
    far.legend(fontsize="small", frameon=False, loc="lower left")
    for axes in (car, road, fine, far):
        axes.title.set_fontsize("small")
    figure.suptitle("Where methods fail: closed forms (lines) and runs of cars on their road (points)")
    return figure


def _ticks(axis, values, shown):
    """Plain numbers on a short logarithmic axis."""
    values = [v for v in values if shown.min() <= v <= shown.max()]
    axis.set_ticks(values, [f"{v:g}" for v in values])
    axis.set_ticks([], minor=True)


if __name__ == "__main__":
    main()
