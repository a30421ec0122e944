"""Error estimates where runs at two resolutions say too little: no order in time, waves that rounding alone has made."""

import numpy as np
import pytest

import traffic_road as tr
from traffic_road.estimate import corrugation_difference
from traffic_road.models import continuum


@pytest.mark.parametrize(
    ("k", "damping", "softness", "amplitude", "duration", "step"),
    [(1.29, 0.26, 0.008, 6.0, 396.0, 18.0), (0.77, 0.2, 0.004, 1.5, 155.0, 22.2)],
)
def test_error_estimate_of_steps_in_which_cars_take_off_and_land_is_true(
    k, damping, softness, amplitude, duration, step
):
    case = tr.Scene(tr.Road(2 * np.pi / k, softness, 0.01, tr.Sine(amplitude, k)), tr.Fleet(1, damping), duration)
    ds = tr.simulate(case, "continuum", samples=2, nodes=64, step=step)
    *_, reference = continuum.samples(case, np.array([0.0, duration]), {"nodes": 128, "step": 0.5})
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height)
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize(
    ("k", "damping", "softness", "diffusivity", "amplitude", "duration", "nodes", "step"),
    [
        (1.94, 0.07, tr.Exponential(0.036, 0.2), 0.002, 0.9, 295.0, 64, 1.0),
        (2.12, 0.29, 0.008, 0.01, 0.9, 239.0, 16, 0.5),
        (2.2, 0.1, 0.02, 0.002, 1.0, 120.0, 64, 0.5),
        (2.88, 0.18, 0.061, 0.0, 0.9, 130.0, 32, 0.5),  # kinks that nothing smooths
    ],
)
def test_error_estimate_where_cars_fly_briefly_is_true(
    k, damping, softness, diffusivity, amplitude, duration, nodes, step
):
    # steps twice as long may be right by chance
    case = tr.Scene(
        tr.Road(2 * np.pi / k, softness, diffusivity, tr.Sine(amplitude, k)), tr.Fleet(1, damping), duration
    )
    ds = tr.simulate(case, "continuum", samples=2, nodes=nodes, step=step)
    *_, reference = continuum.samples(case, np.array([0.0, duration]), {"nodes": 128, "step": step / 4})
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height)
    assert error <= ds.error_estimate <= 10 * error


@pytest.mark.parametrize(
    ("k", "damping", "law", "amplitude", "duration"),
    [(1.5, 0.2, tr.Exponential(0.05, 1.0), 0.5, 2.4), (1.0, 0.1, tr.Bounded(0.02, 2.0), 0.3, 3.0)],
)
@pytest.mark.parametrize("longer", [1.0, 10.0])  # the scene than the run
def test_error_estimate_of_a_single_step_is_true(k, damping, law, amplitude, duration, longer):
    # a second run in longer steps would take the same one
    case = tr.Scene(tr.Road(2 * np.pi / k, law, 0.01, tr.Sine(amplitude, k)), tr.Fleet(1, damping), duration * longer)
    ds = tr.simulate(case, "continuum", samples=[0.0, duration], nodes=64, step=duration)
    *_, reference = continuum.samples(case, np.array([0.0, duration]), {"nodes": 128, "step": duration / 32})
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height)
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize("duration", [20.0, 30.0, 40.0])  # the last of them comes to its full step
def test_error_estimate_of_a_run_in_its_beginning_is_true(duration):
    # unless the second run halves the shorter steps at the start, too, it ends with the same ones: 0.1 to 0.3 of the error
    road = tr.Road(2 * np.pi / 1.03, tr.Exponential(0.00482, 0.0161), 0.0614, tr.Sine(0.515, 1.03))
    case = tr.Scene(road, tr.Fleet(1, 0.234), duration)
    ds = tr.simulate(case, "continuum", samples=2, nodes=41, step=11.4)
    *_, reference = continuum.samples(case, np.array([0.0, duration]), {"nodes": 163, "step": 0.2})
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height)
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize(
    ("softness", "damping", "amplitude", "k", "waves", "duration", "nodes"),
    [
        (0.06, 0.28, 1.5, 2.24, 8, 330.0, 200),  # bounces at first
        (tr.Exponential(0.071, 0.01), 0.15, 0.5, 2.0, 4, 186.0, 110),
    ],
)
def test_waves_grown_from_rounding_are_part_of_the_estimate(softness, damping, amplitude, k, waves, duration, nodes):
    # the profile's wave decays, longer ones that it has not grow; a second run begins with much the same rounding
    def run(periods, **given):
        road = tr.Road(2 * np.pi / k * periods, softness, 0.001, tr.Sine(amplitude, k))
        case = tr.Scene(road, tr.Fleet(8 * periods, damping), duration)
        return tr.simulate(case, "continuum", samples=2, tolerance=10.0, **given)

    ds = run(waves, nodes=nodes)
    alone = np.tile(run(1, nodes=64).road_height.values[-1], waves)  # on a ring of its own there are no longer ones
    error = corrugation_difference(ds.road_height.values[-1], alone)
    assert error <= ds.error_estimate <= 10 * error


@pytest.mark.parametrize(
    ("count", "k", "damping", "law", "diffusivity", "amplitude", "every", "intervals", "where"),
    [
        (16, 1.53, 0.34, 0.005, 0.01, 2.0, 36, 40, None),  # bounces, and waves decay within an interval
        (17, 1.43, 0.36, tr.Exponential(0.007, 0.3), 0.002, 0.05, 35, 3, None),
        (
            18,
            1.26,
            0.07,
            0.003,
            0.002,
            0.2,
            27,
            2,
            None,
        ),  # linear, but for no longer than waves need to take their shape
        (6, 0.9, 0.1, tr.Exponential(0.01, 0.3), 0.002, 0.3, 12, 3, (0, 1, 1.3, 3, 4, 6)),
    ],
)
def test_error_estimate_of_relaxation_too_seldom_for_any_order_is_true(
    count, k, damping, law, diffusivity, amplitude, every, intervals, where
):
    road = tr.Road(2 * np.pi / k, law, diffusivity, tr.Sine(amplitude, k))
    case = tr.Scene(road, tr.Fleet(count, damping, position=where), intervals * every * road.length / count)
    ds, reference = (
        tr.simulate(case, "cars", samples=2, nodes=n * count, hold=h, relax_every=e)
        for n, h, e in ((32, 3, every), (64, 5, 1))
    )
    assert reference.time[-1] == pytest.approx(float(ds.time[-1]))
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height.values[-1])
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize(
    ("count", "k", "damping", "softness", "diffusivity", "duration", "rows"),
    [(15, 0.65, 0.2, 0.009, 0.05, 3.8, 6), (19, 1.0, 0.4, 0.013, 0.04, 42.0, 12)],
)
def test_error_estimate_of_cars_that_start_from_rest_is_true(count, k, damping, softness, diffusivity, duration, rows):
    # linear, but what the cars do before they settle is on the road for long, and no growth rate tells of it
    road = tr.Road(2 * np.pi / k, softness, diffusivity, tr.Sine(1e-2, k))
    case = tr.Scene(road, tr.Fleet(count, damping, start="rest"), duration)
    ds, reference = (
        tr.simulate(case, "cars", samples=2, nodes=n * count, hold=5, tolerance=10.0) for n in (rows, 16 * rows)
    )
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height.values[-1])
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize(
    ("count", "k", "damping", "softness", "diffusivity", "duration", "rows", "hold"),
    [(12, 0.9, 0.013, 0.002, 0.048, 64.0, 6, 5), (14, 1.54, 0.005, 0.006, 0.004, 4.0, 12, 1)],
)
def test_error_estimate_where_cars_would_swing_longest_is_true(
    count, k, damping, softness, diffusivity, duration, rows, hold
):
    # the rate that decays least is that of the cars, who are settled: it has next to nothing of the road
    road = tr.Road(2 * np.pi / k, softness, diffusivity, tr.Sine(5e-2, k))
    case = tr.Scene(road, tr.Fleet(count, damping), duration)
    ds, reference = (
        tr.simulate(case, "cars", samples=2, nodes=n * count, hold=h, tolerance=10.0)
        for n, h in ((rows, hold), (16 * rows, 5))
    )
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height.values[-1])
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize(
    ("count", "waves", "k", "damping", "softness", "diffusivity", "amplitude", "rows", "every", "intervals"),
    [(15, 2, 0.814, 0.51, 0.036, 0.076, 1.05, 4, 15, 1), (18, 1, 1.1, 0.53, 0.0048, 0.0107, 0.332, 9, 4, 2)],
)
def test_error_estimate_where_those_of_grid_and_interval_cancel_is_true(
    count, waves, k, damping, softness, diffusivity, amplitude, rows, every, intervals
):
    # of the error of the interval that of the coarser grid takes off a half
    road = tr.Road(2 * np.pi / k * waves, softness, diffusivity, tr.Sine(amplitude, k))
    case = tr.Scene(road, tr.Fleet(count, damping), intervals * every * road.length / count)
    ds, reference = (
        tr.simulate(case, "cars", samples=2, nodes=n * count, hold=h, relax_every=e, tolerance=10.0)
        for n, h, e in ((rows, 1, every), (128, 5, 1))
    )
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height.values[-1])
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize(
    ("count", "law", "diffusivity", "amplitude", "rows", "every", "intervals"),
    [(7, tr.Bounded(0.03, 1.0), 0.03, 1e-3, 2, 14, 1), (8, 0.03, 0.05, 1e-3, 3, 8, 2)],
)
def test_error_estimate_on_two_or_three_nodes_a_headway_is_true(
    count, law, diffusivity, amplitude, rows, every, intervals
):
    # half of them is one, on which passages leave no ripple
    road = tr.Road(2 * np.pi / 0.9, law, diffusivity, tr.Sine(amplitude, 0.9))
    case = tr.Scene(road, tr.Fleet(count, 0.14), intervals * every * road.length / count)
    ds, reference = (
        tr.simulate(case, "cars", samples=2, nodes=n * count, hold=5, relax_every=e, tolerance=10.0)
        for n, e in ((rows, every), (64, 1))
    )
    error = corrugation_difference(ds.road_height.values[-1], reference.road_height.values[-1])
    assert error <= ds.error_estimate <= 3 * error


@pytest.mark.parametrize("amplitude", [1e-2, 1.5])
@pytest.mark.parametrize("headways", [4.5, 40.5])
@pytest.mark.parametrize("nodes", [129, 257])
def test_error_estimate_of_an_even_fleet_between_nodes_is_true(nodes, headways, amplitude):
    # half of 2 q 8 + 1 nodes is q 8, on which it would be seen at another time, after a whole headway
    k = 0.9
    road, fleet = tr.Road(2 * np.pi / k, 0.006, 0.01, tr.Sine(amplitude, k)), tr.Fleet(8, 0.1)
    case = tr.Scene(road, fleet, headways * road.length / 8)
    ds, fine = (tr.simulate(case, "cars", samples=2, nodes=n, hold=5, tolerance=1.0) for n in (nodes, 15 * nodes))
    assert float(ds.time[-1]) == float(fine.time[-1]) == case.duration
    error = corrugation_difference(fine.road_height.values[-1], ds.road_height.values[-1])
    assert error <= ds.error_estimate <= 5 * error


def test_a_road_that_is_flat_for_its_numerics_alone_says_so():
    # each interval's relaxation and the bouncing between take more of the wave than both at once
    road = tr.Road(2 * np.pi / 1.59, 0.003, 0.03, tr.Sine(1.0, 1.59))
    case = tr.Scene(road, tr.Fleet(18, 0.34), 71 * 44 * road.length / 18)
    ds = tr.simulate(case, "cars", samples=2, nodes=288, relax_every=44)
    assert np.ptp(ds.road_height.values[-1]) < 1e-12 and ds.error_estimate > 1
    assert np.ptp(tr.simulate(case, "cars", samples=2, nodes=288).road_height.values[-1]) > 1e-9
