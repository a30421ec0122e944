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
from .models import MODELS, continuum, linear, model
from .models.continuum_state import linear_throughout
from .outlook import constant_laws, matrices, takes_off, whole_headways
from .predict import ByTheory, Predicted
from .predict_runs import ByRuns
from .scene import Scene

ROWS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 1024, 2048)  # nodes a headway that are tried
HOLD = 5  # costs little more than linear and is better on the coarsest grids; on fine ones wheels' steps are what errs
INTERVALS = (4, 2, 1)  # headways from one relaxation to the next; only divisors of the duration
STEPS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25)  # times the continuum's default, where it needs any
SAFE = 0.8  # of the tolerance: predicted errors are right to about so much
LONG = 20.0  # seconds beyond which no tolerance is worth a finer grid, unless the coarsest takes as long
NEARLY = 2.0  # times the least error: where no resolution will do, the cheapest that is nearly as good
KEYWORDS = ("nodes", "hold", "relax_every", "step")


@dataclass(frozen=True)
class Plan:
    """A model and its numerics for a scene; `print` it for the reasons.

    error: predicted relative error of the corrugation at the end (L2, mean removed) against the discrete scene itself,
    cars on a fine grid; model_error: the part of it that no resolution removes. cost: predicted seconds of one core for the
    run alone. pair_ratio: by how many times its error the run will differ from one at half the resolution, if that is
    known. planning_time: seconds that the plan has taken.
    """

    model: str
    numerics: dict
    error: float
    model_error: float
    pair_ratio: float | None
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
    """One way to run a scene: `error()` gives a Predicted, at a cost of its own."""

    model: str
    numerics: dict
    cost: float
    error: Callable


def plan(scene, tolerance: float = 1e-3, **numerics) -> Plan:
    """The cheapest of linear, continuum and cars, and of their resolutions, predicted to meet `tolerance`.

    tolerance: relative error of the corrugation (L2 over the road, mean removed) at the end, against the discrete scene:
    cars on a fine grid, the road relaxed every headway; evenly spaced ones after a whole number of headways.
    numerics: nodes, hold, relax_every, step, to be kept as given.
    Where nothing that was tried will do, the cheapest that is nearly as good as the best, and `reason` says so.
    Planning takes at most costs.FREE, thrice (to look when cars take off, to ask linear theory, to make runs of its own), and
    costs.TIMES the cost of the run that it plans, all as predicted, which is right within two or so; `reason` says what was
    left out for that.
    SceneError, StabilityError: a scene or numerics that no model can run.
    """
    begin = clock.perf_counter()
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; preset(name) and Scene.from_toml(path) give one")
    tolerance = finite("tolerance", tolerance, above=0)
    for name in sorted(set(numerics) - set(KEYWORDS)):
        raise SceneError(f"{name}: not a parameter of any model; they take {', '.join(KEYWORDS)}")
    models = _that_take(scene, numerics)
    purse, left_out = costs.Purse(), []
    looked = costs.of_outlook(scene, matrices(scene)) <= costs.FREE
    if not looked:
        left_out.append("when cars take off")
    lost = takes_off(scene) if looked else None
    pressed, theory = looked and lost is None, None
    if constant_laws(scene) and pressed and linear.is_even(scene):
        theory = ByTheory(scene, tolerance)
    if theory and theory.cost(ROWS, INTERVALS) > costs.FREE:
        theory = None
        left_out.append("linear theory")
    if theory:
        predicted, options = theory, _by_theory(scene, models, numerics, theory)
    else:
        predicted = ByRuns(scene, tolerance, numerics.get("hold", HOLD), purse)
        options = _by_runs(scene, models, numerics, predicted, pressed)
    chosen, error, tried, dear = _cheapest(scene, options, tolerance, purse)
    left_out += dear
    return Plan(
        chosen.model,
        model(chosen.model).numerics(scene, chosen.numerics),
        *error,
        chosen.cost,
        tolerance,
        _reason(scene, predicted, chosen, error, tolerance, lost, tried, looked, left_out),
        clock.perf_counter() - begin,
    )


def _that_take(scene, given: dict) -> set[str]:
    """The models that take what is given, with the rest at its default; the error of the one that comes nearest if none."""
    found = set()
    for name in MODELS:
        try:
            model(name).numerics(scene, given)
        except (SceneError, StabilityError):
            if given:
                continue
        found.add(name)
    if not found:
        model("continuum" if "step" in given else "cars").numerics(scene, given)
    return found


def _cheapest(scene, options: list[Option], tolerance: float, purse: costs.Purse):
    """The first, by cost, whose error is small enough, or the one of least error; its error; the others' by model.

    And the models some of whose runs were left out: to know their errors would have cost more than `purse` allows, which is
    measured by what would be chosen so far; where all errors so far are infinite, by the first that was asked for, or dearer
    and dearer runs would be tried on a road that runs away.
    """
    tried: dict = {}
    known: list = []
    dear: list = []
    options = sorted(options, key=lambda option: option.cost)
    for option in options:
        if option.cost > max(LONG, 10 * options[0].cost):
            break
        if tried.get(option.model, (0, 0))[1] > SAFE * tolerance:
            continue  # the error that is the model's own stays however fine
        try:
            model(option.model).numerics(scene, option.numerics)
            measure, _ = _nearest(known) or (known[0] if known else (option, None))
            purse.allowed = costs.FREE + costs.TIMES * measure.cost
            error = option.error()
        except costs.TooDear:
            if option.model not in dear:
                dear.append(option.model)
            continue
        except (SceneError, StabilityError):
            continue
        if not error[0] >= tried.get(option.model, (np.inf,))[0]:
            tried[option.model] = error
        known.append((option, error))
        if error[0] <= SAFE * tolerance:
            return option, error, tried, dear
    if nearest := _nearest(known):
        return *nearest, tried, dear
    rest = sorted((option.model != "cars", n) for n, option in enumerate(options))
    least = options[rest[0][1]]
    return least, Predicted(np.inf, 0.0 if least.model == "cars" else np.inf), tried, dear


def _nearest(known: list) -> tuple | None:
    """The first that is nearly as good as the best, None if none is of any use."""
    least = min((error[0] for _, error in known), default=np.inf)
    return next(((o, e) for o, e in known if e[0] <= NEARLY * least), None) if np.isfinite(least) else None


def _options(name: str, models: set, trials: list[dict], given: dict, cost: Callable, error: Callable) -> list[Option]:
    """Of the trials of a model, what is given kept, without repeats; none if it is not one of `models`."""
    kept: list[dict] = []
    for trial in trials if name in models else []:
        numerics = {**trial, **given}
        if numerics not in kept:
            kept.append(numerics)
    return [Option(name, numerics, cost(numerics), lambda numerics=numerics: error(numerics)) for numerics in kept]


def _cars(scene) -> list[dict]:
    headways = whole_headways(scene)
    return [
        {"nodes": rows * scene.fleet.count, "hold": HOLD, "relax_every": n}
        for rows in ROWS
        for n in INTERVALS
        if headways % n == 0
    ]


def _by_theory(scene, models, given, theory: ByTheory) -> list[Option]:
    count = scene.fleet.count
    rows = [rows for rows in ROWS if theory.least <= rows <= linear.MOST_ROWS]
    step = STEPS[0] * continuum.default_step(scene)
    return [
        *_options(
            "linear", models, [{"nodes": n * count} for n in rows], given,
            lambda numerics: costs.of_linear(scene, numerics, theory.folded, True),
            lambda numerics: Predicted(theory.linear(numerics["nodes"] // count)),
        ),
        *_options(
            "continuum", models, [{"nodes": max(16, 2 * theory.highest + 2), "step": step}], given,
            lambda numerics: costs.of_continuum(scene, numerics, linear_throughout(scene, numerics["nodes"], scene.duration)),
            lambda numerics: Predicted(theory.continuum, theory.continuum),
        ),
        *_options(
            "cars", models, _cars(scene), given,
            lambda numerics: costs.of_cars(scene, numerics, numerics["nodes"] % count == 0),
            lambda numerics: Predicted(theory.cars(numerics)),
        ),
    ]  # fmt: skip


def _by_runs(scene, models, given, runs: ByRuns, pressed: bool) -> list[Option]:
    """pressed: it is known that no car takes off."""
    options = _options(
        "cars", models, _cars(scene), given,
        lambda numerics: costs.of_cars(scene, numerics, runs.even and numerics["nodes"] % scene.fleet.count == 0),
        runs.cars,
    )  # fmt: skip
    # the continuum would be the same, but for an even fleet, whose matrices are what is too dear
    if constant_laws(scene) and pressed and not runs.even and "linear" in models:
        return options + _options(
            "linear", models, [linear.numerics(scene, {})], given,
            lambda numerics: costs.of_linear(scene, numerics, runs.waves, False),
            lambda numerics: Predicted(*[runs.other("linear", numerics)] * 2),
        )  # fmt: skip
    if "continuum" not in models:
        return options
    try:
        usual = continuum.numerics(scene, {})
    except (SceneError, StabilityError):  # too many kinds of car, a road too soft
        return options
    grids = [usual["nodes"]]
    while grids[-1] % 2 == 0 and grids[-1] // 2 >= runs.least_continuum:
        grids.append(grids[-1] // 2)
    if grids[-1] > runs.least_continuum:
        grids.append(runs.least_continuum)
    return options + _options(
        "continuum", models, [{"nodes": n, "step": part * usual["step"]} for n in sorted(grids) for part in STEPS], given,
        lambda numerics: costs.of_continuum(scene, numerics, False),
        runs.continuum,
    )  # fmt: skip


def _reason(scene, predicted, chosen, error, tolerance, lost, tried, looked, left_out) -> str:
    lines = [f"by {predicted.words}"]
    growth = "small waves" if constant_laws(scene) else "small waves on the settling road"
    if lost is not None:
        lines.append(f"cars take off at about time {lost:.3g}, by the growth of {growth}")
    elif scene.lift_off and looked and isinstance(predicted, ByRuns):
        lines.append(f"no car takes off, by the growth of {growth}")
    for name, (least, own, _) in tried.items():
        if name != chosen.model and least > SAFE * tolerance:
            lines.append(f"{name} would be off by {least:.1e}" + (", whatever its resolution" if own else ""))
    if left_out:
        lines.append(
            f"left out, since it would make planning longer than {costs.FREE:g} s and {costs.TIMES:g} times the run: "
            f"{', '.join(left_out)} (to have a model all the same, name it and its nodes)"
        )
    if not np.isfinite(error[0]):
        away = isinstance(predicted, ByRuns) and predicted.runs_away
        unknown = "no error could be predicted: name the model and its nodes, and see what its run estimates"
        lines.append("nothing can be predicted: the road runs away" if away or not left_out else unknown)
    elif error[0] > SAFE * tolerance:
        lines.append(f"nothing that was tried is surely within {tolerance:g}: this is the nearest")
    return "; ".join(lines)
