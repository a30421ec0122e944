"""Fig. 8 of Both, Hong and Kurtze: the velocity of quasi-steady corrugations, and why softness hardly matters to it.

(a) Velocity c of the travelling waves of Fig. 7 against wavenumber k, by Newton's method, continuum and cars; the solid
curves are what the linear theory, without lift-off, would give for alpha = 0.0055 (upper) and 0.0040 (lower).
(b) c_diff = c(alpha = 0.0060) - c(alpha).

The collapse is harmonic balance. To its first harmonic the wave h = A cos(k(x - ct)) feels the force alpha N R A, where
the clip leaves a share N(A) < 1 of it, real and positive: lift-off replaces alpha by alpha N, and nothing else. A steady
amplitude is neutral, so that alpha N is the neutral softness whatever alpha is, and c is the neutral velocity,

    c = X/(1 + X),    X = 2 Gamma Delta k^2/(1 - kappa^2),    kappa = k (1 - c),

about 2 Gamma Delta k^2/(1 - k^2) away from k = 1: independent of alpha, proportional to damping and to diffusion. In the
linear theory X = 2 Gamma alpha kappa^2/((1 - kappa^2)^2 + 4 Gamma^2 kappa^2) grows with alpha. What is left in (b) is the
work of the higher harmonics, which alpha N does not see.

The caption names 0.0060 and the text 0.0055 as the largest softness; the curves here are those of the caption.

Run: python experiments/fig8_velocity.py [--quick]        (about 60 s; 4 s)
"""

import numpy as np
from common import options, store
from fig7_amplitude import CAR, COLOURS, COUNT, MARKERS, QUICK, SOFTNESS, WAVENUMBERS, differences, lines, saturated
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.plots import BLACK

ENVELOPE = (0.0055, 0.0040)  # upper and lower solid curve
REFERENCE = 0.0060  # of c_diff
MARKERS_B = {0.0055: "o", 0.0050: "s", 0.0045: "D", 0.0040: "^"}  # the caption's of (b), not those of (a)


def linear_velocity(k, softness):
    """Phase velocity of the linear theory, lift-off ignored."""
    return -tr.theory.dispersion(k, softness=softness, **CAR).imag / k


def neutral_velocity(k):
    """That of harmonic balance at any softness."""
    return linear_velocity(k, tr.theory.neutral_softness(k, **CAR))


def spread(velocity_at) -> float:
    """Relative change of c from softness 0.0040 to 0.0060 at k = 0.9, of the function velocity_at(softness)."""
    return float(velocity_at(0.0060) / velocity_at(0.0040) - 1)


def main() -> None:
    chosen = options(__doc__)
    softnesses, wavenumbers = QUICK if chosen.quick else (SOFTNESS, WAVENUMBERS)
    ds = saturated(softnesses, wavenumbers)
    ds["velocity_difference"] = ds.velocity.sel(softness=REFERENCE) - ds.velocity
    ds.velocity_difference.attrs = {
        "long_name": "velocity at softness 0.0060 minus that at this softness",
        "units": "1",
    }
    curve = lines(softnesses, 7 if chosen.quick else 31)
    ds = ds.merge(curve[["k_line", "velocity_line"]])
    at = ds.k_line.sel(softness=softnesses)
    reference = [
        [tr.theory.travelling_wave(k, softness=REFERENCE, **CAR, modes=32).velocity for k in row] for row in at
    ]
    ds["difference_line"] = np.array(reference, dtype=float) - ds.velocity_line
    ds.difference_line.attrs = ds.velocity_difference.attrs
    k = np.linspace(0.64, 0.99, 141)
    ds["k_theory"] = "k_theory", k, {"long_name": "wavenumber", "units": "1"}
    ds["linear_velocity"] = (
        ("envelope", "k_theory"),
        np.array([linear_velocity(k, softness) for softness in ENVELOPE]),
        {"long_name": "velocity of the linear theory without lift-off", "units": "1"},
    )
    ds["envelope"] = "envelope", np.array(ENVELOPE), {"long_name": "softness", "units": "1"}
    neutral = neutral_velocity(k)
    ds["harmonic_balance"] = "k_theory", neutral, {"long_name": "velocity to the first harmonic", "units": "1"}
    ds.attrs["title"] = "Velocity of quasi-steady corrugations (Fig. 8)"
    clipped = spread(lambda softness: tr.theory.travelling_wave(0.9, softness=softness, **CAR, modes=64).velocity)
    unclipped = spread(lambda softness: linear_velocity(0.9, softness))
    beyond = ds.velocity.sel(source="Newton") / neutral_velocity(ds.k) - 1
    ds.attrs |= {"spread_quasi_steady": clipped, "spread_linear": unclipped}
    print(
        f"from softness 0.0040 to 0.0060 at k = 0.9: c rises by {clipped:.2%}, in the linear theory by {unclipped:.2%}"
    )
    print(f"c exceeds that of harmonic balance by {float(beyond.min()):.2%} to {float(beyond.max()):.2%}")
    for source, worst in differences(ds, "velocity").groupby("source"):
        print(f"velocity of the {source} runs: within {float(worst.max()):.1e} of Newton's")
    store("fig8_velocity", chosen.output, ds, draw(ds))

    for source, bound in (("continuum", 1e-3), ("cars", 5e-3)):  # as in fig7_amplitude.py
        worst = float(differences(ds, "velocity").sel(source=source).max())
        assert worst < bound, (source, worst)
    # the paper: the softer the road, the faster the wave, but by far less than without lift-off
    gap = ds.velocity_difference.sel(source="Newton", softness=softnesses[softnesses < REFERENCE])
    assert bool((gap.where(gap.notnull(), 1.0) > 0).all())
    assert 0 < clipped < unclipped / 10, (clipped, unclipped)
    # harmonic balance leaves out the harmonics: a few per cent of c, and of one sign
    assert float(beyond.min()) > -1e-3 and float(beyond.max()) < 0.06, beyond
    wave = tr.theory.harmonic_balance(0.9, softness=0.005, **CAR)
    assert abs(float(wave.velocity) / neutral_velocity(0.9) - 1) < 1e-10  # two ways to the same closed form
    c = float(neutral_velocity(0.9))
    kappa = 0.9 * (1 - c)
    x = 2 * CAR["damping"] * CAR["diffusivity"] * 0.9**2 / (1 - kappa**2)
    assert abs(c / (x / (1 + x)) - 1) < 1e-10  # the docstring's


def draw(ds) -> Figure:
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for softness in ds.softness.values:
        i = int(np.argmin(abs(SOFTNESS - softness)))
        one, marker, colour = ds.sel(softness=softness), MARKERS[i], COLOURS[i]
        left.plot(one.k, one.velocity.sel(source="continuum"), marker, color=colour, mfc="none", ms=8, mew=1.4)
        left.plot(one.k, one.velocity.sel(source="cars"), ".", color=BLACK, ms=3)
        left.plot([], [], marker, color=colour, mfc="none", ms=8, mew=1.4, label=f"{softness:.4f}")
        if softness == REFERENCE:
            continue
        marker = MARKERS_B[float(softness)]
        difference = one.velocity_difference * 1e4
        right.plot(one.k_line, one.difference_line * 1e4, "-", lw=1, color=colour)
        right.plot(one.k, difference.sel(source="continuum"), marker, color=colour, mfc="none", ms=8, mew=1.4)
        right.plot(one.k, difference.sel(source="cars"), ".", color=BLACK, ms=3)
        right.plot([], [], marker, ls="-", lw=1, color=colour, mfc="none", ms=8, mew=1.4, label=f"{softness:.4f}")
    for velocity, softness, place in zip(ds.linear_velocity, ENVELOPE, ((-6, 4), (6, -12)), strict=True):
        left.plot(ds.k_theory, velocity, "-", lw=1, color=BLACK)
        j = int(np.argmin(abs(ds.k_theory.values - 0.86)))
        left.annotate(
            f"linear, $\\alpha$ = {softness:.4f}",
            (ds.k_theory[j], velocity[j]),
            xytext=place,
            textcoords="offset points",
            ha="right" if place[0] < 0 else "left",
            fontsize="small",
        )
    left.plot(ds.k_theory, ds.harmonic_balance, "--", lw=1.2, color=BLACK, label="harmonic balance, any $\\alpha$")
    shown = float(ds.velocity.max())
    left.set(
        xlabel="wavenumber $k$ $(\\omega_0/v)$",
        ylabel="velocity $c$ $(v)$",
        title="(a) Quasi-steady velocities collapse on one curve",
        xlim=(0.64, 1.0),
        ylim=(0, 1.12 * max(shown, float(ds.linear_velocity.max()))),
    )
    left.legend(title="softness $\\alpha$ (dots: cars)", frameon=False, loc="upper left")
    right.set(
        xlabel="wavenumber $k$ $(\\omega_0/v)$",
        ylabel="$c(\\alpha=0.0060)-c(\\alpha)$ $(10^{-4}\\,v)$",
        title=f"(b) What softness still does; dots: {COUNT} cars a wavelength",
        xlim=(0.64, 1.0),
        ylim=(0, None),
    )
    right.legend(title="softness $\\alpha$, Newton and continuum", frameon=False, loc="upper left")
    return figure


if __name__ == "__main__":
    main()
