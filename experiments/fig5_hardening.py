"""Figure 5 of Both, Hong and Kurtze: growth rate and velocity of a wave on a road that hardens, with constant diffusion.

    alpha(H) = alpha_0 exp(epsilon H), Delta constant: as the flat road H_0(t) settles, alpha falls, and beside
    diffusion the hardening rate beta = -d ln(alpha)/dt = epsilon alpha (1 + H_0 - Z_0) works against the wave.

Lines: runs of the continuum and of discrete cars, from a small wave with cars settled on the road as it is at the start.
Symbols: the cubic with the coefficients of the moment frozen,

    (sigma + beta + Delta k^2) [(sigma + ik)^2 + 2 Gamma (sigma + ik) + 1] + alpha (sigma + ik)^2 = 0,

alpha(H_0(t)) and beta(t) from the full equations of the settling flat road. Dotted: its leading order in small alpha,
sigma = -beta - Delta k^2 - alpha R(ik), which is off by a third. That order is what the run starts with, since cars that
are settled on a road at rest do not know that the wave moves and grows; within a few 1/Gamma they do. Symbols are open
while that lasts, t < 5/Gamma, and wherever coefficients are not slow, beta > Gamma/20 (on no curve here).

What frozen coefficients miss is found by the next order of the same expansion (own derivation): a rate sigma(t) gives
R(d/dt + ik) h = [R(s) + R''(s) (d sigma/dt)/2 + ...] h with s = sigma + ik, so that to the root of the cubic comes
-(alpha R''/2) (d sigma/dt)/(1 + alpha R'). The runs have it: it takes up nearly all of the difference.

Run: python experiments/fig5_hardening.py [--quick]        (about 8 s; 5 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, RED

K, SOFTNESS, DAMPING, DIFFUSIVITY = 0.90, 0.004, 0.1, 0.01
STYLES = {0.5: ("o", BLUE), 0.1: ("s", ORANGE), 0.05: ("D", GREEN), 0.01: ("^", RED)}  # epsilon: the paper's symbols
AMPLITUDE = 1e-3  # small enough for the linear theory: epsilon^2 amplitude^2 < 1e-6; rounding is felt at 1e-12
CARS = 8  # a wavelength
TRANSIENT = 5 / DAMPING  # by then the cars' own oscillation, exp(-Gamma t), is down to 1 %
SLOW = 0.05  # largest change of ln(alpha) in 1/Gamma that passes for slow
EARLY, COARSE = 80.0, 10  # until EARLY rates from every sample, to show the transient; then from every 10th
QUANTITIES = {"growth_rate": "growth rate", "phase_velocity": "phase velocity"}


def study(k: float, softness: float, diffusivity, amplitude: float, duration: float) -> xr.Dataset:
    """Rates of one wave against time for every epsilon: continuum, cars, cubic, leading order.

    diffusivity(epsilon) -> the law of diffusion. Dims hardening, time, time_cars.
    """
    found = []
    for epsilon in STYLES:
        law, diffusion = tr.Exponential(softness, epsilon), diffusivity(epsilon)
        road = tr.Road(2 * np.pi / k, law, diffusion, tr.Sine(amplitude, k))
        scene = tr.Scene(road, tr.Fleet(CARS, DAMPING), duration)
        continuum = tr.simulate(scene, "continuum", samples=round(duration) + 1, nodes=16, step=1.0, progress=False)
        headways = round(duration / scene.headway)
        cars = tr.simulate(scene, "cars", samples=headways + 1, nodes=12 * CARS, hold=5, progress=False)
        assert continuum.status == cars.status == "ok", (continuum.status, cars.status)
        rates = xr.merge([measured(continuum, k), measured(cars, k, "_cars")])
        found.append(rates.merge(frozen(k, law, diffusion, rates.time.values)))
    epsilons = xr.Variable("hardening", list(STYLES), {"long_name": "epsilon = d ln(softness)/dH", "units": "1"})
    return xr.concat(found, epsilons, combine_attrs="override")


def measured(ds: xr.Dataset, k: float, suffix: str = "") -> xr.Dataset:
    """Growth rate and phase velocity of a run over `time` + suffix, but for its two ends (one-sided differences)."""
    early, late = ds.sel(time=slice(0, EARLY)), ds.isel(time=slice(0, None, COARSE))
    out = {}
    for name, rate in (("growth_rate", tr.growth_rate), ("phase_velocity", tr.phase_velocity)):
        first, rest = rate(early, k)[1:-1], rate(late, k)[1:-1]
        joined = xr.concat([first, rest.where(rest.time > first.time[-1], drop=True)], "time")
        joined.attrs = first.attrs
        out[name + suffix] = joined.rename({"time": "time" + suffix})
    return xr.Dataset(out)


def frozen(k: float, law, diffusion, times) -> xr.Dataset:
    """The cubic and its leading order with the coefficients of every moment."""
    flat = tr.theory.settle(law, DAMPING, times)
    diffusivity = tr.Constant(diffusion)(0) if np.isscalar(diffusion) else diffusion(flat.road_height.values)
    coefficients = {
        "softness": flat.softness.values,
        "diffusivity": diffusivity,
        "damping": DAMPING,
        "hardening_rate": flat.hardening_rate.values,
    }
    out = {"softness": flat.softness, "hardening_rate": flat.hardening_rate}
    cubic, leading = (relation(k, **coefficients) for relation in (tr.theory.dispersion, tr.theory.dispersion_leading))
    slope, bend = response_derivatives(cubic + 1j * k)
    softness = flat.softness.values
    drift = softness * bend / 2 * np.gradient(cubic, times) / (1 + softness * slope)
    for name, sigma, text in (
        ("cubic", cubic, "by the cubic, coefficients frozen"),
        ("leading", leading, "by the leading order, coefficients frozen"),
        ("next", cubic - drift, "by the cubic, coefficients slow to the next order"),
    ):
        for quantity, values in (("growth_rate", sigma.real), ("phase_velocity", -sigma.imag / k)):
            attributes = {"long_name": f"{QUANTITIES[quantity]} {text}", "units": "1"}
            out[f"{quantity}_{name}"] = ("time", values, attributes)
    return xr.Dataset(out)


def response_derivatives(s):
    """R'(s) and R''(s) of R = s^2/(s^2 + 2 Gamma s + 1)."""
    quadratic = s**2 + 2 * DAMPING * s + 1
    slope = 2 * s * (1 + DAMPING * s) / quadratic**2
    bend = 2 * (1 + 2 * DAMPING * s) / quadratic**2 - 8 * s * (1 + DAMPING * s) * (s + DAMPING) / quadratic**3
    return slope, bend


def trusted(ds: xr.Dataset) -> xr.DataArray:
    """Where frozen coefficients should do: transients over, and alpha slow on the time scale 1/Gamma of the cars."""
    return (ds.time >= TRANSIENT) & (ds.hardening_rate < SLOW * DAMPING)


def deviations(ds: xr.Dataset, quantity: str) -> dict:
    """Largest differences by epsilon, in units of max |cubic|: of run, leading and next order, and of cars from continuum.

    run and leading order: from the cubic; next: of the run from the next order, for t > 3 x 5/Gamma (see `check`).
    """
    cubic, there = ds[f"{quantity}_cubic"], trusted(ds)
    unit = abs(cubic).max("time")
    run = ds[quantity].interp(time=ds.time_cars)
    cars = (ds[f"{quantity}_cars"] - run).where((ds.time_cars >= TRANSIENT) & run.notnull())
    return {
        "run": (abs(ds[quantity] - cubic).where(there).max("time") / unit).values,
        "leading": (abs(ds[f"{quantity}_leading"] - cubic).where(there).max("time") / unit).values,
        "next": (abs(ds[quantity] - ds[f"{quantity}_next"]).where(ds.time >= 3 * TRANSIENT).max("time") / unit).values,
        "cars": (abs(cars).max("time_cars") / unit).values,
    }


def report(ds: xr.Dataset) -> dict:
    """Print and return the `deviations` of both quantities."""
    out = {quantity: deviations(ds, quantity) for quantity in QUANTITIES}
    print(
        f"largest beta/Gamma {float(ds.hardening_rate.max()) / DAMPING:.3f}; in units of max |cubic|, for t > 5/Gamma:"
    )
    print(f"{'epsilon':>24}" + "".join(f"{epsilon:>10g}" for epsilon in ds.hardening.values))
    for quantity, rows in out.items():
        for name, values in rows.items():
            print(f"{quantity:<15} {name:<8}" + "".join(f"{value:10.1e}" for value in values))
    return out


def check(differences: dict) -> None:
    """Runs against the cubic, and cars against the continuum."""
    for quantity, rows in differences.items():
        # left over: transients of exp(-5), and what frozen coefficients miss
        assert np.all(rows["run"] < 0.02), (quantity, rows["run"])
        # without transients, exp(-15): the second derivative of sigma, beta/Gamma smaller still, and the step of 10
        assert np.all(rows["next"] < 2e-4), (quantity, rows["next"])
        # second order in the headway: a few 1e-4 at 8 cars a wavelength, relaxation once a headway included
        assert np.all(rows["cars"] < 1e-3), (quantity, rows["cars"])


def draw_rates(axes, ds: xr.Dataset, quantity: str, marks: int = 11) -> None:
    """One panel: lines of the runs, symbols of the cubic, dotted leading order."""
    at = np.unique(np.searchsorted(ds.time.values, np.linspace(0, float(ds.time[-1]), marks)))
    middles = (ds.time.values[at[1:]] + ds.time.values[at[:-1]]) / 2
    between = np.searchsorted(ds.time_cars.values[:-1], middles)
    late = ds.time.values >= TRANSIENT / 2
    for epsilon, (marker, colour) in STYLES.items():
        one = ds.sel(hardening=epsilon)
        axes.plot(one.time, one[quantity], "-", color=colour, lw=2.5, alpha=0.45)
        axes.plot(one.time_cars[between], one[f"{quantity}_cars"][between], "x", color=BLACK, ms=4)
        axes.plot(one.time, one[f"{quantity}_leading"], ":", color=colour, lw=1.3)
        for fill, chosen in ((colour, trusted(one)[at].values), ("none", ~trusted(one)[at].values)):
            axes.plot(one.time[at][chosen], one[f"{quantity}_cubic"][at][chosen], marker, color=colour, mfc=fill, ms=5)
    values = np.concatenate([ds[quantity].values[:, late].ravel(), ds[f"{quantity}_leading"].values.ravel()])
    room = 0.06 * np.ptp(values)
    axes.set_ylim(values.min() - room, values.max() + room)
    axes.set(xlabel="time $t\\ (1/\\omega_0)$", xlim=(-0.01 * float(ds.time[-1]), 1.01 * float(ds.time[-1])))


def legend(figure: Figure) -> None:
    """What lines and symbols mean, below the panels."""
    axes = figure.axes[0]
    entries = [
        axes.plot([], [], marker, color=colour, ls="-", label=f"$\\epsilon={epsilon:g}$")[0]
        for epsilon, (marker, colour) in STYLES.items()
    ]
    entries += [
        axes.plot([], [], "-", color="0.6", lw=2.5, label="continuum, simulated")[0],
        axes.plot([], [], "x", color=BLACK, ms=4, label=f"{CARS} cars a wavelength, simulated")[0],
        axes.plot([], [], "o", color="0.4", label="cubic, frozen coefficients")[0],
        axes.plot([], [], "o", color="0.4", mfc="none", label="the same, before $5/\\Gamma$")[0],
        axes.plot([], [], ":", color="0.4", label="leading order")[0],
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=5, frameon=False, fontsize="x-small")


def draw(ds: xr.Dataset) -> Figure:
    figure = Figure(figsize=(9.2, 4.9), layout="constrained")
    figure.suptitle("A road that hardens but keeps diffusing: every wave ends up decaying, as the frozen cubic says")
    left, right = figure.subplots(1, 2)
    for axes, quantity in ((left, "growth_rate"), (right, "phase_velocity")):
        draw_rates(axes, ds, quantity)
    left.axhline(0, color=BLACK, lw=0.6)
    left.set(ylabel="growth rate Re $\\sigma\\ (\\omega_0)$", title="(a) growth rate")
    right.set(ylabel="phase velocity $c\\ (v)$", title="(b) phase velocity, with the traffic")
    legend(figure)
    return figure


def main() -> None:
    chosen = options(__doc__)
    ds = study(K, SOFTNESS, lambda epsilon: DIFFUSIVITY, AMPLITUDE, 500.0 if chosen.quick else 2500.0)
    ds.attrs = {"Conventions": "CF-1.11", "title": "Growth rate and velocity of a wave on a road that hardens"}
    ds.attrs |= {"wavenumber": K, "softness": SOFTNESS, "diffusivity": DIFFUSIVITY, "damping": DAMPING}
    differences = report(ds)
    start = frozen(K, tr.Exponential(SOFTNESS, 0.01), DIFFUSIVITY, [0.0, 1.0])
    excess = float(start.growth_rate_leading[0] / start.growth_rate_cubic[0]) - 1
    ds.attrs["leading_order_excess"] = excess
    print(f"leading order over cubic at t = 0, epsilon = 0.01: {excess:+.1%}")
    for epsilon in STYLES:
        decays = ds.time.values[ds.growth_rate_cubic.sel(hardening=epsilon).values < 0]
        print(f"epsilon = {epsilon:g}: the wave decays from t = {decays[0] if decays.size else np.inf:.0f}")
    store("fig5_hardening", chosen.output, ds, draw(ds))

    check(differences)
    assert abs(excess - 0.32) < 0.005, excess  # alpha_0 = 0.004 is not small against 2 Gamma^2 = 0.02
    if not chosen.quick:
        assert np.all(ds.growth_rate[:, -1] < 0)  # alpha falls and Delta does not: diffusion wins for every epsilon


if __name__ == "__main__":
    main()
