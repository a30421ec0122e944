"""The plan: what it chooses, whether its errors are true, what it is told to keep."""

import json
from dataclasses import replace

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.estimate import corrugation_difference
from traffic_road.models import cars
from traffic_road.outlook import piece, takes_off
from traffic_road.predict_runs import ByRuns

K = 0.9


def scene(
    *, amplitude=1e-2, softness=0.006, diffusivity=0.01, headways=160, waves=1, lift_off=True, profile=None, **fleet
):
    road = tr.Road(2 * np.pi / K * waves, softness, diffusivity, profile or tr.Sine(amplitude, K))
    whole = tr.Scene(road, tr.Fleet(**{"count": 8, "damping": 0.1, **fleet}), 1.0, lift_off)
    return replace(whole, duration=headways * whole.headway_time)


def truth(case, rows=128):
    """The discrete scene: cars on a fine grid and one half as fine, the error of order 1 taken off for even fleets."""
    count = case.fleet.count
    roads = []
    for nodes in (rows * count // 2, rows * count):
        *_, last = cars.samples(case, np.array([0.0, case.duration]), cars.numerics(case, {"nodes": nodes, "hold": 5}))
        roads.append(last.road_height)
    uneven = case.fleet.position is not None or isinstance(case.fleet.speed, tuple)
    return roads[1] if uneven else 2 * roads[1][::2] - roads[0]


CASES = {
    "small waves": (scene(), 1e-4, "linear"),
    "small waves, loosely": (scene(), 3e-2, "continuum"),
    "noise": (scene(waves=4, count=32, profile=tr.Noise(1e-2, 1.8, seed=2)), 1e-3, "cars"),
    "noise, more exactly": (scene(waves=4, count=32, profile=tr.Noise(1e-2, 1.8, seed=2)), 3e-4, "linear"),
    "many cars a wave": (scene(count=40, headways=800), 3e-3, "continuum"),
    "bouncing": (scene(amplitude=1.5), 1e-3, None),
    "bouncing, exactly": (scene(amplitude=1.5), 1e-4, "cars"),
    "hardening": (scene(softness=tr.Exponential(0.006, 0.3), amplitude=0.1), 1e-3, None),
    "bounded": (scene(softness=tr.Bounded(0.006, 8.0), amplitude=0.5), 3e-4, None),
    "uneven": (scene(count=6, position=(0, 1, 1.3, 3, 4, 6), amplitude=0.3), 1e-2, "cars"),
    "speeds": (scene(count=5, speed=(1, 1.1, 0.8, 1, 1.3), amplitude=0.3, headways=80), 3e-2, "cars"),
}


@pytest.mark.parametrize("name", CASES)
def test_auto_keeps_the_tolerance_and_knows_its_error(name):
    case, tolerance, model = CASES[name]
    planned = tr.plan(case, tolerance)
    ds = tr.simulate(case, tolerance=tolerance, samples=2)
    assert ds.attrs["model"] == planned.model and model in (None, planned.model)
    assert float(ds.time[-1]) == pytest.approx(case.duration, rel=1e-9)
    reference = truth(case)
    error = corrugation_difference(reference, ds.road_height.values[-1])
    assert error <= ds.error_estimate <= tolerance
    # too cautious by less than 10; a road that is better by far than it need be at the coarsest grid there is may be
    assert ds.error_estimate <= 10 * error and planned.error <= 10 * error
    assert ds.attrs["model_error"] == planned.model_error and ds.attrs["plan"] == planned.reason


@pytest.mark.parametrize("headways", [4.11, 40.5, 0.3])
@pytest.mark.parametrize("samples", [5, [0.0, 0.01, "end"]])
def test_auto_ends_where_the_road_of_evenly_spaced_cars_is_known(headways, samples):
    """Between whole headways it is a sawtooth that no smooth model has: a hundred times the error told, once."""
    case = scene(count=40, headways=headways)
    whole = replace(case, duration=max(1, round(headways)) * case.headway_time)
    times = samples if samples == 5 else [case.duration if t == "end" else t for t in samples]
    ds = tr.simulate(case, tolerance=3e-3, samples=times)
    assert ds.model in ("linear", "continuum") and float(ds.time[-1]) == pytest.approx(whole.duration, rel=1e-12)
    assert json.loads(ds.scene)["duration"] == float(ds.time[-1])
    error = corrugation_difference(truth(whole), ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 3e-3
    again = tr.rerun(ds)
    assert np.array_equal(again.time, ds.time) and np.array_equal(again.road_height, ds.road_height)


@pytest.mark.parametrize(
    ("headways", "tolerance", "fleet"),
    [
        (6, 2e-3, {"count": 4, "damping": 0.085, "mass": (0.76, 1.19, 1.05, 0.82), "amplitude": 1.09}),
        (26, 3e-2, {"count": 6, "damping": 0.35, "mass": (1.26, 0.76, 0.93, 1.13, 1.13, 1.0), "softness": 0.0013}),
        (1.6, 3e-2, {"count": 4, "damping": 0.23, "position": (0.48, 1.56, 3.12, 4.44), "amplitude": 0.17}),
    ],
)
def test_the_plans_runs_end_when_the_run_does(headways, tolerance, fleet):
    """Of any duration: a few headways before or after, errors are others; those told were down to a third."""
    case = scene(headways=headways, **{"softness": 0.002, "diffusivity": 0.0012, "amplitude": 0.028, **fleet})
    ds = tr.simulate(case, tolerance=tolerance, samples=2)
    error = corrugation_difference(truth(case), ds.road_height.values[-1])
    assert "plan" in ds.error_method
    assert error <= ds.error_estimate <= min(tolerance, 4 * error)


def test_a_finer_grid_for_a_smaller_tolerance_and_no_finer():
    tolerances = (1e-2, 1e-3, 1e-4, 1e-5)
    for case in (scene(count=4), scene(count=4, amplitude=1.5)):
        plans = [tr.plan(case, tolerance) for tolerance in tolerances]
        nodes = [p.numerics["nodes"] for p in plans]
        assert nodes == sorted(nodes) and nodes[-1] > nodes[0]
        assert all(p.error <= tolerance for p, tolerance in zip(plans, tolerances, strict=True))
        assert [p.cost for p in plans] == sorted(p.cost for p in plans)


def test_lift_off_is_charged_only_where_cars_take_off():
    small, large = scene(), scene(amplitude=1.5)
    assert tr.plan(small, 1e-3).numerics == tr.plan(replace(small, lift_off=False), 1e-3).numerics
    assert "theory" in tr.plan(small).reason and "no car takes off" in tr.plan(small).reason
    assert "cars take off at about time 0" in tr.plan(large).reason and "coarse runs" in tr.plan(large).reason
    assert tr.plan(replace(large, lift_off=False), 1e-3).model in ("linear", "continuum")


def test_lift_off_of_a_hardening_road_is_foreseen():
    hard = scene(softness=tr.Exponential(0.01, 0.05), amplitude=0.02, headways=800)
    lost = takes_off(hard)
    run = tr.simulate(hard, "continuum", samples=201)
    airborne = float(run.time[np.argmax((run.contact_force <= 0).any("x").values)])
    assert 0.9 * airborne < lost < 1.1 * airborne and airborne > 100  # harmonics arise, the cars' transient is left out
    assert (
        f"cars take off at about time {lost:.3g}, by the growth of small waves on the settling road"
        in tr.plan(hard).reason
    )
    harder = scene(softness=tr.Exponential(0.01, 0.5), amplitude=0.02, headways=800)
    assert takes_off(harder) is None
    assert tr.simulate(harder, "continuum", samples=201).contact_force.min() > 0
    assert "no car takes off" in tr.plan(harder).reason


def test_a_loose_continuum_says_what_of_its_error_is_the_models_own():
    planned = tr.plan(scene(count=40, headways=800), 3e-3)
    assert planned.model == "continuum" and planned.model_error > 0.5 * planned.error > 0
    own = tr.simulate(scene(count=40, headways=800), "continuum", samples=2)
    assert "model_error" not in own.attrs and own.error_estimate < planned.model_error / 100


def test_what_is_given_is_kept():
    case = scene(amplitude=1.5)
    for given, model in (
        ({"nodes": 96}, None),
        ({"hold": 1}, "cars"),
        ({"relax_every": 3, "nodes": 72}, "cars"),
        ({"step": 0.3}, "continuum"),
        ({"step": 0.3, "nodes": 40}, "continuum"),
    ):
        planned = tr.plan(case, 1e-3, **given)
        assert planned.numerics | given == planned.numerics and model in (None, planned.model)
        ds = tr.simulate(case, tolerance=1e-3, samples=2, **given)
        assert ds.attrs["model"] == planned.model
    with pytest.raises(tr.SceneError, match="speling: not a parameter of any model"):
        tr.plan(case, speling=3)
    with pytest.raises(tr.TrafficRoadError, match="hold"):
        tr.plan(case, hold=3, step=0.1)
    with pytest.raises(tr.TrafficRoadError, match="nodes = 2"):
        tr.plan(case, nodes=2)


def test_where_nothing_will_do_it_says_so():
    hopeless = tr.plan(scene(count=5, speed=(1, 1.1, 0.8, 1, 1.3), amplitude=0.01, headways=40), 1e-9)
    assert hopeless.error > 1e-9 and "this is the nearest" in hopeless.reason
    wild = scene(softness=0.5, amplitude=1.0, lift_off=False, headways=4000)
    assert not tr.plan(wild).error <= 1e-3 and "the road runs away" in tr.plan(wild).reason
    with pytest.warns(UserWarning, match="tolerance = 1e-12: not met"):
        tr.simulate(scene(headways=12), samples=2, tolerance=1e-12)


def test_a_piece_stands_for_a_long_road():
    one = scene(amplitude=1.5)
    four = scene(amplitude=1.5, waves=4, count=32)
    assert piece(four).fleet.count == 8 and piece(one) is one
    of_four, of_one = (tr.plan(case, 1e-3, hold=5).numerics["nodes"] for case in (four, one))  # of cars, both
    assert of_four == 4 * of_one
    noisy = scene(waves=40, count=320, profile=tr.Noise(0.5, 1.8, seed=2))
    assert 48 <= piece(noisy).fleet.count <= 96
    different = replace(four, fleet=replace(four.fleet, damping=tuple(np.linspace(0.1, 0.2, 32))))
    assert piece(different) is different
    # periodic: the error of the piece is that of the whole
    wanted = truth(four, 64)
    for numerics in ({"nodes": 256, "hold": 3, "relax_every": 1}, {"nodes": 512, "hold": 3, "relax_every": 2}):
        whole = cars.numerics(four, numerics)
        *_, last = cars.samples(four, np.array([0.0, four.duration]), whole)
        error = corrugation_difference(wanted, last.road_height)
        assert error <= ByRuns(four, 1e-3).cars(numerics).error <= 10 * error


def test_print_explains():
    text = str(tr.plan(scene(), 1e-4))
    lines = text.splitlines()
    assert len(lines) == 4 and lines[0].startswith("linear: nodes ")
    assert "predicted error" in lines[1] and "tolerance 0.0001" in lines[1] and "predicted cost" in lines[2]


@pytest.mark.parametrize("arguments", [("paper",), (scene(), 0), (scene(), float("nan"))])
def test_bad_arguments_are_one_line(arguments):
    with pytest.raises(tr.SceneError) as error:
        tr.plan(*arguments)
    assert "\n" not in str(error.value)
