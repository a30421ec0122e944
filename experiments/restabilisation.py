"""Restabilisation is conditional: a road that is too soft corrugates without bound, lift-off or not.

Both, Hong and Kurtze saw every unstable wave of a road of constant softness alpha and diffusivity Delta held at a finite
amplitude once cars leave the road. Their softnesses (Fig. 7) lie in a window: the travelling waves

    (Delta n^2 k^2 - i n k c) u_n + alpha [max(0, 1/A + R u)]_n = 0,    h = A u,    u_1 = 1/2,

begin at the neutral softness with the amplitude at which cars lift off, and their amplitude A goes to infinity like
1/(limit - alpha) at a second softness, the saturation limit, where the weight of the cars, 1/A, no longer counts. There
the largest share of the force that lift-off can take away, about half, is used up: to one harmonic the limit is just twice
the neutral softness.

Beyond the limit the weight may be dropped. The problem is then homogeneous of degree one, and has solutions
h = exp(lambda t) u(x - c t): the nonlinear eigenproblem (own derivation; s_n = lambda + i n k (1 - c))

    (lambda + Delta n^2 k^2 - i n k c) u_n + alpha [max(0, g)]_n = 0,   g_n = s_n^2/(s_n^2 + 2 Gamma s_n + 1) u_n,

with the mean, n = 0, included, as it sinks at the rate lambda too. With the weight, dA/dt = lambda A + b, b > 0: for
lambda > 0 unbounded growth; for lambda < 0 the amplitude b/(-lambda), approached at the rate -lambda. So lambda continues
the slowest rate of the saturated wave's linear stability through zero at the limit.

Panels: amplitude and its inverse along the branch; runs on both sides of the limit, started far below lift-off; their
rates; the limit against wavenumber; and where, in the plane of damping and Delta/alpha, the fastest mode of the linear
theory is held. There Delta = 0.001, close to the leading order in small alpha and Delta, where only Delta/alpha counts.
All this is for a road of one wavelength. On longer roads saturated waves are unstable to slow modulation: selection.py.

Run: python experiments/restabilisation.py [--quick]        (about 30 s; 6 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib import rc_context
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.optimize import fsolve

import traffic_road as tr
from traffic_road.analysis import mean_rates
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED

DAMPING, DIFFUSIVITY = 0.1, 0.01
CAR = {"diffusivity": DIFFUSIVITY, "damping": DAMPING}
WAVENUMBERS = (0.8, 0.9, 0.95)
COLOURS = dict(zip(WAVENUMBERS, (ORANGE, BLUE, GREEN), strict=True))
COUNT = 8  # cars a wavelength
START = 0.1  # of the amplitude at lift-off
BELOW, ABOVE = (0.8, 0.9), (1.1, 1.2, 1.5)  # softness over its limit
MODES = 32  # of the growing wave
SMALL = 1e-3  # diffusivity of the map
FIG7 = np.array([0.0040, 0.0045, 0.0050, 0.0055, 0.0060])


# ---- theory


def growing_waves(k: float, ratios) -> np.ndarray:
    """lambda and c, (2, ratios), of the weightless growing wave at softness = ratio * limit; ratios rise from near 1."""
    limit = tr.theory.saturation_limit(k, **CAR)
    near = tr.theory.travelling_wave(k, softness=0.9 * limit, **CAR, modes=64)
    u = np.fft.rfft(near.height.values)[2 : MODES + 1] / near.x.size / float(near.amplitude)
    guess = np.concatenate([u.real, u.imag, [0.0, float(near.velocity), 0.0]])
    n, points = np.arange(1, MODES + 1), 32 * MODES
    found = []
    for softness in np.asarray(ratios) * limit:

        def residual(z, softness=softness):
            u = np.concatenate([[0.5], z[: MODES - 1] + 1j * z[MODES - 1 : -3]])
            mean, c, rate = z[-3:]
            s = rate + 1j * n * k * (1 - c)
            g = np.zeros(points // 2 + 1, complex)
            g[0], g[1 : MODES + 1] = mean, s**2 / (s**2 + 2 * DAMPING * s + 1) * u
            force = np.fft.rfft(np.maximum(0.0, np.fft.irfft(g, norm="forward")), norm="forward")[: MODES + 1]
            wave = (rate + DIFFUSIVITY * (n * k) ** 2 - 1j * n * k * c) * u + softness * force[1:]
            level = mean * (rate**2 + 2 * DAMPING * rate + 1) + softness * rate * force[0].real
            return np.concatenate([wave.real, wave.imag, [level]]) / DIFFUSIVITY

        guess, information, _, message = fsolve(residual, guess, full_output=True, xtol=1e-12)
        assert np.abs(information["fvec"]).max() < 1e-9, message
        found.append((guess[-1], guess[-2]))
    return np.array(found).T


def decay(k: float, softness: float) -> float:
    """Slowest rate (negative) at which a saturated wave is approached on a road of its wavelength."""
    wave = tr.theory.travelling_wave(k, softness=softness, **CAR, modes=32)
    return tr.theory.wave_stability(wave)[2].real


def fastest_window(damping: float, ratios, points: int) -> np.ndarray:
    """limit/softness of the fastest mode at Delta/alpha = ratios; NaN where the road is stable or the limit unknown.

    The fastest modes fill a narrow band of wavenumbers, in which limit/Delta is interpolated.
    """
    out = np.full(len(ratios), np.nan)
    modes = tr.theory.fastest_mode(ratios, damping)
    corrugates = modes > 0.3  # below, harmonics resonate and branches are lost
    if corrugates.any():
        k = np.linspace(modes[corrugates].min(), modes[corrugates].max(), points)
        inverse = SMALL / tr.theory.saturation_limit(k, diffusivity=SMALL, damping=damping)  # 0 where there is no limit
        with np.errstate(divide="ignore"):
            out[corrugates] = ratios[corrugates] / np.interp(modes[corrugates], k, inverse)
    return out


# ---- runs


def run(model: str, k: float, softness: float, end: float) -> xr.Dataset:
    """One wavelength, from far below lift-off."""
    start = START * lift_off(k)
    road = tr.Road(2 * np.pi / k, softness, DIFFUSIVITY, tr.Sine(start, k))
    numerics = {"nodes": 32, "step": 4.0} if model == "continuum" else {}
    scene = tr.Scene(road, tr.Fleet(COUNT, DAMPING), duration=end)
    # judged here against theory: no tolerance that would refine the run, and growth to its end
    return tr.simulate(scene, model, 10.0, samples=201, progress=False, allow_unstable=True, **numerics)


def lift_off(k):
    """Amplitude sqrt(D(kappa))/kappa^2 at which a neutral wave first loses contact."""
    sigma = tr.theory.dispersion(k, softness=tr.theory.neutral_softness(k, **CAR), **CAR)
    kappa = k + sigma.imag
    return np.sqrt((1 - kappa**2) ** 2 + 4 * DAMPING**2 * kappa**2) / kappa**2


def main() -> None:
    chosen = options(__doc__)
    wavenumbers = (0.9,) if chosen.quick else WAVENUMBERS
    below, above = ((0.8,), (1.2,)) if chosen.quick else (BELOW, ABOVE)
    ratios = np.array([*below, *above])
    one = {"units": "1"}
    ds = xr.Dataset(
        coords={
            "k": ("k", np.array(wavenumbers), {"long_name": "wavenumber"} | one),
            "ratio": ("ratio", ratios, {"long_name": "softness over the saturation limit"} | one),
            "model": ("model", ["continuum", "cars"], {"long_name": "how the road was computed"}),
        }
    )
    limit = tr.theory.saturation_limit(ds.k.values, **CAR)
    ds["limit"] = "k", limit, {"long_name": "saturation limit of the softness"} | one
    ds["neutral"] = "k", tr.theory.neutral_softness(ds.k.values, **CAR), {"long_name": "neutral softness"} | one

    reach = np.geomspace(1, 100, 9 if chosen.quick else 33)
    branches = [tr.theory.wave_branch(k, **CAR, amplitudes=reach * lift_off(k) * (1 + 1e-9)) for k in wavenumbers]
    for name in ("amplitude", "softness", "velocity", "airborne"):
        values = [branch[name].values for branch in branches]
        ds[f"branch_{name}"] = ("k", "step"), values, dict(branches[0][name].attrs)

    fine = np.linspace(1.001, max(above) + 0.05, 5 if chosen.quick else 12)
    growth = [growing_waves(k, fine) for k in wavenumbers]
    at = [growing_waves(k, (1.001, *above)) for k in wavenumbers]
    ds["fine"] = "fine", fine, {"long_name": "softness over the saturation limit"} | one
    ds["growth"] = ("k", "fine"), [g[0] for g in growth], {"long_name": "growth rate of the weightless wave"} | one
    slow = np.linspace(0.55, 0.99, 5 if chosen.quick else 12)
    ds["slow"] = "slow", slow, {"long_name": "softness over the saturation limit"} | one
    slowest = [
        [decay(k, r * a) if r * a > 1.02 * b else np.nan for r in slow]
        for k, a, b in zip(wavenumbers, limit, ds.neutral.values, strict=True)
    ]
    ds["decay"] = ("k", "slow"), slowest, {"long_name": "slowest rate of the saturated wave's linear stability"} | one

    shape = (2, len(wavenumbers), ratios.size)
    amplitude, rate, velocity = np.full((3, *shape), np.nan)
    history = np.full((*shape, 201), np.nan)
    times = history.copy()
    expected = np.full((3, *shape[1:]), np.nan)
    for j, k in enumerate(wavenumbers):
        for i, ratio in enumerate(ratios):
            softness = ratio * limit[j]
            if ratio < 1:
                wave = tr.theory.travelling_wave(k, softness=softness, **CAR, modes=64)
                expected[:, j, i] = wave.amplitude, np.nan, wave.velocity
                end = 12.0 / -decay(k, softness)
            else:
                expected[:, j, i] = np.nan, *at[j][:, 1 + i - len(below)]
                end = 10.0 / expected[1, j, i]
            for m, model in enumerate(ds.model.values):
                out = run(model, k, softness, end)
                wave = tr.mode(out, k)
                assert out.attrs["status"] == "ok" and wave.time.size == 201
                times[m, j, i], history[m, j, i] = wave.time, wave.amplitude
                rates = mean_rates(out, k, 0.9 * end, end)
                velocity[m, j, i] = rates[1]
                if ratio < 1:
                    amplitude[m, j, i] = wave.amplitude.values[-20:].mean()
                else:
                    rate[m, j, i] = rates[0]
    names = {
        "amplitude": "amplitude of the saturated wave",
        "rate": "growth rate of the unbounded wave",
        "velocity": "velocity of the wave at the end",
    }
    for (name, text), run_value, theory in zip(names.items(), (amplitude, rate, velocity), expected, strict=True):
        ds[f"run_{name}"] = ("model", "k", "ratio"), run_value, {"long_name": f"{text}, run"} | one
        ds[f"theory_{name}"] = ("k", "ratio"), theory, {"long_name": f"{text}, theory"} | one
    ds["history"] = ("model", "k", "ratio", "sample"), history, {"long_name": "amplitude of the first harmonic"} | one
    ds["time"] = ("model", "k", "ratio", "sample"), times, {"long_name": "time"} | one

    damping = np.array([0.05, 0.1, 0.3] if chosen.quick else [0.05, *np.arange(0.1, 0.91, 0.05)])
    plane = np.geomspace(0.01, 10, 31 if chosen.quick else 241)
    ds["damping"] = "damping", damping, {"long_name": "damping"} | one
    ds["plane"] = "plane", plane, {"long_name": "diffusivity over softness"} | one
    window = [fastest_window(g, plane, 3 if chosen.quick else 6) for g in damping]
    ds["window"] = ("damping", "plane"), window, {"long_name": "limit over softness, fastest mode"} | one
    ds["critical"] = "damping", tr.theory.critical_ratio(damping), {"long_name": "Delta/alpha of stability"} | one
    ks = np.linspace(0.35, 0.98, 5 if chosen.quick else 19)
    some = np.array([0.1, 0.3]) if chosen.quick else np.array([0.1, 0.3, 0.5, 0.7])
    width = [
        tr.theory.saturation_limit(ks, diffusivity=SMALL, damping=g)
        / tr.theory.neutral_softness(ks, diffusivity=SMALL, damping=g)
        for g in some
    ]
    ds["width_k"] = "width_k", ks, {"long_name": "wavenumber"} | one
    ds["width_damping"] = "width_damping", some, {"long_name": "damping"} | one
    ds["width"] = ("width_damping", "width_k"), width, {"long_name": "saturation limit over neutral softness"} | one
    ds.attrs = {
        "Conventions": "CF-1.11",
        "title": "Restabilisation is conditional",
        "branch_damping": DAMPING,
        "branch_diffusivity": DIFFUSIVITY,
        "map_diffusivity": SMALL,
        "cars_a_wavelength": COUNT,
    }

    errors = {name: abs(ds[f"run_{name}"] / ds[f"theory_{name}"] - 1) for name in names}
    for name, error in errors.items():
        worst = error.max(("k", "ratio")).values
        print(f"{name}: continuum within {worst[0]:.1e} of theory, cars {worst[1]:.1e}")
    for j, k in enumerate(wavenumbers):
        print(
            f"k = {k}: neutral {float(ds.neutral[j]):.5f}, limit {limit[j]:.5f}, ratio {limit[j] / ds.neutral[j]:.4f}"
        )
    product = ds.branch_amplitude * (ds.limit - ds.branch_softness)  # constant where amplitude ~ 1/(limit - softness)
    tenfold, thirtyfold, last = (product.isel(step=i) for i in (reach.size // 2, 3 * (reach.size - 1) // 4, -1))
    drift, earlier = last / thirtyfold - 1, thirtyfold / tenfold - 1
    print("amplitude*(limit - softness) from 32 to 100 times lift-off changes by", np.round(drift.values, 4))
    with rc_context({"font.size": 8}):  # six panels in one picture
        store("restabilisation", chosen.output, ds, draw(ds))

    # what is left is the next order in 1/A: it shrinks by sqrt(10) from one half of the decade to the next
    assert np.all(np.abs(drift) < 0.05), drift.values
    assert np.all(np.abs(earlier / drift / np.sqrt(10) - 1) < 0.1), (earlier / drift).values
    assert np.all(limit > 2 * ds.neutral.values)  # harmonic balance, at exactly twice, is the narrowest window
    # saturated: what exp(-12) leaves, from far away; growing: the weight, 1/A; cars: besides, the headway, second order
    for name, bounds in (("amplitude", (1e-3, 1e-2)), ("rate", (5e-3, 2e-2)), ("velocity", (1e-3, 5e-3))):
        worst = errors[name].max(("k", "ratio")).values
        assert np.all(worst < bounds), (name, worst)
    # beyond the limit nothing holds the wave: three decades beyond lift-off and still growing
    beyond = ds.history.sel(ratio=list(above)).isel(sample=-1) / xr.DataArray(lift_off(ds.k.values), dims="k")
    assert bool((beyond > 1e3).all()), beyond.values
    # the decay below the limit and the growth above it are one curve, through zero at the limit
    for j in range(len(wavenumbers)):
        zero = np.interp(0.0, [slowest[j][-1], growth[j][0][0]], [slow[-1], fine[0]])
        assert abs(zero - 1) < 1e-3, zero
    # Fig. 7 of the paper, damping 0.1, lies inside the window
    assert DIFFUSIVITY / FIG7[0] < tr.theory.critical_ratio(DAMPING)
    held = np.interp(DIFFUSIVITY / FIG7[-1], plane, window[1])
    assert held > 1.2, held


def draw(ds) -> Figure:
    figure = Figure(figsize=(11, 6.6), layout="constrained")
    (branch, inverse, runs), (rates, width, plane) = figure.subplots(2, 3)
    figure.suptitle("Lift-off holds a corrugation only up to a limit of the softness; beyond it nothing does")
    for j, k in enumerate(ds.k.values):
        colour = COLOURS[float(k)]
        one = ds.isel(k=j)
        branch.semilogy(one.branch_softness, one.branch_amplitude, "-", color=colour, label=f"{k:g}")
        branch.axvline(float(one.limit), color=colour, ls=":", lw=1)
        start = float(one.branch_amplitude[0])
        branch.plot([float(one.neutral)] * 2, [start / 5, start], "-", color=colour)
        inverse.plot(one.branch_softness / one.limit, start / one.branch_amplitude, "-", color=colour, label=f"{k:g}")
        saturated = one.ratio < 1
        inverse.plot(one.ratio[saturated], start / one.run_amplitude[0, saturated], "o", color=colour, mfc="none", ms=8)
        inverse.plot(one.ratio[saturated], start / one.run_amplitude[1, saturated], ".", color=BLACK, ms=4)
        rates.plot(one.slow, one.decay * 1e3, "--", color=colour)
        rates.plot(one.fine, one.growth * 1e3, "-", color=colour, label=f"{k:g}")
        rates.plot(one.ratio, one.run_rate[0] * 1e3, "o", color=colour, mfc="none", ms=8)
        rates.plot(one.ratio, one.run_rate[1] * 1e3, ".", color=BLACK, ms=4)
    branch.set(
        xlabel="softness $\\alpha$",
        ylabel="amplitude of the first harmonic $(g/\\omega_0^2)$",
        title="Saturated waves and their limits (dotted)",
        xlim=(None, 1.04 * float(ds.limit.max())),
    )
    branch.legend(title="$k$ $(\\omega_0/v)$", frameon=False, loc="upper left")
    inverse.plot([], [], "o", color=BLACK, mfc="none", label="continuum run")
    inverse.plot([], [], ".", color=BLACK, label=f"{COUNT} cars a wavelength")
    inverse.axhline(0, color=BLACK, lw=0.6)
    inverse.set(
        xlabel="softness $\\alpha$ / saturation limit",
        ylabel="amplitude at lift-off / amplitude",
        title="Amplitude $\\propto$ 1/(limit $-\\ \\alpha$)",
    )
    inverse.legend(title="$k$ $(\\omega_0/v)$", frameon=False, loc="upper right")
    _draw_runs(runs, ds)
    rates.axhline(0, color=BLACK, lw=0.6)
    rates.axvline(1, color=BLACK, lw=0.6)
    rates.set(
        xlabel="softness $\\alpha$ / saturation limit",
        ylabel="rate $\\lambda$ $(10^{-3}\\,\\omega_0)$",
        title="Return below (dashed), growth beyond (solid)",
    )
    rates.legend(title="$k$ $(\\omega_0/v)$", frameon=False, loc="upper left")
    for row, g, style in zip(ds.width, ds.width_damping.values, ("-", "--", "-.", ":"), strict=False):
        width.semilogy(ds.width_k, row.where(np.isfinite(row)), style, color=BLACK, label=f"{g:g}")
    width.axhline(2, color=RED, lw=1)
    width.text(0.36, 1.93, "harmonic balance: 2", color=RED, fontsize="small", va="top")
    width.set(
        xlabel="wavenumber $k$ $(\\omega_0/v)$",
        ylabel="saturation limit / neutral softness",
        title=f"How wide the window is ($\\Delta$ = {SMALL:g})",
        ylim=(1.7, 40),
    )
    width.set_yticks([2, 3, 5, 10, 20, 40], ["2", "3", "5", "10", "20", "40"])
    width.set_yticks([], minor=True)
    width.legend(title="damping $\\Gamma$", frameon=False, loc="upper left")
    _draw_plane(figure, plane, ds)
    return figure


def _draw_runs(axes, ds) -> None:
    one = ds.sel(k=0.9)
    colours = dict(zip((0.8, 0.9, 1.1, 1.2, 1.5), (BLUE, GREEN, ORANGE, RED, PURPLE), strict=True))
    for i, ratio in enumerate(one.ratio.values):
        colour = colours[float(ratio)]
        time, height = one.time[:, i], one.history[:, i]
        axes.semilogy(time[0], height[0], "-", color=colour, label=f"{ratio:g}")
        axes.semilogy(time[1], height[1], ".", color=colour, ms=6, markevery=10)
    axes.axhline(float(lift_off(0.9)), color=BLACK, ls=":", lw=1)
    axes.text(0.98, 0.8 * float(lift_off(0.9)), "lift-off", transform=axes.get_yaxis_transform(), ha="right", va="top")
    axes.set(
        xlabel="time $(1/\\omega_0)$",
        ylabel="amplitude of the first harmonic $(g/\\omega_0^2)$",
        title="Runs, k = 0.9: continuum (lines), cars (dots)",
        xlim=(0, 12000),
        ylim=(1e-2, 1e4),
    )
    axes.legend(title="$\\alpha$ / limit", frameon=False, loc="lower right", ncols=3)


def _draw_plane(figure, axes, ds) -> None:
    axes.set_facecolor("#BBBBBB")
    held = np.clip(ds.window.values, 1e-2, 1e2)
    picture = axes.pcolormesh(
        ds.damping, ds.plane, held.T, norm=LogNorm(0.01, 100), cmap="PuOr", shading="nearest", rasterized=True
    )
    axes.contour(ds.damping, ds.plane, held.T, [1.0], colors=BLACK)
    figure.colorbar(picture, ax=axes, label="saturation limit / $\\alpha$, fastest mode", extend="both")
    axes.fill_between(ds.damping, ds.critical, 10, color="white", zorder=1)
    axes.plot(ds.damping, ds.critical, "-", color=BLACK, lw=1.5)
    axes.plot(np.full(FIG7.size, DAMPING), DIFFUSIVITY / FIG7, "o", color=BLACK, mfc="white", ms=4, zorder=3)
    place = DAMPING + 0.01, DIFFUSIVITY / FIG7[1]
    axes.annotate("Fig. 7", place, xytext=(0.18, 4.0), arrowprops={"arrowstyle": "-", "lw": 0.8})
    axes.text(0.5, 3.5, "flat road stable", ha="center")
    axes.text(0.4, 0.03, "grows without bound", ha="center")
    axes.text(0.72, 0.35, "held", ha="center")
    axes.set(
        yscale="log",
        xlabel="damping $\\Gamma$",
        ylabel="$\\Delta/\\alpha$",
        title="Does lift-off hold the fastest mode? (grey: not known)",
        ylim=(0.01, 10),
        xlim=(float(ds.damping[0]), float(ds.damping[-1])),
    )


if __name__ == "__main__":
    main()
