"""simulate(): resolution, error estimates, divergence, progress."""

import json
from dataclasses import replace

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.estimate import corrugation_difference
from traffic_road.models import cars, continuum
from traffic_road.theory import dispersion_roots

K = 0.9


def scene(*, amplitude=1e-3, softness=0.006, diffusivity=0.01, duration=150.0, lift_off=True, length=1, **fleet):
    road = tr.Road(2 * np.pi / K * length, softness, diffusivity, tr.Sine(amplitude, K))
    return tr.Scene(road, tr.Fleet(**{"count": 8, "damping": 0.1, **fleet}), duration, lift_off)


CASES = {
    "linear": (scene(), {"nodes": 64, "hold": 3}),
    "linear hold": (scene(), {"nodes": 64, "hold": 1}),
    "no diffusion": (scene(diffusivity=0.0), {"nodes": 64, "hold": 5}),
    "rare relaxation": (scene(count=16), {"nodes": 128, "hold": 3, "relax_every": 4}),
    "linear theory beyond lift-off": (scene(amplitude=3.0, lift_off=False), {"nodes": 64, "hold": 3}),
    "bouncing": (scene(amplitude=1.5), {"nodes": 64, "hold": 3}),
    "bouncing, rare relaxation": (scene(amplitude=1.5, count=16), {"nodes": 128, "hold": 3, "relax_every": 4}),
    "hardening": (scene(softness=tr.Exponential(0.006, 0.3)), {"nodes": 64, "hold": 3}),
    "mixed speeds": (scene(count=5, speed=(1, 1.1, 0.8, 1, 1.3), duration=60.0), {"nodes": 60, "hold": 3}),
    "uneven": (scene(count=6, position=(0, 1, 1.3, 3, 4, 6)), {"nodes": 96, "hold": 3}),
    "noise": (
        replace(
            scene(count=32, length=4),
            road=tr.Road(8 * np.pi / K, 0.006, 0.01, tr.Noise(1e-3, 2.0, seed=3)),
        ),
        {"nodes": 256, "hold": 3},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_error_estimate_of_cars_is_true(name):
    case, numerics = CASES[name]
    ds = tr.simulate(case, "cars", samples=2, **numerics)
    fine = cars.numerics(case, {"nodes": 8 * numerics["nodes"], "hold": 5})
    *_, reference = cars.samples(case, np.array([0.0, float(ds.time[-1])]), fine)
    error = corrugation_difference(reference.road_height, ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 10 * error


NOISE = replace(
    scene(),
    road=tr.Road(10 * np.pi / K, tr.Exponential(0.006, 0.3), 0.01, tr.Noise(0.7, 1.2 * K, seed=3)),
)


@pytest.mark.parametrize(
    ("case", "given"),
    [
        (scene(amplitude=1.5, softness=0.005), {}),
        (scene(amplitude=0.3, softness=tr.Exponential(0.006, 0.3)), {"step": 2.0}),
        (
            scene(amplitude=0.3, softness=tr.Exponential(0.006, 0.3), diffusivity=tr.Exponential(0.01, 0.3)),
            {"step": 2.0},
        ),
        (NOISE, {"nodes": 13, "step": 0.5}),  # what the profile needs: half of them could not be run
        (NOISE, {"nodes": 16, "step": 0.5}),
        # only every fourth wave of the ring exists: 16 nodes hold no more of these than 9 do
        (scene(amplitude=1.0, length=4, count=32, duration=60.0), {"nodes": 16, "step": 0.5}),
        (scene(amplitude=1.0, length=4, count=32, duration=60.0), {"nodes": 17, "step": 0.5}),
    ],
)
def test_error_estimate_of_the_continuum_is_true(case, given):
    ds = tr.simulate(case, "continuum", samples=2, tolerance=1.0, **given)
    fine = continuum.numerics(case, {"nodes": 256, "step": 0.05})
    *_, reference = continuum.samples(case, np.array([0.0, float(ds.time[-1])]), fine)
    error = corrugation_difference(reference.road_height, ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 30 * error  # order 4 makes a factor of 15 out of the pair's 3


def test_a_grid_too_coarse_for_the_waves_that_bouncing_cars_make_tells_so():
    # at frequency 10 cars answer to waves of 0.63, 11 on the ring; on 16 and 27 nodes a pair of runs sees too little of them
    case = scene(amplitude=1.5, duration=60.0, frequency=10.0)
    assert continuum.numerics(case, {}) == {"nodes": 45, "step": 0.05}
    calm = continuum.numerics(scene(amplitude=0.1, duration=60.0, frequency=10.0), {})
    assert calm == {"nodes": 32, "step": 0.05}  # exact on any grid
    *_, reference = continuum.samples(case, np.array([0.0, 60.0]), {"nodes": 127, "step": 0.02})
    for nodes in (16, 27, 28, 40):
        ds = tr.simulate(case, "continuum", 0.1, samples=2, nodes=nodes)
        error = corrugation_difference(reference.road_height, ds.road_height.values[-1])
        assert error > 1e-4 and error <= ds.error_estimate <= 30 * error


def test_given_times_say_how_long_a_run_is_to_its_limits_too():
    # cars stay on the road for a time of 1, but not of 5000
    case = scene(amplitude=0.1, softness=0.004, duration=1.0)
    with pytest.raises(tr.StabilityError, match="blows up from"):
        tr.simulate(case, "continuum", samples=[0.0, 5000.0], nodes=32, step=1000.0)
    ds = tr.simulate(case, "continuum", samples=[0.0, 5.0], nodes=32, step=5.0)
    assert tr.Scene.from_dict(json.loads(ds.scene)).duration == 1.0


def test_the_step_of_the_continuum_is_that_taken_from_sample_to_sample():
    case = scene(amplitude=1.5, softness=0.005, duration=50.0)
    asked, taken = (tr.simulate(case, "continuum", samples=101, nodes=32, step=step) for step in (7.3, 0.5))
    assert json.loads(asked.numerics) == json.loads(taken.numerics) == {"nodes": 32, "step": 0.5}
    assert asked.updates == taken.updates and asked.error_estimate == taken.error_estimate
    uneven = tr.simulate(case, "continuum", samples=[0.0, 0.9, 2.4], nodes=32, step=1.0)
    again = tr.rerun(uneven)
    # four steps of an eighth, until 0.45, two of a quarter, sample, two more until 1.35, three of a half at most
    assert json.loads(uneven.numerics)["step"] == pytest.approx(0.9) and uneven.updates == again.updates == 11 * 32
    assert np.array_equal(uneven.road_height, again.road_height)


@pytest.mark.parametrize("every", [10, 30])
@pytest.mark.parametrize("nodes", [768, 784])
def test_error_estimate_of_seldom_relaxation_is_true_on_fine_grids(nodes, every):
    # whatever the number of nodes a headway: beyond 96 the estimate of a linear run is made in another way
    ds = tr.simulate(scene(), "cars", samples=2, nodes=nodes, hold=3, relax_every=every)
    end = float(ds.time[-1])
    reference = tr.simulate(replace(scene(), duration=end), "cars", samples=2, nodes=784, hold=5)
    assert float(reference.time[-1]) == pytest.approx(end)
    error = corrugation_difference(reference.road_height.values[-1], ds.road_height.values[-1])
    assert error > 1e-3 and error <= ds.error_estimate <= 10 * error


@pytest.mark.parametrize(("headways", "every"), [(3, 2), (4, 4), (4, 6), (8, 6)])
def test_error_estimate_sees_a_relaxation_as_long_as_the_run(headways, every):
    # twice the interval would be the same run
    road = tr.Road(2 * np.pi / 0.12, 0.019, 0.0052, tr.Sine(0.5, 0.12))
    case = tr.Scene(road, tr.Fleet(2, 0.11, speed=(0.9, 1.15)), 1.0)
    case = replace(case, duration=headways * case.headway_time)
    ds, reference = (
        tr.simulate(case, "cars", samples=2, nodes=n, hold=5, relax_every=e) for n, e in ((1024, every), (4096, 1))
    )
    error = corrugation_difference(reference.road_height.values[-1], ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize("duration", [128.3, 161.0, 200.0])
@pytest.mark.parametrize("nodes", [192, 384, 768])
def test_error_estimate_of_evenly_spaced_cars_of_many_kinds_is_true(nodes, duration):
    # were they asked where they are between two nodes, half the nodes would often leave them in the same places
    damping = tuple(np.random.default_rng(1).uniform(0.1, 0.3, 12))
    road = tr.Road(4 * np.pi / 0.9, tr.Exponential(0.01, 0.3), 0.01, tr.Sine(0.2, 0.9))
    case = tr.Scene(road, tr.Fleet(12, damping), duration)
    ds, reference = (tr.simulate(case, "cars", samples=2, nodes=n, hold=5, relax_every=1) for n in (nodes, 16 * nodes))
    error = corrugation_difference(reference.road_height.values[-1], ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 1.3 * error


def test_default_resolution_is_refined_to_the_tolerance():
    loose, tight = (tr.simulate(scene(), samples=2, tolerance=t) for t in (1e-1, 1e-3))
    assert loose.error_estimate <= 1e-1 and tight.error_estimate <= 1e-3
    assert tight.x.size > loose.x.size
    with pytest.warns(UserWarning, match="tolerance = 1e-12: not met"):
        tr.simulate(scene(duration=10.0), samples=2, tolerance=1e-12)
    given = tr.simulate(scene(), samples=2, tolerance=1e-12, nodes=64)  # what is given is not changed, nor warned of
    assert given.x.size == 64


def test_a_flat_road_is_right_to_rounding():
    flat = replace(scene(), road=tr.Road(2 * np.pi / K, 0.006, 0.01))
    assert tr.simulate(flat, "continuum", samples=2).error_estimate == 0.0
    # cars leave their ripple; a grid that does not resolve it is wrong by much of it, and says so
    assert 0.01 < tr.simulate(flat, "cars", samples=2, nodes=64).error_estimate < 1.0


@pytest.mark.parametrize("count", [3, 8, 16])
def test_a_road_that_nothing_changes_is_right_to_rounding(count):
    # all waves of its grid have the rate 0, which the guess of it meets to the last bit
    rigid = tr.Scene(tr.Road(1.0, 0.0, 0.0, tr.Sine(1.0, 2 * np.pi)), tr.Fleet(count, 1.0), duration=3.0)
    ds = tr.simulate(rigid, "cars", samples=3)
    assert ds.error_estimate < 1e-14
    np.testing.assert_allclose(ds.road_height[-1], ds.road_height[0], rtol=0, atol=1e-15)


def test_times_are_those_at_which_samples_were_taken():
    even = tr.simulate(scene(), "cars", samples=21, nodes=64, relax_every=3)
    headway = 2 * np.pi / K / 8
    np.testing.assert_allclose(even.time / (3 * headway), np.rint(even.time / (3 * headway)), atol=1e-9)
    assert np.all(np.abs(even.time - np.linspace(0, 150, 21)) <= 1.5 * headway + 1e-9)
    np.testing.assert_array_equal(tr.simulate(scene(), "continuum", samples=21).time, np.linspace(0, 150, 21))
    # more samples than headways: each headway once
    assert tr.simulate(scene(duration=5.0), "cars", samples=101, nodes=64).time.size == 7


@pytest.mark.parametrize("model", ["cars", "continuum"])
def test_a_run_that_blows_up_keeps_what_it_has(model, tmp_path):
    wild = scene(softness=0.05, diffusivity=0.0, lift_off=False, duration=4000.0, amplitude=1.0)
    ds = tr.simulate(wild, model, samples=41, output=tmp_path / "wild.nc")
    assert ds.status.startswith("diverged between time ")
    assert 1 < ds.time.size < 41 and np.all(np.isfinite(ds.road_height)) and ds.error_estimate == float("inf")
    stored = tr.open(tmp_path / "wild.nc")
    assert stored.status == ds.status and stored.time.size == ds.time.size
    # just below the limit of what is kept: the wave has grown by its rate up to the last sample
    amplitude = tr.mode(ds, K).amplitude.values
    assert 1e6 < amplitude[-1] < 1e12


def test_samples_may_be_times():
    times = [0.0, 1.0, 10.0, 150.0]
    assert tr.simulate(scene(), "continuum", samples=times).time.values.tolist() == times
    with pytest.raises(tr.SceneError, match="increase"):
        tr.simulate(scene(), samples=[0.0, 2.0, 1.0])


def test_a_run_may_start_from_the_last_road_of_another():
    first = tr.simulate(scene(amplitude=1.5), "cars", samples=2, nodes=64)
    road = tr.Road(2 * np.pi / K, 0.006, 0.01, first.road_height.values[-1])  # short waves down to two nodes and all
    again = tr.simulate(replace(scene(), road=road), "cars", samples=2, nodes=64)
    np.testing.assert_array_equal(again.road_height[0], first.road_height[-1])
    assert 0 < again.error_estimate < 0.01 and "twice" in again.error_method


def test_more_work_than_can_be_done_is_refused_at_once():
    quick = scene(speed=(1.0,) * 7 + (1e15,))
    for case, arguments in ((quick, {}), (scene(), {"nodes": 10**10}), (scene(frequency=1e300), {})):
        with pytest.raises(tr.TrafficRoadError, match="nodes"):
            tr.simulate(case, "cars", **arguments)


def test_progress_is_called_to_the_end():
    seen = []
    tr.simulate(scene(), "cars", samples=11, nodes=64, progress=seen.append)
    assert seen == pytest.approx(np.arange(1, 12) / 11)


@pytest.mark.parametrize(
    "arguments",
    [
        {"model": "truck"},
        {"samples": 1},
        {"samples": 2.5},
        {"tolerance": 0},
        {"tolerance": float("nan")},
        {"model": "cars", "step": 0.5},
        {"model": "continuum", "hold": 3},
        {"output": "missing/folder/out.nc"},
        {"speling": 3},
    ],
)
def test_bad_arguments_are_one_line(arguments):
    with pytest.raises(tr.TrafficRoadError) as error:
        tr.simulate(scene(), **arguments)
    assert "\n" not in str(error.value)
    assert str(next(reversed(arguments.values()))) in str(error.value) or next(reversed(arguments)) in str(error.value)


# ---- a run without steps: its error is what rounding leaves, grown


@pytest.mark.parametrize("damping", [0.02, 0.1, 0.5])
@pytest.mark.parametrize(("k", "duration"), [(0.3, 400.0), (0.3, 3000.0), (1.0, 800.0), (1.7, 400.0), (1.7, 3000.0)])
def test_error_estimate_without_steps_is_true(k, duration, damping):
    # k = 0.3 has k = 0.9 on its ring, not in the profile, that grows from rounding, at the lower damping past the profile
    road = tr.Road(2 * np.pi / k, 0.006, 0.01, tr.Sine(1e-3, k, np.pi / 2))
    runs = []
    for time in duration + np.arange(8.0):  # one alone may be right by chance
        ds = tr.simulate(
            tr.Scene(road, tr.Fleet(1, damping), time, lift_off=False), "continuum", samples=2, tolerance=2.0
        )
        if "flat to rounding" in ds.error_method:
            assert np.ptp(ds.road_height.values[-1]) < 1e-12
            return
        assert "rounding" in ds.error_method
        runs.append((time, ds.road_height.values[-1], ds.error_estimate))
    # the wave by its three roots, in the numbers of most digits there are
    sigma = dispersion_roots(k, softness=0.006, diffusivity=0.01, damping=damping).astype(np.clongdouble)
    ik = np.clongdouble(1j) * (2 * np.longdouble(np.pi) / np.longdouble(road.length))
    loss = -np.longdouble(0.01) * ik**2
    for _ in range(5):
        s = sigma + ik
        car = s**2 + 2 * np.longdouble(damping) * s + 1
        value = (sigma + loss) * car + np.longdouble(0.006) * s**2
        sigma -= value / (car + 2 * (sigma + loss) * (s + damping) + 2 * np.longdouble(0.006) * s)
    s = sigma + ik
    # H, Y and P of each root's vector; the start is the settled one
    response = -(s**2) / (s**2 + 2 * np.longdouble(damping) * s + 1)
    vectors = np.array([np.ones(3), response, -response / s])
    settled = -(ik**2) / (ik**2 + 2 * np.longdouble(damping) * ik + 1)
    start = np.array([1, settled, -settled / ik])
    share = np.linalg.solve(vectors.astype(complex), start.astype(complex)).astype(np.clongdouble)
    for _ in range(3):
        share += np.linalg.solve(vectors.astype(complex), (start - (vectors * share).sum(axis=1)).astype(complex))
    parts = []  # errors in units of what was estimated
    for time, height, estimate in runs:
        wave = complex((share * np.exp(sigma * np.longdouble(time))).sum()) * 1e-3
        exact = (wave * np.exp(2j * np.pi * np.arange(height.size) / height.size)).real
        parts.append(np.sqrt(np.mean((height - height.mean() - exact) ** 2)) / np.std(height) / estimate)
    assert 1 / 300 <= max(parts) <= 1
