"""Fig. 3 of Both, Hong and Kurtze: where the flat road is unstable, in the plane of hardening and diffusion.

    Re sigma = -beta - Delta k^2 + alpha F(k) = 0,    d(Re sigma)/dk = 0,    F = q(1-q)/((1-q)^2 + 4 Gamma^2 q),  q = k^2

to leading order in alpha, beta, Delta: Delta/alpha = F'(q), beta/alpha = F - qF', one curve for each damping Gamma. It
ends on the axes at beta/alpha = 1/(4 Gamma(1+Gamma)) and Delta/alpha = 1/(4 Gamma(1-Gamma)), or 1 from Gamma = 1/2 on.

Beyond the paper. (1) Runs of discrete cars on either side of every curve, at its critical wave. Where softness and
diffusivity are both proportional to exp(eps H), beta/alpha = eps and Delta/alpha stay what they are while alpha falls, so
that a run keeps its place in the plane. Growth is compared with the integral of Re sigma over the settling road, from
the cubic (exact in alpha, coefficients frozen). (2) For small Gamma the boundary is beta(1+Gamma) + Delta(1-Gamma) =
alpha/4 Gamma, up to a relative Gamma^2; the paper's beta + Delta = alpha/4 Gamma is only its leading term. (3) Softness
is not small on every road: with constant coefficients the exact neutral softness is where cars do change from decay to
growth, and the leading order puts it far off.

Run: python experiments/fig3_stability.py [--quick]        (about 25 s; 4 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib import rc_context
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.analysis import mean_rates
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY

DAMPINGS = np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
COLOURS = (BLACK, BLUE, SKY, GREEN, ORANGE, RED, PURPLE)
OFF = np.array([0.9, 1.1])  # runs stand this far along the ray from the origin through a point of the boundary
PLACES = np.array([0.55, 0.8, 1.0])  # of that point: its k, between those of the curve's ends
ROWS = 8  # nodes a headway; quintic hold
SOFTNESS, AMPLITUDE = 2e-3, 1e-4  # at the start; waves stay far below lift-off
NEUTRAL_SOFTNESS = 0.05  # about that of the runs without hardening: alpha/(2 Gamma^2) is 0.28 at Gamma = 0.3
NEAR = np.array([0.97, 0.99, 1.01, 1.03])  # softness of these runs over the exact neutral softness
SMALL = np.array([0.01, 0.02, 0.04, 0.08, 0.16])  # dampings for the straight lines
SHOWN = 0.08


def grow(k: float, damping: float, softness, diffusivity, duration: float, count: int = 8):
    """Growth rate of one wave under `count` cars, after their transients, and the times it was measured from and to."""
    scene = tr.Scene(
        tr.Road(2 * np.pi / k, softness, diffusivity, tr.Sine(AMPLITUDE, k)),
        tr.Fleet(count, damping),
        duration=duration,
        lift_off=False,
    )
    ds = tr.simulate(scene, "cars", samples=41, nodes=ROWS * count, hold=5, progress=False)
    begin = float(ds.time[np.searchsorted(ds.time.values, 30 / min(damping, 1.0))])
    rate, _ = mean_rates(ds, k, begin, duration)
    return rate, begin, float(ds.time[-1]), scene


def predicted(k, damping, law, ratio, begin, end) -> tuple[float, float]:
    """Means over the settling road of Re sigma, from the cubic with frozen coefficients, and of the softness."""
    times = np.linspace(begin, end, 401)
    road = tr.theory.settle(law, damping, times)
    sigma = tr.theory.dispersion(
        k,
        softness=road.softness.values,
        diffusivity=ratio * road.softness.values,
        damping=damping,
        hardening_rate=road.hardening_rate.values,
    )
    return tuple(float(np.trapezoid(y, times)) / (end - begin) for y in (sigma.real, road.softness.values))


def across(dampings, places, duration: float) -> dict[str, np.ndarray]:
    """Runs on both sides of each boundary: columns over (damping, place, side)."""
    shape = dampings.size, places.size, OFF.size
    names = "wavenumber", "hardening", "diffusivity", "growth", "expected"
    table = {name: np.empty(shape) for name in names}
    for i, damping in enumerate(dampings):
        curve = tr.theory.stability_boundary(damping)
        for j, place in enumerate(places):
            k = float(curve.k[0] + place * (curve.k[-1] - curve.k[0]))
            point = [float(np.interp(k, curve.k, curve[name])) for name in ("hardening_rate", "diffusivity")]
            for side, off in enumerate(OFF):
                hardening, ratio = (off * value for value in point)
                law = tr.Exponential(SOFTNESS, hardening)
                rate, begin, end, _ = grow(k, damping, law, tr.Exponential(ratio * SOFTNESS, hardening), duration)
                expected, mean = predicted(k, damping, law, ratio, begin, end)
                for name, value in zip(names, (k, hardening, ratio, rate / mean, expected / mean), strict=True):
                    table[name][i, j, side] = value
    return table


def neutral(dampings, near, duration: float) -> dict[str, np.ndarray]:
    """Runs without hardening around the exact neutral softness: columns over (damping) and (damping, near)."""
    shape = dampings.size, near.size
    table = {name: np.empty(shape) for name in ("growth", "scheme", "cubic")}
    table |= {name: np.empty(dampings.size) for name in ("wavenumber", "exact", "leading")}
    for i, damping in enumerate(dampings):
        k = max(0.4, np.sqrt(max(0.0, 1 - 2 * damping)))  # the first wave to grow; from Gamma = 1/2 that is k = 0
        ratio = float(tr.theory.stability.gain(k, damping)) / k**2
        diffusivity = NEUTRAL_SOFTNESS * ratio
        exact = float(tr.theory.neutral_softness(k, diffusivity=diffusivity, damping=damping))
        table["wavenumber"][i], table["exact"][i], table["leading"][i] = k, exact, NEUTRAL_SOFTNESS
        for j, factor in enumerate(near):
            softness = factor * exact
            rate, _, _, scene = grow(k, damping, softness, diffusivity, duration, count=16)
            table["growth"][i, j] = rate / softness
            table["scheme"][i, j] = tr.theory.floquet(scene, k, nodes=ROWS * 16, hold=5).real / softness
            cubic = tr.theory.dispersion(k, softness=softness, diffusivity=diffusivity, damping=damping)
            table["cubic"][i, j] = cubic.real / softness
    return table


def lines(dampings):
    """Largest relative distance of the boundary from the paper's line and from the corrected one, (2, dampings)."""
    errors = np.empty((2, dampings.size))
    for i, damping in enumerate(dampings):
        curve = tr.theory.stability_boundary(damping)
        for row, slope in enumerate((0.0, damping)):
            total = curve.hardening_rate * (1 + slope) + curve.diffusivity * (1 - slope)
            errors[row, i] = np.abs(4 * damping * total - 1).max()
    return errors


def variable(dims, values, long_name):
    return dims, np.asarray(values, dtype=float), {"long_name": long_name, "units": "1"}


def main() -> None:
    chosen = options(__doc__)
    some = [0, 4] if chosen.quick else slice(None)
    dampings, places = DAMPINGS[some], PLACES[[0, 2]] if chosen.quick else PLACES
    runs = across(dampings, places, 300.0 if chosen.quick else 1500.0)
    near = NEAR[1:3] if chosen.quick else NEAR
    flat = neutral(dampings, near, 300.0 if chosen.quick else 800.0)
    errors = lines(SMALL)
    grid = "damping_run", "place", "side"
    text = {
        "wavenumber": "wavenumber of the run",
        "hardening": "hardening rate over softness of the run",
        "diffusivity": "diffusivity over softness of the run",
        "growth": "measured growth rate over the mean softness, discrete cars",
        "expected": "growth rate over the mean softness, cubic with frozen coefficients",
    }
    data = {f"across_{name}": variable(grid, values, text[name]) for name, values in runs.items()}
    text = {
        "growth": "measured growth rate over softness, discrete cars",
        "scheme": "growth rate over softness, Floquet eigenvalue of the scheme",
        "cubic": "growth rate over softness, cubic",
        "wavenumber": "wavenumber",
        "exact": "neutral softness, exact",
        "leading": "neutral softness, leading order",
    }
    for name, values in flat.items():
        data[f"neutral_{name}"] = variable(
            ("damping_run", "near")[: values.ndim], values, f"{text[name]}, no hardening"
        )
    points = {}
    for damping in DAMPINGS:
        curve = tr.theory.stability_boundary(damping)
        for name in ("hardening_rate", "diffusivity"):
            points.setdefault(name, []).append(curve[name].values)
    data["boundary_hardening_rate"] = variable(
        ("damping", "point"), points["hardening_rate"], "hardening rate over softness on the stability boundary"
    )
    data["boundary_diffusivity"] = variable(
        ("damping", "point"), points["diffusivity"], "diffusivity over softness on the stability boundary"
    )
    for name, row in zip(("paper", "corrected"), errors, strict=True):
        data[f"line_error_{name}"] = variable(
            "small_damping", row, f"largest relative distance of the boundary from the straight line, {name}"
        )
    coordinates = {
        "damping": variable("damping", DAMPINGS, "damping of the cars, boundaries"),
        "damping_run": variable("damping_run", dampings, "damping of the cars, runs"),
        "place": variable("place", places, "place of the critical wavenumber between those of the boundary's ends"),
        "side": variable("side", OFF, "distance from the origin, over that of the boundary on the same ray"),
        "near": variable("near", near, "softness over the exact neutral softness"),
        "small_damping": variable("small_damping", SMALL, "small damping of the cars"),
    }
    ds = xr.Dataset(data, coordinates)
    ds.attrs = {
        "Conventions": "CF-1.11",
        "title": "Stability diagram of the flat road and runs of discrete cars on either side of its boundaries",
        "references": "Both, Hong and Kurtze, Corrugation of Roads, Fig. 3",
    }
    miss = np.abs(ds.across_growth - ds.across_expected)
    right = np.sign(ds.across_growth) == np.sign(1 - ds.side)
    zero = crossing(near, flat["growth"]) - 1
    order = np.polyfit(np.log(SMALL), np.log(errors[1]), 1)[0]
    print(f"{right.size} runs across the boundaries, {int(right.sum())} grow below and decay above")
    print(
        f"growth over softness: smallest {np.abs(ds.across_growth).min().item():.4f}, differs from the cubic by at most "
        f"{miss.max().item():.1e}, {(miss / np.abs(ds.across_growth)).max().item():.1e} of itself"
    )
    print(f"cars are neutral at the exact softness times 1 + {np.abs(zero).max():.1e} at the most;")
    off = flat["leading"] / flat["exact"] - 1
    print(
        "the leading order is off by "
        + ", ".join(f"{x:+.1%} (Gamma {d:g})" for d, x in zip(dampings, off, strict=True))
    )
    print(f"lines at small Gamma: error {errors[0]} (paper), {errors[1]} (corrected, order {order:.2f})")
    store("fig3_stability", chosen.output, ds, draw(ds, errors))

    for i, damping in enumerate(DAMPINGS):  # the ends, to rounding
        most = 1 / (4 * damping * (1 - damping)) if damping < 0.5 else 1.0
        assert abs(ds.boundary_hardening_rate.values[i, -1] * 4 * damping * (1 + damping) - 1) < 1e-12, damping
        assert abs(ds.boundary_diffusivity.values[i, 0] / most - 1) < 1e-12, damping
        assert ds.boundary_hardening_rate.values[i, 0] == ds.boundary_diffusivity.values[i, -1] == 0, damping
        assert tr.theory.critical_ratio(damping) == most and (np.diff(ds.boundary_diffusivity.values[i]) < 0).all()
    # boundaries move down and left as the damping rises: at each hardening, less diffusion is enough
    for hardening in (0.01, 0.1, 0.14):
        assert (np.diff(tr.theory.critical_ratio(DAMPINGS, hardening)) < 0).all(), hardening
    assert bool(right.all()), ds.across_growth.where(~right, drop=True)
    # frozen coefficients leave out what changes within a car's memory, a relative alpha eps, and the discrete cars a
    # second-order term; the prediction must tell the sides apart far better than that
    assert (miss < 2e-3 * np.abs(ds.across_growth)).all(), miss.max()
    # without hardening the scheme's own eigenvalue is exact: what is left is rounding and the cars' last transient
    assert np.abs(ds.neutral_growth - ds.neutral_scheme).max() < 1e-6
    assert (np.sign(ds.neutral_growth) == np.sign(ds.near - 1)).all()  # within 1 % of the exact softness, either side
    assert np.abs(zero).max() < 1e-3, zero  # 16 cars a wave: the headway moves it by (alpha l)^2 or so
    assert (off < -0.01).all(), off  # so that in the runs at 0.99 the leading order has the sign wrong
    # the paper's line is off by Gamma/(1-Gamma) at the end without hardening, the corrected one by Gamma^2/2
    assert np.allclose(errors[0], SMALL / (1 - SMALL), rtol=1e-9, atol=0), errors[0]
    assert np.allclose(errors[1], SMALL**2 / 2, rtol=0.05, atol=0), errors[1]


def crossing(near, growth):
    """Where the growth rate vanishes: between the runs at 0.99 and 1.01, linearly, for each damping."""
    i, j = (int(np.argmin(np.abs(near - x))) for x in (0.99, 1.01))
    return near[i] - growth[:, i] * (near[j] - near[i]) / (growth[:, j] - growth[:, i])


@rc_context({"font.size": 8.5})
def draw(ds, errors) -> Figure:
    figure = Figure(figsize=(10.8, 4), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.25, 1, 1))
    for i, (damping, colour) in enumerate(zip(DAMPINGS, COLOURS, strict=True)):
        left.plot(
            ds.boundary_hardening_rate[i], ds.boundary_diffusivity[i], color=colour, lw=1.2, label=f"{damping:.1f}"
        )
    for i, damping in enumerate(ds.damping_run.values):
        colour = COLOURS[int(np.argmin(np.abs(DAMPINGS - damping)))]
        x, y = ds.across_hardening[i].values.ravel(), ds.across_diffusivity[i].values.ravel()
        grew = ds.across_growth[i].values.ravel() > 0
        left.plot(x[grew], y[grew], "o", color=colour, ms=4.5, clip_on=False, zorder=3)
        left.plot(x[~grew], y[~grew], "o", color=colour, mfc="white", ms=4.5, clip_on=False, zorder=3)
    left.plot([], [], "o", color=BLACK, ms=4.5, label="cars: wave grew")
    left.plot([], [], "o", color=BLACK, mfc="white", ms=4.5, label="cars: wave decayed")
    left.set(
        xlabel="hardening rate over softness $\\beta/\\alpha$",
        ylabel="diffusivity over softness $\\Delta/\\alpha$",
        title="Corrugations grow below the curve of their damping",
        xlim=(0, 0.75),
        ylim=(0, 1.35),
    )
    left.legend(title="damping $\\Gamma$ (top to bottom)", frameon=False, loc="upper right", fontsize="medium")
    for i, damping in enumerate(ds.damping_run.values):
        colour = COLOURS[int(np.argmin(np.abs(DAMPINGS - damping)))]
        exact, k = float(ds.neutral_exact[i]), float(ds.neutral_wavenumber[i])
        factor = np.linspace(0.94, 1.04, 91)
        diffusivity = NEUTRAL_SOFTNESS * float(tr.theory.stability.gain(k, damping)) / k**2
        sigma = tr.theory.dispersion(k, softness=factor * exact, diffusivity=diffusivity, damping=damping).real
        middle.plot(factor, sigma / (factor * exact), color=colour, lw=1)
        middle.plot(ds.near, ds.neutral_growth[i], "o", color=colour, ms=4.5, mfc="none")
        middle.plot(float(ds.neutral_leading[i]) / exact, 0, "|", color=colour, ms=16, mew=2)
    middle.axhline(0, color=BLACK, lw=0.6)
    middle.axvline(1, color=BLACK, lw=0.6, ls=":")
    middle.plot([], [], "o-", color=BLACK, ms=4.5, mfc="none", lw=1, label="cars; line: cubic")
    middle.plot([], [], "|", color=BLACK, ms=14, mew=2, label="neutral to leading order")
    middle.set(
        xlabel="softness over its exact neutral value",
        ylabel="growth rate over softness Re $\\sigma/\\alpha$",
        title="Growth sets in at the exact softness ($\\beta=0$)",
    )
    middle.legend(frameon=False, loc="lower right", fontsize="small")
    curve = tr.theory.stability_boundary(SHOWN)
    scale = 4 * SHOWN
    ends = np.array([0.0, 1.0])
    right.plot(scale * curve.hardening_rate, scale * curve.diffusivity, color=BLACK, lw=2, label="boundary")
    right.plot(ends / (1 + SHOWN), (1 - ends) / (1 - SHOWN), "--", color=ORANGE, lw=1.5, label="corrected line")
    right.plot(ends, 1 - ends, ":", color=BLUE, lw=1.5, label="the paper's line")
    right.set(
        xlabel="$4\\Gamma\\beta/\\alpha$",
        ylabel="$4\\Gamma\\Delta/\\alpha$",
        title=f"Small damping: steeper line ($\\Gamma={SHOWN}$)",
        xlim=(0, 1.15),
        ylim=(0, 1.45),
    )
    right.legend(frameon=False, loc="lower left")
    inset = right.inset_axes((0.6, 0.6, 0.38, 0.38))
    inset.loglog(ds.small_damping, errors[0], "o:", color=BLUE, ms=3.5)
    inset.loglog(ds.small_damping, errors[1], "s--", color=ORANGE, ms=3.5)
    inset.set_xlabel("damping $\\Gamma$", fontsize="small", labelpad=1)
    inset.set_ylabel("largest relative error", fontsize="small", labelpad=1)
    inset.tick_params(labelsize="small")
    return figure


if __name__ == "__main__":
    main()
