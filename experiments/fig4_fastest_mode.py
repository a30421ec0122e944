"""Fig. 4 of Both, Hong and Kurtze: the wavenumber that grows fastest, and the one that cars select on a noisy road.

    Delta/alpha = ((1-q)^2 - 4 Gamma^2 q^2)/((1-q)^2 + 4 Gamma^2 q)^2,    q = k_max^2        (leading order in alpha)

The local maximum of Re sigma(k) merges with a minimum at Delta/alpha = (1+q+q^2)/((1-q)^2 (1+q)^3) (dashed); already at
Delta/alpha = 1/(1-q^2) (dotted) k = 0 outgrows it. The hardening rate does not matter.

Beyond the paper. (1) The exact fastest mode, from the cubic. The paper finds k_max above 1 "in no case"; that is the
leading order: at alpha = 0.1, Gamma = 0.05 without diffusion k_max = 1.016. And k = 0 takes over at less diffusion. (2)
The paper's equation has more roots, to be discarded: k > 1, where waves decay, and the local maxima between the two
curves. (3) Discrete cars on a road of white noise: after t the power spectrum is exp(2 Re sigma t), a peak of width
(2 |d^2 Re sigma/dk^2| t)^(-1/2). Its centroid against the fastest mode, and against the mean of k under
exp(2 Re sigma t), with the chance of the noise as error.

Run: python experiments/fig4_fastest_mode.py [--quick]        (about 25 s; 4 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.optimize import brentq, minimize_scalar

import traffic_road as tr
from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY

DAMPINGS = np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
COLOURS = (BLACK, BLUE, SKY, GREEN, ORANGE, RED, PURPLE)
SOFTNESS = 0.05  # of the runs, and of the exact curves beside the leading order
POINTS = np.array([  # damping, diffusivity over softness; the first two in quick runs
    (0.3, 0.4), (0.7, 0.1), (0.3, 0.0), (0.3, 0.8), (0.4, 0.3), (0.4, 0.7), (0.5, 0.2), (0.5, 0.5), (0.6, 0.4), (0.7, 0.4),
    (0.9, 0.05), (0.9, 0.3),
])  # fmt: skip
FOLDS = 12.0  # e-foldings of the fastest mode: the linear stage of a road as smooth as RMS
RMS, MAX_WAVENUMBER = 1e-7, 2.0
CARS, ROWS = 8, 8  # cars on the fastest wave, nodes a headway; quintic hold
BIN = {60: 4, 960: 24}  # waves of the ring that are averaged for the picture of the spectrum
EXTRA = np.array([[0.3, 0.02], [0.3, 1.22]])  # where the roots of the k_max equation are listed: damping, ratio


def noisy_road(damping: float, ratio: float, waves: int, seed: int) -> dict:
    """Cars on white noise until the fastest mode has grown by exp(FOLDS): its power spectra and their moments."""
    diffusivity = ratio * SOFTNESS
    fastest, sigma = tr.theory.fastest_mode_exact(SOFTNESS, diffusivity, damping)
    length = 2 * np.pi * waves / fastest
    scene = tr.Scene(
        tr.Road(length, SOFTNESS, diffusivity, tr.Noise(RMS, MAX_WAVENUMBER, seed)),
        tr.Fleet(CARS * waves, damping),
        duration=FOLDS / sigma.real,
    )
    ds = tr.simulate(scene, "cars", samples=5, nodes=ROWS * CARS * waves, hold=5, progress=False)
    assert (ds.contact_force > 0).all()  # the linear stage
    k = 2 * np.pi * np.arange(1, scene.road.profile.highest_wave(length) + 1) / length
    power = np.abs(np.fft.rfft(ds.road_height.values - ds.road_height.values.mean(axis=1, keepdims=True))) ** 2
    power = power[:, 1 : k.size + 1]
    growth = tr.theory.dispersion(k, softness=SOFTNESS, diffusivity=diffusivity, damping=damping).real
    expected = np.exp(2 * np.multiply.outer(ds.time.values, growth))
    weight = expected[-1] / expected[-1].sum()
    mean = float(weight @ k)
    around = fastest + np.array([-1e-3, 0.0, 1e-3])
    bend = tr.theory.dispersion(around, softness=SOFTNESS, diffusivity=diffusivity, damping=damping).real
    bend = (bend[0] - 2 * bend[1] + bend[2]) / 1e-6
    return {
        "k": k,
        "power": power,
        "expected_power": expected,
        "time": ds.time.values,
        "fastest": float(fastest),
        "selected": float(power[-1] @ k / power[-1].sum()),
        "expected": mean,
        # each wave's initial power is chance, exponentially distributed: the standard deviation of the centroid
        "chance": float(np.sqrt(np.sum((weight * (k - mean)) ** 2))),
        "width": float((2 * abs(bend) * ds.time.values[-1]) ** -0.5),
    }


def roots(damping: float, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """All wavenumbers that solve the paper's k_max equation, and Re sigma/alpha there."""
    q = np.poly1d([1.0, 0.0])
    gap = (1 - q) ** 2
    solutions = ((gap - 4 * damping**2 * q**2) - ratio * (gap + 4 * damping**2 * q) ** 2).roots
    q = np.sort(solutions[(np.abs(solutions.imag) < 1e-9) & (solutions.real > 0)].real)
    return np.sqrt(q), tr.theory.stability.gain(np.sqrt(q), damping) - ratio * q


def branch(damping: float, points: int = 201) -> tuple[np.ndarray, np.ndarray]:
    """(Delta/alpha, k_max) from no diffusion to where the local maximum vanishes: the k_max equation, along k."""
    low = 0.0
    if damping < 0.5:  # 4 Gamma^2 = (1-q)^2/(1+q+q^2)
        g = 4 * damping**2
        low = np.min(np.roots([1 - g, -2 - g, 1 - g]).real)
    q = np.linspace(1 / (1 + 2 * damping), low, points)
    ratio = ((1 - q) ** 2 - 4 * damping**2 * q**2) / ((1 - q) ** 2 + 4 * damping**2 * q) ** 2
    return np.maximum(ratio, 0), np.sqrt(np.maximum(q, 0))  # what rounding leaves of an exact zero


def binned(values, size: int):
    """Means of `size` neighbours along the last axis."""
    whole = values.shape[-1] // size * size
    return values[..., :whole].reshape(*values.shape[:-1], -1, size).mean(axis=-1)


def density(k, power, size: int):
    """Power per wavenumber over its total, averaged over `size` waves of the ring."""
    return binned(power / (power.sum(axis=-1, keepdims=True) * (k[1] - k[0])), size)


def takeover(damping: float) -> float:
    """Delta/alpha at which k = 0 outgrows all waves, exact, at SOFTNESS: there the softest neutral road has SOFTNESS."""
    if damping >= 0.5:
        return 1.0

    def excess(ratio):
        found = minimize_scalar(
            lambda k: tr.theory.neutral_softness(k, diffusivity=ratio * SOFTNESS, damping=damping),
            bounds=(0.3, 1.2),
            method="bounded",
        )
        return found.fun - SOFTNESS

    return brentq(excess, 0.8, 1.3)


def variable(dims, values, long_name):
    return dims, np.asarray(values, dtype=float), {"long_name": long_name, "units": "1"}


def main() -> None:
    chosen = options(__doc__)
    points, waves = (POINTS[:2], 60) if chosen.quick else (POINTS, 960)
    runs = [noisy_road(*point, waves, seed) for seed, point in enumerate(points)]
    curves = np.array([branch(damping) for damping in DAMPINGS])
    fraction = np.linspace(0, 0.999, 8 if chosen.quick else 30)
    exact = np.empty((2, DAMPINGS.size, fraction.size))
    for i, damping in enumerate(DAMPINGS):
        exact[0, i] = fraction * takeover(damping)
        exact[1, i] = tr.theory.fastest_mode_exact(SOFTNESS, exact[0, i] * SOFTNESS, damping)[0]
    softnesses = np.array([0.02, 0.05, 0.1])
    small = np.geomspace(0.02, 1.0, 11 if chosen.quick else 41)
    undiffused = tr.theory.fastest_mode_exact(softnesses[:, None], 0.0, small)[0]
    first = runs[0]
    spectrum = density(first["k"], first["power"], BIN[waves])
    expected_spectrum = density(first["k"], first["expected_power"], 1)
    summary = {
        "fastest": "wavenumber of the fastest mode, cubic",
        "selected": "centroid of the power spectrum of the road, discrete cars on noise",
        "expected": "mean wavenumber under exp(2 Re sigma t), cubic",
        "chance": "standard deviation of that centroid by the chance of the noise",
        "width": "width of the spectrum, (2 |d2 Re sigma/dk2| t)^(-1/2)",
    }
    data = {f"run_{name}": variable("run", [run[name] for run in runs], text) for name, text in summary.items()}
    data |= {
        "run_damping": variable("run", points[:, 0], "damping of the run"),
        "run_ratio": variable("run", points[:, 1], "diffusivity over softness of the run"),
        "ratio": variable(("damping", "point"), curves[:, 0], "diffusivity over softness at which k_max is a maximum"),
        "k_max": variable(("damping", "point"), curves[:, 1], "wavenumber of a maximum of the growth rate, leading order"),
        "exact_ratio": variable(("damping", "exact_point"), exact[0], "diffusivity over softness"),
        "exact_k_max": variable(
            ("damping", "exact_point"), exact[1], f"wavenumber of the fastest mode, cubic, softness {SOFTNESS}"
        ),
        "undiffused_k_max": variable(
            ("softness", "small_damping"), undiffused, "wavenumber of the fastest mode without diffusion, cubic"
        ),
        "spectrum": variable(("time", "wavenumber"), spectrum, "power per wavenumber of the first run, over its total"),
        "expected_spectrum": variable(
            ("time", "wave"), expected_spectrum, "exp(2 Re sigma t) of the first run, over its integral"
        ),
    }  # fmt: skip
    coordinates = {
        "damping": variable("damping", DAMPINGS, "damping of the cars"),
        "softness": variable("softness", softnesses, "softness of the road"),
        "small_damping": variable("small_damping", small, "damping of the cars"),
        "time": variable("time", first["time"], "time of the spectra, in 1/omega_0"),
        "wave": variable("wave", first["k"], "wavenumbers of the ring, in omega_0/v"),
        "wavenumber": variable("wavenumber", binned(first["k"], BIN[waves]), "wavenumber of the spectra, in omega_0/v"),
    }
    for i, (damping, ratio) in enumerate(EXTRA):
        k, growth = roots(damping, ratio)
        text = f"of the k_max equation at damping {damping:g}, diffusivity over softness {ratio:g}"
        data[f"roots_{i}_growth"] = variable(f"roots_{i}", growth, f"growth rate over softness at the roots {text}")
        coordinates[f"roots_{i}"] = variable(f"roots_{i}", k, f"roots {text}")
    ds = xr.Dataset(data, coordinates)
    ds.attrs = {
        "Conventions": "CF-1.11",
        "title": "Fastest growing mode, and the wavenumber that cars select on a noisy road",
        "references": "Both, Hong and Kurtze, Corrugation of Roads, Fig. 4",
        "softness": SOFTNESS,
        "waves": waves,
    }
    highest = float(tr.theory.fastest_mode_exact(0.1, 0.0, 0.05)[0])
    print("Gamma  Delta/alpha  leading   exact  expected  selected  chance   width")
    for (damping, ratio), run in zip(points, runs, strict=True):
        print(
            f"{damping:5.1f}  {ratio:11.2f}  {float(tr.theory.fastest_mode(ratio, damping)):7.4f} {run['fastest']:7.4f} "
            f"{run['expected']:9.4f} {run['selected']:9.4f} {run['chance']:7.4f} {run['width']:7.4f}"
        )
    deviation = (ds.run_selected - ds.run_expected) / ds.run_chance
    scatter = float(np.sqrt((deviation**2).mean()))
    print(
        f"selected against expected: {np.abs(deviation).max().item():.1f} standard deviations at the most, rms {scatter:.2f}"
    )
    for damping in DAMPINGS[DAMPINGS < 0.5]:
        text = f"{tr.theory.critical_ratio(damping):.4f} (leading order), {takeover(damping):.4f} (softness {SOFTNESS})"
        print(f"k = 0 takes over at Delta/alpha = {text} at damping {damping:g}")
    print(f"k_max = {highest:.4f} at softness 0.1, damping 0.05, no diffusion (leading order {1 / np.sqrt(1.1):.4f})")
    store("fig4_fastest_mode", chosen.output, ds, draw(ds, points))

    for (ratio, k), damping in zip(curves, DAMPINGS, strict=True):
        leads = ratio < tr.theory.critical_ratio(damping) * (1 - 1e-9)
        # the paper's curve is the global maximum up to the jump, to the rounding of a ratio at its double root
        assert np.abs(k - tr.theory.fastest_mode(ratio, damping))[leads].max() < 1e-9, damping
        assert (tr.theory.fastest_mode(ratio, damping)[~leads] == 0).all(), damping
        if damping < 0.5:
            assert abs(ratio[-1] / tr.theory.merging_ratio(k[-1]) - 1) < 1e-12, damping  # ends on the dashed curve
            jump = np.sqrt(1 - 2 * damping)  # and crosses the dotted one where (1-k^2)/2 is the damping
            assert abs(tr.theory.jump_ratio(jump) / tr.theory.critical_ratio(damping) - 1) < 1e-12, damping
        assert k.max() < 1, damping
        if damping < 0.5:  # on soft roads k = 0 takes over before the dotted curve
            last = takeover(damping)
            assert last < tr.theory.critical_ratio(damping), damping
            beside = tr.theory.fastest_mode_exact(SOFTNESS, np.array([0.999, 1.001]) * last * SOFTNESS, damping)[0]
            assert beside[0] > 0.3 and beside[1] == 0, (damping, beside)
    # k_max = 1 - Gamma + O(Gamma^2): with no diffusion the next term is 3 Gamma^2/2
    tiny = np.array([0.01, 0.02])
    assert (np.abs(tr.theory.fastest_mode(0.0, tiny) - 1 + tiny) < 1.5 * tiny**2).all()
    # the equation's further roots: maxima with k > 1, where waves decay, and local maxima that k = 0 outgrows
    assert (ds.roots_0.values > 1).sum() == 2 and (ds.roots_0_growth.values[ds.roots_0.values > 1] < 0).all()
    assert abs(ds.roots_0.values[0] - tr.theory.fastest_mode(EXTRA[0, 1], EXTRA[0, 0])) < 1e-12
    assert (ds.roots_1_growth.values < 0).all() and tr.theory.fastest_mode(EXTRA[1, 1], EXTRA[1, 0]) == 0
    assert abs(highest - 1.016) < 5e-4 and ds.undiffused_k_max.max() > 1, highest  # "in no case" is the leading order
    # cars: the centroid is where theory has it but for the chance of the noise (3.5 standard deviations: once in 2000),
    # and the fastest mode is inside the peak
    assert np.abs(deviation).max() < 3.5, deviation.values
    assert (np.abs(ds.run_selected - ds.run_fastest) < ds.run_width).all()


@rc_context({"font.size": 8})
def draw(ds, points) -> Figure:
    figure = Figure(figsize=(10, 3.7), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.3, 1, 1))
    dampings = []
    for i, (damping, colour) in enumerate(zip(DAMPINGS, COLOURS, strict=True)):
        dampings += left.plot(ds.ratio[i], ds.k_max[i], color=colour, lw=1.3, label=f"{damping:.1f}")
        left.plot(ds.exact_ratio[i], ds.exact_k_max[i], "-.", color=colour, lw=0.9)
    inner = np.sqrt(np.linspace(0, 0.42, 101))
    left.plot(tr.theory.merging_ratio(inner), inner, "--", color=BLACK, lw=0.9)
    left.plot(tr.theory.jump_ratio(inner), inner, ":", color=BLACK, lw=1.2)
    for i, (damping, ratio) in enumerate(points):
        colour = COLOURS[int(np.argmin(np.abs(DAMPINGS - damping)))]
        left.errorbar(
            ratio, ds.run_selected[i], ds.run_width[i], fmt="o", color=colour, ms=4, mfc="white", lw=1, zorder=3
        )
    styles = [
        left.plot([], [], "-", color=BLACK, lw=1.3, label="leading order")[0],
        left.plot([], [], "-.", color=BLACK, lw=0.9, label=f"exact, $\\alpha={SOFTNESS}$")[0],
        left.errorbar([], [], [], fmt="o", color=BLACK, ms=4, mfc="white", lw=1, label="cars on noise: mean, width"),
        left.plot([], [], ":", color=BLACK, lw=1.2, label="beyond, $k=0$ grows faster")[0],
        left.plot([], [], "--", color=BLACK, lw=0.9, label="beyond, no maximum")[0],
    ]
    left.add_artist(left.legend(handles=styles, frameon=False, loc="lower left", fontsize="small"))
    left.set(
        xlabel="diffusivity over softness $\\Delta/\\alpha$",
        ylabel="wavenumber $k_{max}$ $(\\omega_0/v)$",
        title="The fastest mode, and what cars select on a noisy road",
        xlim=(-0.02, 1.4),
        ylim=(0, 1),
    )
    left.legend(
        handles=dampings,
        title="damping $\\Gamma$ (top to bottom)",
        frameon=False,
        loc="upper right",
        ncols=4,
        fontsize="medium",
    )
    small = ds.small_damping.values
    middle.semilogx(small, 1 / np.sqrt(1 + 2 * small), color=BLACK, lw=1.5, label="leading order")
    for row, style, colour in zip(ds.undiffused_k_max, ("-.", "--", "-"), (BLUE, GREEN, RED), strict=True):
        middle.plot(small, row, style, color=colour, lw=1.5, label=f"exact, $\\alpha={float(row.softness):g}$")
    middle.axhline(1, color=BLACK, lw=0.6, ls=":")
    middle.set(
        xlabel="damping $\\Gamma$",
        ylabel="wavenumber $k_{max}$ $(\\omega_0/v)$",
        title="On soft roads $k_{max}$ exceeds 1 ($\\Delta=0$)",
    )
    middle.legend(frameon=False, loc="lower left")
    damping, ratio = points[0]
    for j, colour in ((1, SKY), (2, ORANGE), (4, BLACK)):
        right.plot(ds.wavenumber, ds.spectrum[j], "o", color=colour, ms=3, mfc="none", mew=0.8)
        right.plot(ds.wave, ds.expected_spectrum[j], color=colour, lw=1.2, label=f"{float(ds.time[j]):.0f}")
    right.axvline(float(ds.run_fastest[0]), color=RED, lw=0.8, ls="--", label="fastest")
    right.set(
        xlabel="wavenumber $k$ $(\\omega_0/v)$",
        ylabel="spectral density of the road (area 1)",
        title=f"A noisy road selects ($\\Gamma={damping:g}$, $\\Delta/\\alpha={ratio:g}$)",
        xlim=(0.3, 1.2),
    )
    right.legend(title="cars; line: theory\nat time $(1/\\omega_0)$", frameon=False, loc="upper left")
    return figure


if __name__ == "__main__":
    main()
