"""The least model, and its least resolution, whose predicted error meets a tolerance."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from . import costs
from .errors import SceneError, StabilityError, shown
from .laws import finite
from .models import linear, model
from .predict import ByRuns, ByTheory, constant_laws, whole_headways
from .scene import Scene

ROWS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 1024, 2048)  # nodes a headway that are tried
INTERVALS = (4, 2, 1)  # headways from one relaxation to the next; only divisors of the duration
STEPS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # of the continuum where it needs any
SAFE = 0.7  # of the tolerance: predicted errors are right to about so much
LONG = 20.0  # seconds beyond which no tolerance is worth a finer grid, unless the coarsest takes as long
NEARLY = 2.0  # times the least error: where no resolution will do, the cheapest that is nearly as good
KEYWORDS = ("nodes", "hold", "relax_every", "step")


@dataclass(frozen=True)
class Plan:
    """A model and its numerics for a scene; `print` it for the reasons.

    error: predicted relative error of the corrugation at the end (L2, mean removed) against the discrete scene itself,
    cars on a fine grid; model_error: the part of it that no resolution removes. cost: predicted seconds of one core for the
    run alone. planning_time: seconds that the plan has taken.
    """

    model: str
    numerics: dict
    error: float
    model_error: float
    cost: float
    tolerance: float
    reason: str
    planning_time: float

    def __str__(self):
        settings = ", ".join(f"{name} {value:g}" for name, value in self.numerics.items())
        return (
            f"{self.model}: {settings}\n"
            f"predicted error {self.error:.1e} of the corrugation at the end (tolerance {self.tolerance:g}), "
            f"of it {self.model_error:.1e} by the model\n"
            f"predicted cost {self.cost:.2g} s; planned in {self.planning_time:.2g} s\n"
            f"{self.reason}"
        )


class Option(NamedTuple):
    """One way to run a scene: `error()` predicts (error, part of the model), at a cost of its own."""

    model: str
    numerics: dict
    cost: float
    error: Callable


def plan(scene, tolerance: float = 1e-3, **numerics) -> Plan:
    """The cheapest of linear, continuum and cars, and of their resolutions, predicted to meet `tolerance`.

    tolerance: relative error of the corrugation (L2 over the road, mean removed) at the end, against the discrete scene:
    cars on a fine grid, the road relaxed every headway. numerics: nodes, hold, relax_every, step, to be kept as given.
    Where nothing that was tried will do, the cheapest that is nearly as good as the best, and `reason` says so.
    SceneError, StabilityError: a scene or numerics that no model can run.
    """
    begin = clock.perf_counter()
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; preset(name) and Scene.from_toml(path) give one")
    tolerance = finite("tolerance", tolerance, above=0)
    for name in sorted(set(numerics) - set(KEYWORDS)):
        raise SceneError(f"{name}: not a parameter of any model; they take {', '.join(KEYWORDS)}")
    lost = linear.takes_off(scene, scene.duration) if constant_laws(scene) else None
    theory = constant_laws(scene) and lost is None and linear.is_even(scene)
    if theory:
        predicted = ByTheory(scene)
        options = _by_theory(scene, numerics, predicted)
    else:
        predicted = ByRuns(scene, tolerance)
        options = _by_runs(scene, numerics, predicted, lost)
    if not options:
        _refuse(scene, numerics)
    chosen, error, tried = _cheapest(options, tolerance)
    return Plan(
        chosen.model,
        chosen.numerics,
        *error,
        chosen.cost,
        tolerance,
        _reason(predicted, chosen, error, tolerance, lost, tried),
        clock.perf_counter() - begin,
    )


def _cheapest(options: list[Option], tolerance: float):
    """The first, by cost, whose error is small enough, or the one of least error; its error; the others' by model."""
    tried: dict = {}
    known: list = []
    options = sorted(options, key=lambda option: option.cost)
    for option in options:
        if option.cost > max(LONG, 10 * options[0].cost):
            break
        if tried.get(option.model, (0, 0))[1] > SAFE * tolerance:
            continue  # the error that is the model's own stays however fine
        try:
            error = option.error()
        except (SceneError, StabilityError):
            continue
        if not error[0] >= tried.get(option.model, (np.inf,))[0]:
            tried[option.model] = error
        known.append((option, error))
        if error[0] <= SAFE * tolerance:
            return option, error, tried
    least = min((error[0] for _, error in known), default=np.inf)
    if not np.isfinite(least):
        return next((option for option in options if option.model == "cars"), options[0]), (np.inf, 0.0), tried
    return *next((option, error) for option, error in known if error[0] <= NEARLY * least), tried


def _usable(scene, name: str, given: dict, *trials: dict) -> list[dict]:
    """The numerics of a model, what is given kept, that it takes for this scene; without repeats."""
    found: list[dict] = []
    for trial in trials:
        try:
            numerics = model(name).numerics(scene, {**trial, **given})
        except (SceneError, StabilityError):
            continue
        if numerics not in found:
            found.append(numerics)
    return found


def _cars(scene, given, holds) -> list[dict]:
    headways = whole_headways(scene)
    intervals = [n for n in INTERVALS if headways % n == 0]
    trials = [
        {"nodes": rows * scene.fleet.count, "hold": hold, "relax_every": n}
        for rows in ROWS
        for hold in holds
        for n in intervals
    ]
    return _usable(scene, "cars", given, *trials)


def _by_theory(scene, given, theory: ByTheory) -> list[Option]:
    count = scene.fleet.count
    options = []
    for numerics in _usable(scene, "linear", given, *({"nodes": rows * count} for rows in ROWS)):
        rows = numerics["nodes"] // count
        cost = costs.of_linear(scene, numerics, theory.folded)
        options.append(Option("linear", numerics, cost, lambda rows=rows: (theory.linear(rows), 0.0)))
    for numerics in _usable(scene, "continuum", given, {"nodes": max(16, 2 * theory.highest + 2)}):
        cost = costs.of_continuum(scene, numerics, theory.surely_linear)
        options.append(Option("continuum", numerics, cost, lambda: (theory.continuum, theory.continuum)))
    for numerics in _cars(scene, given, (3,)):
        if numerics["nodes"] % count == 0:
            cost = costs.of_cars(scene, numerics)
            options.append(Option("cars", numerics, cost, lambda numerics=numerics: (theory.cars(numerics), 0.0)))
    return options


def _by_runs(scene, given, runs: ByRuns, lost) -> list[Option]:
    options = []
    for numerics in _cars(scene, given, (3,)):
        cost = costs.of_cars(scene, numerics)
        options.append(Option("cars", numerics, cost, lambda numerics=numerics: (runs.cars(numerics), 0.0)))
    if constant_laws(scene) and lost is None:
        for numerics in _usable(scene, "linear", given, {}):
            cost = costs.of_linear(scene, numerics, runs.waves)
            options.append(Option("linear", numerics, cost, lambda n=numerics: (runs.other("linear", n),) * 2))
        return options  # the continuum would be the same
    for numerics in _usable(scene, "continuum", given, *({"step": step} for step in STEPS)):
        cost = costs.of_continuum(scene, numerics, False)
        options.append(Option("continuum", numerics, cost, lambda n=numerics: runs.continuum(n)))
    return options


def _refuse(scene, given) -> None:
    """No model takes what is given: the error of the one that takes these keywords."""
    name = "continuum" if "step" in given else "cars"
    model(name).numerics(scene, given)
    raise SceneError(f"{', '.join(given)}: no model takes these for this scene; name the model")


def _reason(predicted, chosen, error, tolerance, lost, tried) -> str:
    lines = [f"by {predicted.words}"]
    if lost is not None:
        lines.append(f"cars take off at about time {lost:.3g}, by the growth of small waves")
    for name, (least, own) in tried.items():
        if name != chosen.model and least > SAFE * tolerance:
            lines.append(f"{name} would be off by {least:.1e}" + (", whatever its resolution" if own else ""))
    if not np.isfinite(error[0]):
        lines.append("nothing can be predicted: the road runs away")
    elif error[0] > SAFE * tolerance:
        lines.append(f"nothing that was tried is surely within {tolerance:g}: this is the nearest")
    return "; ".join(lines)
