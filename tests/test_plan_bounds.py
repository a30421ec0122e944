"""Where a plan's errors were once told too small, and how long planning may take."""

import numpy as np
import pytest

import traffic_road as tr
from traffic_road import costs, planning
from traffic_road.estimate import corrugation_difference
from traffic_road.models import cars, model
from traffic_road.predict import ByTheory
from traffic_road.predict_runs import ByRuns

K = 0.9


def scene(headways, *, count=8, waves=1, softness=0.006, diffusivity=0.01, profile=None, damping=0.2, speed=1.0):
    length = 2 * np.pi / K * waves
    road = tr.Road(length, softness, diffusivity, profile or tr.Sine(1e-3, K))
    return tr.Scene(road, tr.Fleet(count, damping=damping, speed=speed), headways * length / count)


def road(case, rows, hold=5, relax_every=1):
    numerics = {"nodes": rows * case.fleet.count, "hold": hold, "relax_every": relax_every}
    *_, last = cars.samples(case, np.array([0.0, case.duration]), cars.numerics(case, numerics))
    return last.road_height


STEPS = scene(64, diffusivity=0.0)  # passages leave steps, and nothing smooths them


@pytest.mark.parametrize(
    "name, rows", [("linear", 8), ("linear", 64), ("linear", 200), ("cars", 16), ("cars", 200), ("cars", 512)]
)
@pytest.mark.parametrize("diffusivity", [0.0, 1e-8])
def test_a_run_knows_its_error_where_steps_stay(name, rows, diffusivity):
    case = scene(64, diffusivity=diffusivity)  # too little to smooth the waves of such grids
    ds = tr.simulate(case, name, samples=2, nodes=rows * 8)
    error = corrugation_difference(road(case, 8192), ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 6 * error


def test_where_steps_stay_order_one_half_is_planned_for_and_no_huge_matrix():
    truth, theory = road(STEPS, 8192), ByTheory(STEPS, 1e-2)
    for rows in (8, 32, 128):
        for predicted, name in ((theory.linear(rows), "linear"), (theory.cars(_numerics(rows)), "cars")):
            *_, last = model(name).samples(STEPS, np.array([0.0, STEPS.duration]), _of(name, rows))
            error = corrugation_difference(truth, last.road_height)
            assert error <= predicted <= 4 * error, (rows, name)
    ds = tr.simulate(STEPS, tolerance=8e-2, samples=2)
    assert corrugation_difference(truth, ds.road_height.values[-1]) <= ds.error_estimate <= 8e-2
    assert tr.plan(STEPS, 8e-2).cost < 0.01


def _numerics(rows):
    return {"nodes": rows * 8, "hold": 5, "relax_every": 1}


def _of(model, rows):
    return {"nodes": rows * 8} if model == "linear" else _numerics(rows)


@pytest.mark.parametrize("case, tolerance", [
    (scene(30, count=21, waves=3, diffusivity=0.0015, profile=tr.Noise(0.77, 1.35, seed=177), damping=0.32), 3e-5),
    (scene(60, count=20, waves=4, softness=tr.Exponential(0.005, 0.13), diffusivity=tr.Exponential(0.003, 0.13),
           profile=tr.Noise(0.08, 1.14, seed=896), damping=0.37), 2e-3),
])  # fmt: skip
def test_the_order_of_coarse_grids_is_not_that_of_fine_ones(case, tolerance):
    truth = 2 * road(case, 256)[::2] - road(case, 128)
    runs = ByRuns(case, tolerance)
    for rows in (4, 8, 16, 32):
        for every in (1, 2):
            numerics = {"nodes": rows * case.fleet.count, "hold": 5, "relax_every": every}
            error = corrugation_difference(truth, road(case, rows, relax_every=every))
            assert error <= runs.cars(numerics).error <= 2 * error, (rows, every)
    ds = tr.simulate(case, tolerance=tolerance, samples=2)
    assert corrugation_difference(truth, ds.road_height.values[-1]) <= ds.error_estimate <= tolerance


MANY = tuple(np.random.default_rng(3).uniform(0.8, 1.2, 400))
DEAR = {
    "even": scene(200, count=24, waves=3, profile=tr.Noise(1e-3, 1.35, seed=1)),
    "bouncing": scene(200, count=24, waves=3, profile=tr.Noise(1.0, 1.35, seed=1)),
    "hardening": scene(100, count=8, softness=tr.Exponential(0.006, 0.1)),
    "uneven": scene(100, count=12, waves=2, speed=tuple(np.linspace(0.9, 1.1, 12))),
}


@pytest.mark.parametrize("name", DEAR)
@pytest.mark.parametrize("tolerance", [1e-1, 1e-6])
def test_planning_spends_no_more_than_it_may(name, tolerance, monkeypatch):
    purses = []
    monkeypatch.setattr(costs, "FREE", 1e-4)
    monkeypatch.setattr(costs, "TIMES", 2.0)
    monkeypatch.setattr(costs.Purse, "__init__", lambda self, allowed=0.0: (purses.append(self), setattr(self, "spent", 0.0),
                                                                            setattr(self, "allowed", allowed))[0])  # fmt: skip
    planned = tr.plan(DEAR[name], tolerance)
    assert purses[0].spent <= 1e-4 + 2 * planned.cost
    assert "would make planning longer than 0.0001 s and 2 times the run" in planned.reason


def test_many_kinds_of_car_are_planned_for_at_once(monkeypatch):
    case = scene(40, count=400, waves=30, speed=MANY, profile=tr.Noise(0.05, 1.35, seed=1))
    monkeypatch.setattr(planning, "takes_off", lambda scene: pytest.fail("looks for minutes"))
    planned = tr.plan(case, 1e-2)
    assert planned.model == "cars" and np.isfinite(planned.error)
    assert "longer than 1 s and 5 times the run: when cars take off" in planned.reason
    assert "no car takes off" not in planned.reason


def test_what_linear_theory_would_cost_too_much_for_runs_tell(monkeypatch):
    case = DEAR["even"]
    assert "linear theory: evenly spaced" in tr.plan(case, 1e-3).reason
    monkeypatch.setattr(costs, "FREE", 0.05 * ByTheory(case, 1e-3).cost(planning.ROWS, planning.INTERVALS))
    planned = tr.plan(case, 1e-3)
    assert "coarse runs of cars" in planned.reason and "linear theory" in planned.reason
    truth = 2 * road(case, 128)[::2] - road(case, 64)
    *_, last = model(planned.model).samples(case, np.array([0.0, case.duration]), planned.numerics)
    assert corrugation_difference(truth, last.road_height) <= planned.error <= 1e-3


def test_an_error_that_planning_may_not_look_for_is_not_told(monkeypatch):
    monkeypatch.setattr(costs, "FREE", 0.0)
    monkeypatch.setattr(costs, "TIMES", 0.01)
    planned = tr.plan(DEAR["bouncing"], 1e-2, step=4.0)
    assert planned.model == "continuum" and planned.error == np.inf
    assert "no error could be predicted: name the model" in planned.reason
    assert tr.simulate(DEAR["bouncing"], tolerance=1e-2, samples=2, step=4.0).error_estimate == np.inf


@pytest.mark.parametrize("softness", [0.006, tr.Exponential(0.02, 0.1)], ids=["bouncing", "hardening"])
def test_a_plan_by_runs_is_made_for_the_hold_that_is_given(softness):
    case = scene(240, softness=softness, profile=tr.Sine(1.5 if softness == 0.006 else 0.1, K), damping=0.1)
    truth = 2 * road(case, 256)[::2] - road(case, 128)
    ds = tr.simulate(case, tolerance=1e-3, samples=2, hold=1)
    assert corrugation_difference(truth, ds.road_height.values[-1]) <= ds.error_estimate <= 1e-3


def test_a_run_is_not_surer_than_its_plan():
    # one car a wavelength: half the nodes and twice the relaxation interval happen to err as much
    case = scene(290, count=1, softness=tr.Exponential(0.006, 0.02), damping=0.1)
    planned, ds = tr.plan(case, 0.05), tr.simulate(case, tolerance=0.05, samples=2)
    error = corrugation_difference(road(case, 2048), ds.road_height.values[-1])
    assert error <= ds.error_estimate == planned.error <= 3 * error
    assert "the plan's runs" in ds.error_method


def test_a_road_that_runs_away_is_not_planned_for_at_length(monkeypatch):
    case = scene(20_000, softness=0.05, profile=tr.Sine(1.5, K), damping=0.1)
    purses, make = [], costs.Purse.__init__
    monkeypatch.setattr(costs.Purse, "__init__", lambda self, *given: (purses.append(self), make(self, *given))[1])
    planned = tr.plan(case)
    assert planned.error == np.inf and "the road runs away" in planned.reason
    assert purses[0].spent <= costs.FREE + costs.TIMES * planned.cost
