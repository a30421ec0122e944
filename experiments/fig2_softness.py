"""Fig. 2 of Both, Hong and Kurtze: softness laws that a road may have, and what each does to a road that only settles.

    a(H) = a(0) exp(eps H)                tends to 0 as H -> -infinity
    a(H) = a(0) max(0, 1 + H/depth)       vanishes below a finite depth

A flat road settles by dH/dt = -alpha(H) (1 + H - Z), Z'' + 2 Gamma (Z - H)' + Z - H = 0, with alpha = M omega_0 a. To
leading order in alpha the exponential road sinks for ever, as the logarithm of time, and the bounded one stops:

    H = -ln(1 + eps alpha_0 t)/eps,    H = depth (exp(-alpha_0 t/depth) - 1).

Beyond the paper: the cars themselves on a flat road, the next order (the road that sinks ever more slowly slows the cars
down, which press with 1 + alpha alpha'), and beta/alpha, where the two laws part for good. It is eps for ever on the
exponential road; on the bounded road it is 1/(depth + H), and every corrugation comes to decay, since from
beta/alpha = 1/(4 Gamma(1+Gamma)) on no road is unstable. A perturbation gains at most a finite factor there.

Run: python experiments/fig2_softness.py [--quick]        (about 4 s; 4 s)
"""

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.plots import BLACK, BLUE, ORANGE

SOFTNESS, HARDENING, DEPTH, DAMPING = 0.05, 0.5, 2.0, 0.3  # hardening * depth = 1: the same law to first order at H = 0
LAWS = {"exponential": tr.Exponential(SOFTNESS, HARDENING), "bounded": tr.Bounded(SOFTNESS, DEPTH)}
STYLES = {"exponential": (BLUE, "-", "o"), "bounded": (ORANGE, "-", "s")}
HEADWAY, NODES = 1.0, 16  # of the one car that settles a flat ring of one headway; a flat road has nothing to resolve
END = 4000.0


def cars(law, end: float) -> xr.Dataset:
    """Mean height of a flat road under cars one headway apart, from their passages."""
    scene = tr.Scene(tr.Road(HEADWAY, law), tr.Fleet(1, DAMPING), duration=end)
    return tr.simulate(scene, "cars", samples=round(end / HEADWAY) + 1, nodes=NODES, progress=False)


def excess(law, road):
    """How much the closed form is too soft, ln(alpha_closed/alpha), to leading order: cars press with 1 + alpha alpha'.

    Exponential: with u = exp(-eps H), du/dt = eps alpha_0 (1 + eps alpha^2).
    Bounded: d ln(alpha)/dt = -alpha'(1 + alpha alpha').
    """
    if isinstance(law, tr.Exponential):
        u = np.exp(-law.hardening * road)
        return law.hardening * law.value**2 * (u - 1) / u**2
    return law.value / law.depth * (law.value - law(road))


def variable(dims, values, long_name):
    return dims, np.asarray(values, dtype=float), {"long_name": long_name, "units": "1"}


def main() -> None:
    chosen = options(__doc__)
    end = END / 10 if chosen.quick else END
    height = np.linspace(-8.0, 2.0, 401)
    time = np.unique(np.round(np.geomspace(1.0, end, 31)))  # whole headways, where the cars are sampled
    data, coordinates = {}, {
        "height": variable("height", height, "height of the road surface, in g/omega_0^2"),
        "time": variable("time", time, "time, in 1/omega_0"),
    }  # fmt: skip
    for name, law in LAWS.items():
        full, closed = (tr.theory.settle(law, DAMPING, time, full=full) for full in (True, False))
        run = cars(law, end)
        found = run.road_height.mean("x").sel(time=time, method="nearest")
        assert np.allclose(found.time, time, rtol=0, atol=1e-6)  # else the table below is not of these times
        text = f"of the road with {name} softness"
        known = full.where(full.softness > 1e-9 * law.value)  # a road at its depth: alpha is rounding
        data |= {
            f"softness_{name}": variable("height", law(height), f"softness {text} against its height"),
            f"height_{name}": variable("time", full.road_height, f"height {text}, settling equations"),
            f"height_closed_{name}": variable("time", closed.road_height, f"height {text}, closed form"),
            f"height_cars_{name}": variable("time", found, f"mean height {text}, discrete cars"),
            f"hardening_{name}": variable(
                "time",
                known.hardening_rate / known.softness,
                f"hardening rate over softness {text}",
            ),
            f"excess_{name}": variable(
                "time",
                np.log(closed.softness.where(closed.softness > 0) / known.softness),
                f"ln of the softness {text}, closed form over full",
            ),
            f"excess_next_order_{name}": variable(
                "time", excess(law, full.road_height.values), f"the same {text}, next order of the closed form"
            ),
        }
    ds = xr.Dataset(data, coordinates)
    ds.attrs = {
        "Conventions": "CF-1.11",
        "title": "Admissible softness laws and the settling road",
        "references": "Both, Hong and Kurtze, Corrugation of Roads, Fig. 2",
        **{f"law_{name}": repr(law) for name, law in LAWS.items()},
        "damping": DAMPING,
    }
    most = 1 / (4 * DAMPING * (1 + DAMPING))
    for name in LAWS:
        print(
            f"{name:<12} H({time[-1]:g}) = {ds[f'height_{name}'].values[-1]:.4f}, cars differ by "
            f"{np.abs(ds[f'height_cars_{name}'] - ds[f'height_{name}']).max().item():.1e}, closed form by "
            f"{np.abs(ds[f'height_closed_{name}'] - ds[f'height_{name}']).max().item():.1e}; "
            f"beta/alpha from {ds[f'hardening_{name}'].min().item():.3f} to {ds[f'hardening_{name}'].max().item():.3g}"
        )
    print(
        f"no road is unstable above beta/alpha = {most:.3f}; the bounded one gets there at H = {1 / most - DEPTH:.3f}"
    )
    store("fig2_softness", chosen.output, ds, draw(ds, most))

    for name, law in LAWS.items():
        softness, shallow = ds[f"softness_{name}"].values, height > (-DEPTH if name == "bounded" else -np.inf)
        assert (softness[shallow] > 0).all() and (np.diff(softness[shallow]) > 0).all(), name  # what the paper requires
        # and its two limits: 0 as H -> -infinity, here to rounding at -100/eps; 0 exactly below the depth
        assert float(law(-100 / HARDENING)) < 1e-40, name
        # the full equations differ from the closed form by the next order of alpha alpha', and that by the one after it,
        # a relative alpha_0 (here 0.05) or so
        settled = (time > 10 / DAMPING) & (ds[f"excess_next_order_{name}"].values > 1e-5)
        ratio = (ds[f"excess_{name}"] / ds[f"excess_next_order_{name}"]).values[settled]
        ratio = ratio[np.isfinite(ratio)]
        assert ratio.size > 3 and np.abs(ratio - 1).max() < SOFTNESS, (name, ratio)
        # cars, second order in the headway: the first few passages find the road flat and ring by about (alpha l)^2/9;
        # later each passage is a midpoint step, of relative error (alpha' l)^2/12 in alpha' t
        error = np.abs(ds[f"height_cars_{name}"] - ds[f"height_{name}"]).values
        assert error.max() < (SOFTNESS * HEADWAY) ** 2 / 4, (name, error.max())
        assert error[time > 10 / DAMPING].max() < (SOFTNESS / DEPTH * HEADWAY) ** 2 / 12 * DEPTH, (name, error)
    assert (ds.softness_bounded.values[height <= -DEPTH] == 0).all()
    late = time > 0.3 * end
    slope = np.polyfit(np.log(time[late] + 1 / (HARDENING * SOFTNESS)), ds.height_exponential.values[late], 1)[0]
    # logarithmic sinking, by 1/eps an e-folding of time; the next order shifts the clock by alpha_0
    assert abs(slope * HARDENING + 1) < SOFTNESS / (0.3 * end), slope
    assert (
        np.abs(ds.hardening_exponential / HARDENING - 1).max() < 1.5 * HARDENING * SOFTNESS**2
    )  # force 1 + alpha alpha'
    remains = DEPTH + ds.height_bounded.values[-1]
    assert remains < 1.01 * DEPTH * np.exp(-SOFTNESS * end / DEPTH) + 1e-9, remains  # it stops at its depth
    assert ds.hardening_bounded.min() < most < ds.hardening_bounded.max()  # it leaves every unstable region


def draw(ds, most) -> Figure:
    figure = Figure(figsize=(14, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for name, (colour, line, marker) in STYLES.items():
        left.plot(ds.height, ds[f"softness_{name}"] / SOFTNESS, line, color=colour, lw=2, label=name)
        middle.semilogx(ds.time, ds[f"height_{name}"], line, color=colour, lw=2, label=f"{name}, settling equations")
        middle.plot(ds.time, ds[f"height_closed_{name}"], "--", color=BLACK, lw=1)
        middle.plot(ds.time, ds[f"height_cars_{name}"], marker, color=colour, mfc="white", ms=5, label=f"{name}, cars")
        right.loglog(ds.time, ds[f"hardening_{name}"], line, color=colour, lw=2, label=name)
    left.axvline(-DEPTH, color=BLACK, lw=0.6, ls=":")
    left.annotate("depth", (-DEPTH, 1.5), (-3, 0), "data", "offset points", rotation=90, ha="right", fontsize="small")
    left.set(
        xlabel="road height $H$ $(g/\\omega_0^2)$",
        ylabel="softness $a(H)/a(0)$",
        title="Two laws by which a road hardens as it sinks",
    )
    left.legend(frameon=False, loc="upper left")
    middle.plot([], [], "--", color=BLACK, lw=1, label="closed forms")
    middle.axhline(-DEPTH, color=BLACK, lw=0.6, ls=":")
    middle.set(
        xlabel="time $(1/\\omega_0)$",
        ylabel="road height $H_0$ $(g/\\omega_0^2)$",
        title="One sinks for ever, as $\\ln t$; the other stops",
    )
    middle.legend(frameon=False, loc="lower left", fontsize="small")
    right.axhline(most, color=BLACK, lw=0.8, ls="--")
    right.annotate(
        f"above: no wave grows ($\\Gamma={DAMPING}$)",
        (ds.time.values[-1], most),
        (0, 4),
        "data",
        "offset points",
        ha="right",
        fontsize="small",
    )
    right.set(
        xlabel="time $(1/\\omega_0)$",
        ylabel="hardening rate over softness $\\beta/\\alpha$",
        title="Hardening: constant, or in the end too fast",
        ylim=(0.3, 30),
    )
    right.legend(frameon=False, loc="upper right")
    return figure


if __name__ == "__main__":
    main()
