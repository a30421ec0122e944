"""The pictures of work_precision: error against time, a row a scene, a column a question."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from traffic_road.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY

TITLES = {
    "cars": "How a car steps",
    "relaxation": "How the road relaxes",
    "continuum": "The continuum of many cars",
    "model": "Model for 8 cars a wavelength",
}
SCENES = {
    "smooth": "smooth, linear",
    "hardening": "hardening road",
    "bouncing": "bouncing cars",
    "resonance": "near-critical resonance",
}
OF = {
    "growth_error": "error of the growth rate",
    "velocity_error": "error of the velocity",
    "wave_error": "error of the first harmonic",
}
TIMES = ("time of the passages (s)", "passages and relaxation (s)", "time (s)", "time (s)")
GREY = "0.8"
STYLES = {
    "cars": {
        "forward Euler": (RED, "v"),
        "semi-implicit Euler": (ORANGE, "v"),
        "semi-implicit Euler, implicit damping": (ORANGE, "^"),
        "Heun": (PURPLE, "s"),
        "RK4": (PURPLE, "D"),
        "trapezoid": (BLACK, "s"),
        "exact, linear hold": (SKY, "o"),
        "exact, cubic hold": (BLUE, "o"),
        "exact, quintic hold": (GREEN, "o"),
    },
    "relaxation": {
        "explicit": (RED, "v"),
        "Crank-Nicolson": (PURPLE, "s"),
        "backward Euler": (ORANGE, "^"),
        "exact": (BLUE, "o"),
    },
    "continuum": {
        "RK45": (ORANGE, "v"),
        "DOP853": (RED, "^"),
        "LSODA": (PURPLE, "s"),
        "BDF": (SKY, "D"),
        "Radau": (BLACK, "p"),
        "cars, force from before": ("0.45", "$b$"),
        "cars, midpoint": (GREEN, "$m$"),
        "this package": (BLUE, "o"),
    },
    "model": {
        "linear": (ORANGE, "^"),
        "continuum": (BLACK, "s"),
        "cars, hold 1": (SKY, "o"),
        "cars, hold 3": (BLUE, "o"),
        "cars, hold 5": (GREEN, "o"),
        "theory: leading order": (RED, "v"),
        "theory: cubic": (PURPLE, "s"),
        "theory: with headway": (PURPLE, "D"),
        "theory: Floquet": (RED, "D"),
    },
}
LOWEST = 1e-10
EDGE, BELOW = 4.0, 0.55  # where failed runs stand, those of each method a little below the last's


def draw(ds) -> Figure:
    figure = Figure(figsize=(13, 13.5), layout="constrained")
    grid = panels(figure, (1, 1, 1, 1, 0.62))
    for i, name in enumerate(SCENES):
        for axes, question in zip(grid[i], TITLES, strict=True):
            panel(axes, ds, name, question, "error")
            if i == 0:
                axes.set_title(TITLES[question])
        grid[i, 0].set_ylabel(f"{SCENES[name]}\nerror of the road")
    for axes, text in zip(grid[3], TIMES, strict=True):
        axes.set_xlabel(text)
    for axes, question in zip(grid[4], TITLES, strict=True):
        legend(axes, question, [method for method in STYLES[question] if not method.startswith("theory")])
    figure.suptitle("Error (1e-10: or less) against time of one core; crosses failed, the grey line is the front")
    return figure


def draw_growth(ds) -> Figure:
    """The long wave alone: growth rate and velocity in the linear scenes, the first harmonic under bouncing cars."""
    figure = Figure(figsize=(13, 16), layout="constrained")
    grid = panels(figure, (1, 1, 1, 1, 1, 0.66))
    shown = [(name, what) for name in ("smooth", "resonance") for what in ("growth_error", "velocity_error")]
    for row, (name, what) in zip(grid[:5], [*shown, ("bouncing", "wave_error")], strict=True):
        for axes, question in zip(row, TITLES, strict=True):
            panel(axes, ds, name, question, what)
        row[0].set_ylabel(f"{SCENES[name]}\n{OF[what]}")
    for axes, title in zip(grid[0], TITLES.values(), strict=True):
        axes.set_title(title)
    for axes, text in zip(grid[4], TIMES, strict=True):
        axes.set_xlabel(text)
    for axes, question in zip(grid[5], TITLES, strict=True):
        legend(axes, question)
    figure.suptitle(
        "The long wave alone, against closed forms (1e-10: or less): high orders pay, less under bouncing cars"
    )
    return figure


def panels(figure, heights):
    """Axes (rows, 4), the last row for the legends; a column, a question, has one axis of time."""
    grid = figure.subplots(len(heights), 4, height_ratios=heights)
    for axes in grid[1:-1].ravel():
        axes.sharex(grid[0, axes.get_subplotspec().colspan.start])
    for axes in grid[:-2].ravel():
        axes.tick_params(labelbottom=False)
    return grid


def panel(axes, ds, name, question, what):
    mine = ds.isel(run=np.flatnonzero((ds.scene == name) & (ds.question == question)))
    seconds, error, sound = mine.seconds.values, mine[what].values, mine.reason.values == ""
    known = sound & np.isfinite(error)  # a closed form has no road
    lowest = max(LOWEST, 0.3 * np.min(error[known & (error > 0)]))
    error = np.maximum(error, lowest)
    line(axes, seconds[known], error[known], color=GREY, lw=7, zorder=0, solid_capstyle="round")
    edge = EDGE
    for method, (colour, marker) in STYLES[question].items():
        is_it = mine.method.values == method
        good, bad = is_it & known, is_it & ~sound & np.isfinite(seconds)
        axes.plot(seconds[good], error[good], ls="", marker=marker, color=colour, ms=4, mfc="none", mew=0.9, alpha=0.7)
        line(axes, seconds[good], error[good], color=colour, lw=0.9)
        axes.plot(seconds[bad], np.full(bad.sum(), edge), "x", color=colour, ms=5)
        if np.any(is_it & ~sound & ~np.isfinite(seconds)):  # refused: it took no time
            axes.plot(0.02, edge, "x", color=colour, ms=5, transform=axes.get_yaxis_transform())
        edge *= BELOW if np.any(is_it & ~sound) else 1.0  # so that none hides another
    axes.set(xscale="log", yscale="log", ylim=(lowest / 2, 8.0))
    axes.minorticks_off()
    axes.axhline(1.0, color=BLACK, lw=0.5, ls=":")
    axes.grid(lw=0.3)


def line(axes, seconds, error, **style):
    """Through the runs that nothing beside them beats in both."""
    order = np.lexsort((error, seconds))
    seconds, error = seconds[order], error[order]
    on = np.diff(np.minimum.accumulate(error), prepend=np.inf) < 0
    axes.plot(seconds[on], error[on], "-", **style)


def legend(axes, question, methods=None):
    axes.axis("off")
    marks = []
    for method in methods or STYLES[question]:
        colour, marker = STYLES[question][method]
        marks.append(Line2D([], [], color=colour, marker=marker, mfc="none", lw=0.9, label=method))
    axes.legend(handles=marks, loc="upper center", frameon=False, fontsize="small")
