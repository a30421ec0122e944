"""The cars model against its closed forms, its Floquet matrix and a plain loop."""

import platform
import subprocess
import sys
from dataclasses import replace

import numba
import numpy as np
import pytest
from reference import plain_cars

import traffic_road as tr
from traffic_road.errors import SceneError, StabilityError
from traffic_road.models import Sample, cars, cars_even, even_passages, even_relaxation
from traffic_road.models.cars_mixed import mixed_samples
from traffic_road.models.even_layout import get, layout, on_huge_pages, put
from traffic_road.models.even_passages import LONG, SHORT, SLIGHT, met_bounded, met_exponential, passage
from traffic_road.models.line_relaxation import LineRelaxation
from traffic_road.models.stack import align_stack
from traffic_road.schemes import relaxation
from traffic_road.schemes.oscillator import propagator
from traffic_road.schemes.passage import contact_height
from traffic_road.theory import dispersion, fleet_dispersion, floquet
from traffic_road.theory.floquet import floquet_mode, nearest_eigenpair, relaxation_matrix, sweep_matrix

K = 0.9


def scene(*, count=8, softness=0.006, diffusivity=0.01, damping=0.1, amplitude=1e-3, duration=400.0, **fleet):
    return tr.Scene(
        tr.Road(2 * np.pi / K, softness, diffusivity, tr.Sine(amplitude, K)),
        tr.Fleet(count, damping, **fleet),
        duration,
    )


def run(scene, times, **numerics):
    numerics = cars.numerics(scene, numerics)
    everything = cars.samples(scene, cars.sample_times(scene, times, numerics), numerics)
    return [sample for sample in everything if isinstance(sample, Sample)]


def late_sigma(samples):
    """Complex growth rate of the ring's first wave over the later half of the samples."""
    wave = np.array([np.fft.rfft(s.road_height)[1] for s in samples[len(samples) // 2 :]])
    span = samples[-1].time - samples[len(samples) // 2].time
    angle = np.unwrap(np.angle(wave))
    return (np.log(np.abs(wave[-1] / wave[0])) + 1j * (angle[-1] - angle[0])) / span


def slope(x, y):
    return np.polyfit(np.log(x), np.log(np.abs(y)), 1)[0]


def closed_form(headway, softness=0.02):
    return dispersion(K, softness=softness, diffusivity=0.0, damping=0.1, headway=headway)


def scheme(rows, hold, headway, *, softness=0.02, diffusivity=0.0, relax_every=1):
    count = round(2 * np.pi / K / headway)
    case = scene(count=count, softness=softness, diffusivity=diffusivity)
    return floquet(case, K, nodes=rows * count, hold=hold, relax_every=relax_every)


@pytest.mark.parametrize(
    ("count", "rows", "hold", "relax_every"),
    [
        (8, 8, 3, 1),
        (8, 8, 1, 1),
        (8, 16, 5, 2),
        (8, 32, 1, 4),
        (8, 5, 3, 3),
        (4, 64, 3, 1),
        (5, 7, 5, 1),
        (3, 12, 1, 7),
    ],
)
def test_run_grows_at_the_rate_of_the_floquet_matrix(count, rows, hold, relax_every):
    case = scene(count=count)
    numerics = {"nodes": count * rows, "hold": hold, "relax_every": relax_every}
    # 600 time units: the cars' own transients, exp(-0.1 t), are below 1e-13 in the later half
    sigma = late_sigma(run(case, np.linspace(0, 600, 121), **numerics))
    assert sigma == pytest.approx(floquet(case, K, **numerics), rel=1e-9)


def test_run_without_lift_off_rule_grows_through_lift_off_amplitude():
    case = replace(scene(amplitude=2.0), lift_off=False)
    samples = run(case, np.linspace(0, 600, 121), nodes=64, hold=3)
    assert min(s.contact_force.min() for s in samples) < -1
    assert late_sigma(samples) == pytest.approx(floquet(case, K, nodes=64, hold=3), rel=1e-9)


@pytest.mark.parametrize(("hold", "rows", "bar"), [(1, 64, 1e-4), (3, 32, 1e-6), (5, 16, 1e-6)])
@pytest.mark.parametrize("count", [4, 8])
def test_growth_without_diffusion_is_the_closed_form(hold, rows, bar, count):
    case = scene(count=count, softness=0.02, diffusivity=0.0, amplitude=1e-6)
    sigma = late_sigma(run(case, np.linspace(0, 300, 121), nodes=count * rows, hold=hold))
    assert sigma == pytest.approx(closed_form(case.headway), rel=bar)


@pytest.mark.parametrize(
    ("hold", "rows", "width"),
    [(1, (8, 12, 16, 24, 32), 0.1), (3, (8, 12, 16, 24, 32), 0.15), (5, (6, 8, 10, 12, 16), 0.3)],
)
def test_order_in_the_grid(hold, rows, width):
    headway = 2 * np.pi / K / 4
    error = [scheme(r, hold, headway) - closed_form(headway) for r in rows]
    assert slope(headway / np.array(rows), error) == pytest.approx(hold + 1, abs=width)


def test_order_in_the_headway_against_the_continuum():
    count = np.array([8, 12, 16, 24, 32, 48])
    headway = 2 * np.pi / K / count
    cubic = dispersion(K, softness=0.02, diffusivity=0.01, damping=0.1)
    error = [scheme(16, 5, h, diffusivity=0.01) - cubic for h in headway]
    assert slope(headway, error) == pytest.approx(2.0, abs=0.1)
    # without diffusion the coefficient, too, is known: -(alpha^3 l^2 / 12) R^3 / (1 + alpha R')
    cubic = dispersion(K, softness=0.02, diffusivity=0.0, damping=0.1)
    s = cubic + 1j * K
    R = s**2 / (s**2 + 0.2 * s + 1)
    dR = 2 * s * (1 + 0.1 * s) / (s**2 + 0.2 * s + 1) ** 2
    expected = -(0.02**3) * headway**2 / 12 * R**3 / (1 + 0.02 * dR)
    found = closed_form(headway) - cubic
    assert slope(headway, found) == pytest.approx(2.0, abs=0.02)
    np.testing.assert_allclose(found[-1], expected[-1], rtol=1e-3)  # the next order is smaller by (alpha l)^2 R^2


def test_order_in_the_relaxation_interval():
    # reference: the continuum's cubic; at 128 cars a wavelength their own headway counts for 4^-2 of the smallest interval
    count, every = 128, np.array([8, 16, 32, 64])
    cubic = dispersion(K, softness=0.02, diffusivity=0.05, damping=0.1)
    headway = 2 * np.pi / K / count
    error = [scheme(4, 3, headway, diffusivity=0.05, relax_every=int(n)) - cubic for n in every]
    assert slope(every, error) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("diffusivity", [0.05, tr.Exponential(0.05, 0.5)])
@pytest.mark.parametrize("softness", [0.01, tr.Exponential(0.01, 0.5)])
def test_order_of_the_road_in_the_relaxation_interval(softness, diffusivity):
    # in L2 and in each wave; at a single point the steps that the wheels leave keep it near 1.6
    count, every = 128, np.array([8, 16, 32, 64])
    case = scene(count=count, softness=softness, diffusivity=diffusivity, amplitude=0.5)
    times = [0, 128 * case.headway]
    finest = run(case, times, nodes=2 * count, relax_every=1)[-1].road_height
    error = [run(case, times, nodes=2 * count, relax_every=int(n))[-1].road_height - finest for n in every]
    # the finest run misses the limit by 1/n^2 of the run at n: fitted against n^2 - 1, its exact share
    norm = np.linalg.norm(error, axis=1)
    wave = np.abs(np.fft.rfft(error, axis=1)[:, 1:4]).T
    for size in (norm, *wave):
        assert slope(np.sqrt(every**2 - 1.0), size) == pytest.approx(2.0, abs=0.15)


def test_mean_sink_is_softness_times_mean_force():
    # one node a headway and one sample a headway: every passage is a sample
    case = scene(count=32, amplitude=0.05)
    headways = 300
    samples = run(case, np.arange(headways + 1) * case.headway, nodes=32, hold=1)
    force = np.array([s.contact_force for s in samples[1:]])
    assert force.min() > 0.1 and force.std() > 0.05
    sunk = samples[0].road_height.mean() - samples[-1].road_height.mean()
    assert sunk == pytest.approx(0.006 * samples[-1].time * force.mean(), rel=1e-12)


@pytest.mark.parametrize("hold", [1, 3, 5])
@pytest.mark.parametrize("softness", [0.02, tr.Exponential(0.02, 0.7), tr.Bounded(0.02, 0.5)])
@pytest.mark.parametrize("amplitude", [1e-3, 1.5])
def test_even_kernel_is_the_plain_loop(hold, softness, amplitude):
    case = scene(count=5, softness=softness, amplitude=amplitude)
    headways = 40  # eight times round for the blocks
    (expected,), forces = plain_cars(case, 50, hold, [0, headways * case.headway], headways)
    last = run(case, [0, headways * case.headway], nodes=50, hold=hold)[-1]
    assert (forces.min() == 0) == (amplitude > 1)  # airborne passages are in the test
    assert last.airborne == np.count_nonzero(forces == 0)
    for found, wanted in zip((last.road_height, last.car_height, last.contact_force), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-13)  # 2000 passages of rounding at height 1


def mixed_fleet(**changes):
    values = {
        "speed": (1.0, 1.1, 0.8, 1.0, 1.3),
        "frequency": (1.0, 0.9, 1.2, 1.0, 1.0),
        "damping": (0.1, 0.3, 0.2, 0.1, 1.2),
        "mass": (1.0, 2.0, 0.5, 1.0, 1.0),
        "position": (0.1, 1.0, 2.5, 2.6, 6.0),
    }
    return tr.Fleet(5, **{**values, **changes})


@pytest.mark.parametrize("hold", [1, 5])
@pytest.mark.parametrize("softness", [0.02, tr.Exponential(0.02, 0.7)])
@pytest.mark.parametrize("amplitude", [1e-3, 1.5])
def test_mixed_kernel_is_the_plain_loop_with_overtaking(hold, softness, amplitude):
    case = replace(scene(softness=softness, amplitude=amplitude), fleet=mixed_fleet())
    times = [0.0, 20.0, 41.3]  # the quickest car overtakes the slowest three times
    parts = round(20 / case.headway_time)
    expected, forces = plain_cars(case, 48, hold, times[:2], parts)
    last = run(case, times, nodes=48, hold=hold)[1]
    assert (forces.min() == 0) == (amplitude > 1)
    assert last.updates == forces.size
    for found, wanted in zip((last.road_height, last.car_height, last.contact_force), expected[0], strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-13)


def test_both_kernels_agree_on_an_even_fleet():
    even = scene(amplitude=1.2)
    time = 64 * even.headway
    nearly = replace(even, fleet=replace(even.fleet, mass=(1.0,) * 7 + (1.0 + 2**-52,)))
    a = run(even, [0, time], nodes=64)[-1]
    b = run(nearly, [0, time], nodes=64)[-1]
    assert a.airborne > 0 and a.time == pytest.approx(b.time, rel=1e-15)
    np.testing.assert_allclose(a.road_height, b.road_height, atol=1e-12)
    np.testing.assert_allclose(a.car_height, b.car_height, atol=1e-12)


def test_uneven_positions_of_one_speed_keep_their_distances():
    rng = np.random.default_rng(5)
    case = scene(count=6, position=tuple(rng.uniform(0, 2 * np.pi / K, 6)))
    first, last = run(case, [0, 30.0], nodes=60)
    moved = np.mod(last.where - first.where, 2 * np.pi / K)
    dx = 2 * np.pi / K / 60
    assert np.ptp(moved) < 1.01 * dx  # reported at the last node crossed


def test_two_kinds_of_car_approach_the_fleet_dispersion():
    # alternating kinds, no diffusion: against the continuum, second order in the headway
    errors, counts = [], np.array([16, 32, 64])
    for count in counts:
        fleet = tr.Fleet(int(count), damping=(0.1, 0.3) * (count // 2), frequency=(1.0, 1.4) * (count // 2))
        case = replace(scene(softness=0.02, diffusivity=0.0), fleet=fleet, lift_off=False)
        sigma = late_sigma(run(case, case.headway * np.arange(0, 80 * count, 4), nodes=128, hold=5))
        errors.append(sigma - fleet_dispersion(K, fleet, softness=0.02, diffusivity=0.0))
    assert abs(errors[-1]) < 1e-7
    assert slope(1 / counts, errors) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("fleet", [{}, {"position": (0.0, 1.0, 1.5, 3.0, 4.0, 5.0, 5.5, 6.5)}])
def test_shift_by_whole_nodes_shifts_the_answer(fleet):
    case = scene(amplitude=1.2, **fleet)
    nodes, by = 64, 13
    dx = case.road.length / nodes
    moved = replace(
        case,
        road=replace(case.road, profile=tr.Sine(1.2, K, phase=-K * by * dx)),
        fleet=replace(case.fleet, position=tuple(case.fleet.positions(case.road.length) + by * dx)),
    )
    a, b = (run(s, [0, 80.0], nodes=nodes)[-1] for s in (case, moved))
    assert a.airborne > 0
    # bouncing amplifies rounding, a few e-foldings here
    np.testing.assert_allclose(np.roll(a.road_height, by), b.road_height, atol=1e-11)
    np.testing.assert_allclose(np.mod(a.where + by * dx - b.where + 1, case.road.length), 1, atol=1e-9)


@pytest.mark.parametrize("hold", [1, 3, 5])
def test_uniform_road_stays_uniform_from_headway_to_headway(hold):
    # within a headway the first passages leave a step of delta = alpha l at each start, and the wheel that rolls down it
    # presses unevenly: a ripple of the headway's own length, second order in delta, is part of the model of point wheels
    ripple = []
    for softness in (0.006, 0.003):
        case = replace(scene(), road=tr.Road(2 * np.pi / K, softness, 0.01))
        last = run(case, [0, 400.0], nodes=64, hold=hold)[-1]
        assert np.ptp(last.road_height.reshape(8, 8), axis=0).max() < 1e-13
        assert last.road_height.mean() == pytest.approx(-softness * last.time, rel=1e-4)
        ripple.append(np.ptp(last.road_height))
    assert ripple[0] < 2 * (0.006 * case.headway) ** 2
    assert np.log2(ripple[0] / ripple[1]) == pytest.approx(2.0, abs=0.05)


def test_car_at_rest_starts_on_the_road_without_momentum():
    first = run(scene(amplitude=0.5, start="rest"), [0, 1.0], nodes=64)[0]
    node = np.rint(first.where / (2 * np.pi / K) * 64).astype(int)
    np.testing.assert_allclose(first.car_height, first.road_height[node], rtol=0, atol=2e-16)
    np.testing.assert_allclose(first.contact_force, 1.0)


def test_samples_do_not_disturb_the_run():
    case = scene(amplitude=1.2)
    times = np.linspace(0, 200, 41)
    many, few = (run(case, t, nodes=64, relax_every=2)[-1] for t in (times, times[[0, -1]]))
    assert many.time == few.time
    np.testing.assert_allclose(many.road_height, few.road_height, atol=1e-11)


def test_nan_is_not_hidden_by_the_lift_off_rule():
    case = scene(amplitude=1.0)
    numerics = cars.numerics(case, {"nodes": 64})
    broken = replace(case, road=replace(case.road, softness=tr.Constant(1e308)))
    with np.errstate(all="ignore"):
        *_, last = cars.samples(broken, [0.0, 50 * case.headway], numerics)
    assert not np.all(np.isfinite(last.road_height))


@pytest.mark.parametrize("hold", [1, 3, 5])
@pytest.mark.parametrize("damping", [0.03, 0.3, 1.0, 5.0])
def test_grid_too_coarse_for_the_car_is_refused_just_where_it_fails(hold, damping):
    def fails(dx):
        """A wave well above the resonance grows, or the passage has no root: the Floquet matrix of one node a headway."""
        growth = []
        for k in np.linspace(min(1.5, np.pi / dx), np.pi / dx, 33):
            matrix = sweep_matrix(k, headway=dx, rows=1, hold=hold, softness=1e-3, car=(1.0, 1.0, damping, 1.0))
            growth.append(np.abs(np.linalg.eigvals(matrix)).max() - 1)
        return max(growth) > 0 or propagator(dx, 1.0, damping, hold)[1][0, 0, 0] >= 1

    def refused(dx):
        case = tr.Scene(tr.Road(8 * dx, 1e-3), tr.Fleet(8, damping), 10.0)
        try:
            cars.numerics(case, {"nodes": 8, "hold": hold})
        except StabilityError as error:
            need = int(str(error).split("use nodes >= ")[1])
            assert cars.numerics(case, {"nodes": need, "hold": hold})["nodes"] == need
            return True
        return False

    spacings = np.geomspace(0.1, 4.0, 30)
    limit = next((dx for dx in spacings if refused(dx)), None)
    if limit is None:
        assert not any(fails(dx) for dx in spacings)
        return
    low, high = 0.1, limit
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (low, middle) if refused(middle) else (middle, high)
    assert not fails(0.98 * low)
    assert fails(1.02 * low)


@pytest.mark.parametrize(
    "given",
    [{"nodes": 2}, {"nodes": 0}, {"nodes": 64.0}, {"nodes": True}, {"hold": 2}, {"relax_every": 0}, {"step": 0.1}],
)
def test_bad_numerics_are_refused_in_one_line(given):
    with pytest.raises(SceneError) as error:
        cars.numerics(scene(), given)
    assert "\n" not in str(error.value) and next(iter(given)) in str(error.value)


def test_floquet_matrices_keep_the_uniform_road():
    # the road sunk as a whole, car and all, is an eigenvector of eigenvalue 1
    sweep = sweep_matrix(0.0, headway=0.8, rows=6, hold=3, softness=0.02, car=(1.0, 1.0, 0.1, 1.0))
    sunk = np.ones(11)
    sunk[7] = 0.0  # P
    np.testing.assert_allclose(sweep @ sunk, sunk, atol=1e-14)
    relaxed = relaxation_matrix(0.0, headway=0.8, rows=6, diffusion=0.1) @ np.ones(6)
    np.testing.assert_allclose(relaxed, 1.0, atol=1e-14)


@pytest.mark.parametrize("headways", [0.2, 1.0, 3.4, 3.6, 10.0])
def test_a_relaxation_interval_longer_than_the_run_is_refused(headways):
    # an even fleet is sampled after whole intervals: the run would be lengthened to one
    case = scene()
    case = replace(case, duration=headways * case.headway_time)
    longest = max(1, round(headways))
    ds = tr.simulate(case, "cars", samples=2, nodes=64, relax_every=longest)
    assert ds.time[-1] == pytest.approx(longest * case.headway_time)
    for numerics in ({}, {"allow_unstable": True}, {"model": "auto"}):
        with pytest.raises(tr.SceneError, match=rf"relax_every = {longest + 1}: .*; use relax_every <= {longest} or"):
            tr.simulate(case, **{"model": "cars", "nodes": 64, "relax_every": longest + 1, **numerics})
    # times say how long the run is; cars between nodes are sampled at any time
    for other, times, nodes in (case, [0.0, (longest + 1) * case.headway_time], 64), (case, 2, 60):
        ds = tr.simulate(other, "cars", samples=times, nodes=nodes, relax_every=longest + 1)
        assert abs(ds.time[-1] - (case.duration if times == 2 else times[-1])) <= (longest + 1) / 2 * case.headway_time
    # nothing chooses such an interval by itself
    assert tr.plan(case, 1e-1).numerics.get("relax_every", 1) <= longest
    tr.theory.floquet(case, K, nodes=64, relax_every=longest + 1)


@pytest.mark.parametrize(("rows", "relax_every"), [(8, 1), (7, 2)])
def test_shape_of_the_wave_is_that_of_the_floquet_matrix(rows, relax_every):
    case = replace(scene(amplitude=100.0), lift_off=False)  # far above the ripple of a uniform road, which is separate
    numerics = {"nodes": 8 * rows, "hold": 3, "relax_every": relax_every}
    last = run(case, [0, 600.0], **numerics)[-1]
    wave = np.fft.fft(last.road_height)
    ripple = np.fft.fft(
        run(replace(case, road=tr.Road(2 * np.pi / K, 0.006, 0.01)), [0, 600.0], **numerics)[-1].road_height
    )
    found = (wave - ripple)[1::8] / wave[1]  # k + 2 pi n/l is 1 + 8 n waves on the ring
    np.testing.assert_allclose(found, floquet_mode(case, K, **numerics)[1], atol=1e-10)


@pytest.mark.parametrize(
    ("rows", "hold", "diffusivity", "damping", "relax_every"),
    [(8, 3, 0.01, 0.1, 1), (13, 5, 0.0, 0.02, 1), (64, 1, 0.3, 1.0, 3), (96, 5, 0.001, 0.1, 1)],
)
def test_floquet_mode_is_that_of_all_eigenvalues(rows, hold, diffusivity, damping, relax_every):
    case = scene(diffusivity=diffusivity, damping=damping)
    block = {"headway": case.headway, "rows": rows}
    half = np.eye(rows + 2 + hold, dtype=complex)
    half[:rows, :rows] = relaxation_matrix(K, **block, diffusion=diffusivity * relax_every * case.headway / 2)
    sweep = sweep_matrix(K, **block, hold=hold, softness=0.006, car=(1.0, 1.0, damping, 1.0))
    values, vectors = np.linalg.eig(half @ np.linalg.matrix_power(sweep, relax_every) @ half)
    sigma, shape = floquet_mode(case, K, nodes=8 * rows, hold=hold, relax_every=relax_every)
    multiplier = np.exp(sigma * relax_every * case.headway)
    nearest = np.argmin(np.abs(values - multiplier))
    assert multiplier == pytest.approx(values[nearest], rel=1e-11)
    place = np.arange(1, rows + 1) / rows * case.headway
    road = vectors[:rows, nearest]
    expected = [np.mean(road * np.exp(-1j * (K + 2 * np.pi * n / case.headway) * place)) for n in range(rows)]
    np.testing.assert_allclose(shape, np.array(expected) / expected[0], atol=1e-9)


def test_nearest_eigenpair_where_inverse_iteration_does_not_settle():
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))[0]
    matrix = (turn * [1.0, -1.0, 3.0, 1.5j] @ turn.T).astype(complex)
    for guess, expected in ((0.0, (1, -1)), (3.0, (3,)), (2.9 + 0.1j, (3,))):  # between two; at one itself; near one
        value, vector = nearest_eigenpair(matrix, guess)
        assert min(abs(value - e) for e in expected) < 1e-13
        np.testing.assert_allclose(matrix @ vector, value * vector, atol=1e-13)


def test_nearest_eigenpair_of_a_guess_that_is_one_to_the_last_bit():
    matrix = np.array([[0.5, 0.25, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 2.0]], complex)
    value, vector = nearest_eigenpair(matrix, 1.0)
    assert value == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(matrix @ vector, vector, atol=1e-14)
    assert np.linalg.norm(vector) == pytest.approx(1.0)


def test_floquet_refuses_what_it_cannot_describe():
    with pytest.raises(SceneError, match="identical, evenly spaced"):
        floquet(replace(scene(), fleet=mixed_fleet()), K, nodes=64, hold=3, relax_every=1)
    with pytest.raises(SceneError, match="foo"):
        floquet(scene(), K, foo=3)
    with pytest.raises(SceneError, match="Constant"):
        floquet(scene(softness=tr.Exponential(0.006, 0.1)), K, nodes=64, hold=3, relax_every=1)


@pytest.mark.parametrize("spread", [3.0, 11.7, 60.0])
def test_band_of_weights_is_the_transform(spread):
    length, nodes = 1000.0, 4096
    diffusion = spread * (length / nodes) ** 2
    weights = relaxation.band(diffusion, length, nodes)
    angle = 2 * np.pi * np.arange(nodes // 2 + 1) / nodes
    found = weights[0] + 2 * np.cos(np.outer(angle, np.arange(1, weights.size))) @ weights[1:]
    error = np.abs(found - relaxation.symbol(diffusion, length, nodes))
    assert error.max() < 2 * relaxation.TAIL  # what is cut off, and what its spread puts back at the end
    # the spread is kept: long waves miss by its fourth moment, (angle * half-width)^4 / 24 of the tail
    bound = relaxation.TAIL * (angle * weights.size) ** 4 / 12 + 1e-15
    assert np.all(error[: nodes // 100] < bound[: nodes // 100])
    assert weights.size < 10 * np.sqrt(spread)
    # too narrow for a short band, too wide for a cheap one
    assert relaxation.band(0.1 * diffusion / spread, length, nodes) is None
    assert relaxation.band(1e4 * diffusion / spread, length, nodes) is None


@pytest.mark.parametrize("nodes", [1, 2, 3, 8, 61, relaxation.SHORT_RING - 1, relaxation.SHORT_RING])
@pytest.mark.parametrize("spread", [1e-300, 1e-13, 1e-3, 0.7, 30.0, 1e5])
def test_all_pairs_around_a_short_ring_are_the_transform(nodes, spread):
    height = np.random.default_rng(nodes).standard_normal(nodes)
    found = height.copy()
    LineRelaxation(tr.Constant(spread), float(nodes))(found, 1.0)
    assert relaxation.band(spread, float(nodes), nodes) is not None
    wanted = relaxation.relax_transform(height, relaxation.symbol(spread, float(nodes), nodes))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=3 * relaxation.TAIL * np.abs(height).max())
    assert found.mean() == pytest.approx(height.mean(), abs=1e-14)


def test_a_longer_ring_has_no_short_band_for_little_or_much_smoothing():
    nodes = relaxation.SHORT_RING + 1
    assert relaxation.band(0.7, float(nodes), nodes) is None and relaxation.band(1e3, float(nodes), nodes) is None
    assert relaxation.band(30.0, float(nodes), nodes) is not None
    for spread in (1e-200, 1e-12):  # next to nothing: nearest neighbours do
        np.testing.assert_allclose(relaxation.band(spread, float(nodes), nodes), [1 - 2 * spread, spread], rtol=1e-13)


def banded(weights, height):
    """Roads (waves, nodes) after a symmetric band, in numpy."""
    pairs = (w * (np.roll(height, t, 1) + np.roll(height, -t, 1)) for t, w in enumerate(weights) if t)
    return weights[0] * height + sum(pairs)


@pytest.mark.parametrize("spread", [relaxation.ALIASED, 11.7, 46.9, 300.0, 2700.0, 20000.0])
def test_band_by_way_of_fewer_nodes_is_the_transform(spread):
    nodes, depth = 2048, relaxation.deepest(spread)
    wave = np.unique(np.concatenate((np.arange(0, nodes // 2 + 1, 16), np.arange(40))))
    height = np.cos(2 * np.pi / nodes * np.outer(wave, np.arange(nodes)) + wave[:, None])  # each wave by itself
    exact = relaxation.symbol(spread, float(nodes), nodes)[wave, None] * height
    for levels in range(max(1, depth - 1), depth + 1):
        passes, weights = relaxation.levels(spread, levels)
        assert passes.shape == (levels, relaxation.LOW_PASS + 1)
        road = height
        for low_pass in passes:
            road = banded(low_pass, road)[:, ::2]
        road = banded(weights, road)
        for low_pass in passes[::-1]:
            finer = np.zeros((wave.size, 2 * road.shape[1]))
            finer[:, ::2] = 2 * road
            road = banded(low_pass, finer)
        error = np.abs(road - exact).max(axis=1)
        assert error.max() < 2 * relaxation.TAIL  # of the band's fit and the waves that pass for others
        assert error[0] < 1e-13 and error[-1] < 1e-13  # the mean stays, the shortest wave ends
        # so does the growth of the spread: what is left of long waves misses by the fourth power of their angle
        angle = 2 * np.pi * wave / nodes
        kept = np.mean((road - exact) * height, axis=1) / np.mean(height**2, axis=1)
        bound = relaxation.TAIL * (angle * weights.size * 2**levels) ** 4 / 12 + 1e-14
        assert np.all(np.abs(kept[:40]) < bound[:40])


@pytest.mark.parametrize(("count", "rows"), [(4096, 8), (701, 6), (1025, 4)])
@pytest.mark.parametrize("spread", [1e-6, 0.02, 0.3, 0.73, 2.39])
def test_little_smoothing_of_a_long_road_is_the_transform(count, rows, spread):
    nodes = count * rows
    road = tr.Road(float(nodes), 0.01, spread / rows)  # a headway takes `rows` units of time
    case = tr.Scene(road, tr.Fleet(count, 0.1), 1.0)
    where = layout(count, rows)
    where = layout(count, rows, even_relaxation.margin(case, nodes, where, (1,)))
    relaxation_of = even_relaxation.Relaxation(case, nodes, where)
    wanted_factor = relaxation.symbol(spread, float(nodes), nodes)
    waves = [np.cos(2 * np.pi * m / nodes * np.arange(nodes) + m) for m in (1, nodes // 4, nodes // 2 - 1, nodes // 2)]
    for height in (np.random.default_rng(count).standard_normal(nodes), np.ones(nodes), *waves):
        found, inside = np.empty(nodes), np.full(where.size, np.nan)  # whatever is not filled is seen
        put(inside, height, 0, where)
        relaxation_of.relax(inside, 1)
        get(found, inside, 0, where)
        error = np.abs(found - relaxation.relax_transform(height, wanted_factor)).max()
        assert error < 4 * relaxation.TAIL
        if height is waves[0] or np.ptp(height) == 0:  # mean and spread are kept to rounding
            assert error < 2e-14
    assert relaxation_of.ripples is not None


@pytest.mark.parametrize(
    ("count", "rows", "hold", "diffusivity", "relax_every", "softness"),
    [
        (1, 64, 3, 0.01, 1, 0.02),
        (3, 30, 1, 0.0, 2, 0.02),
        (2, 516, 3, 0.01, 1, 0.02),  # so long that its lanes are as few as the cars
        (13, 16, 1, 0.01, 1, 0.02),
        (40, 9, 5, 0.02, 1, 0.0),
        (515, 6, 3, 0.0, 1, tr.Exponential(0.02, 0.5)),  # beyond the range of the polynomials here and there
        (515, 6, 3, 0.0, 1, tr.Exponential(0.06, 0.1)),  # and with too strong forces
        (600, 32, 1, 0.01, 4, 0.02),  # by way of every other node
        (650, 12, 1, 0.0, 1, 0.02),  # two vectors of cars side by side, but for tile 0
        (777, 5, 3, 0.2, 1, tr.Bounded(0.02, 0.9)),
        (4097, 8, 3, 0.05, 4, 0.02),  # two panels
    ],
)
def test_any_number_of_cars_is_the_kernel_of_mixed_fleets(count, rows, hold, diffusivity, relax_every, softness):
    waves = max(1, count // 8)
    place = 2 * np.pi * waves * np.arange(count * rows) / (count * rows)
    profile = 1.5 * np.sin(place) + 0.3 * np.sin(2 * place + 1) if count > 8 else 0.3 * np.sin(place)
    case = tr.Scene(tr.Road(0.87 * count, softness, diffusivity, profile), tr.Fleet(count, 0.1), duration=24 * 0.87)
    numerics = cars.numerics(case, {"nodes": count * rows, "hold": hold, "relax_every": relax_every})
    times = cars.sample_times(case, [0.0, 8 * 0.87, 24 * 0.87], numerics)
    both = cars.samples(case, times, numerics), mixed_samples(case, times, **numerics)
    for even, mixed in zip(*([s for s in kind if isinstance(s, Sample)] for kind in both), strict=True):
        assert even.updates == mixed.updates
        if softness != 0.0:  # on a rigid road the one counts cars in the air, the other nodes not pressed down, none
            assert even.airborne == mixed.airborne
        for name in ("road_height", "car_height", "contact_force", "where"):
            # relaxed by bands, exact to 1e-10, or by none
            found, wanted = getattr(even, name), getattr(mixed, name)
            np.testing.assert_allclose(found, wanted, atol=5e-10 if diffusivity else 5e-12)
    assert even.airborne > 0 or count < 8


@pytest.mark.parametrize("series", [LONG, SHORT], ids=["long", "short"])
@pytest.mark.parametrize(("value", "shape"), [(0.006, 0.1), (0.006, 0.5), (0.05, 0.05)])
def test_vectorised_passages_are_the_iteration(value, shape, series):
    rng = np.random.default_rng(3)
    half, b, level = 0.4, 1e-3, -2.0
    numbers = passage(1.0, b, half, 1.0, (1, value, shape), level, series)
    middle, reach, strain, *rest = numbers[6:]
    sure, trials = 0, 8000
    heights = level + rng.uniform(-1.3, 1.3, trials) * series.range / shape
    for before, down in zip(heights, 7.2 * rng.uniform(size=trials) ** 3 - 1.2, strict=True):
        law = before, before - down
        sunk, touched, square = met_exponential(*law, shape, 0.0, middle, *rest[:7], tuple(rest[7:]), series is SHORT)
        wanted = contact_height(*law, b, half, 1.0, 1, value, shape, True)
        if square <= strain and abs(before - level) <= series.range / shape:
            sure += 1
            # 1e-12 of what the node sinks, and the rounding of a height of 10
            assert before + sunk == pytest.approx(wanted, abs=SLIGHT * (before - wanted) + 2e-14)
            assert touched == (0 if wanted == before else -1)
        contact, after, _ = met_bounded(*law, b, 1.0, half, value, shape, 0.0)
        wanted = contact_height(*law, b, half, 1.0, 2, value, shape, True)
        assert contact == pytest.approx(wanted, abs=1e-13) and after == pytest.approx(2 * wanted - before, abs=2e-13)
    assert 400 < sure < trials - 400  # both sides of the guard
    assert 0 < reach < series.range / shape  # what a block may move by before the next look at it


@pytest.mark.parametrize(("amplitude", "wanted"), [(1e-2, {True}), (0.45, {True, False}), (2.0, {False})])
def test_short_series_are_taken_where_they_are_as_exact(monkeypatch, amplitude, wanted):
    road = tr.Road(0.87 * 400, tr.Exponential(0.006, 0.1), 0.01, tr.Sine(amplitude, 2 * np.pi / 8.7))
    case, taken, found = tr.Scene(road, tr.Fleet(400, 0.1), 400 * 0.87), [], []

    def spy(*arguments):
        law, short = even_passages.passage_about(*arguments)
        taken.append(short)
        return law, short

    monkeypatch.setattr(cars_even, "passage_about", spy)
    for least in (even_passages.MANY, np.inf):
        monkeypatch.setattr(even_passages, "MANY", least)
        found.append(run(case, [0.0, case.duration], nodes=400 * 16, hold=3, relax_every=40)[-1].road_height)
    assert set(taken[: len(taken) // 2]) == wanted and not any(taken[len(taken) // 2 :])
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12)


def test_huge_pages_are_zeros_of_the_size_asked_for():
    for size in (3, 1 << 15, (1 << 15) - 1, 1 << 17, 1 << 19, (1 << 19) + 1):
        found = on_huge_pages(size)
        assert found.size == size and not found.any() and found.ctypes.data % 64 == 0


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="looks for an x86 instruction")
def test_the_stack_begins_at_a_cache_line():
    def plain():
        return 1

    def aligned():
        align_stack()
        return 1

    found = []
    for function in (plain, aligned):
        compiled = numba.njit(function)
        assert compiled() == 1
        (text,) = compiled.inspect_asm().values()
        found.append("$-64, %rsp" in text)
    assert found == [False, True]


@pytest.mark.parametrize("shape", [0.0, 1e-200, 0.3, 1e80, 1e308])
def test_any_exponent_is_the_iteration(shape):
    # far from what polynomials can do blocks are crossed by iteration; with shape 0 softness is constant
    case = scene(softness=tr.Exponential(0.02, shape), diffusivity=0.0, amplitude=1e-2 if shape < 1 else 0.0)
    found = run(case, [0.0, 20.0], nodes=64, hold=1)[-1].road_height
    numerics = cars.numerics(case, {"nodes": 64, "hold": 1})
    *_, wanted = mixed_samples(case, cars.sample_times(case, [0.0, 20.0], numerics), **numerics)
    np.testing.assert_allclose(found, wanted.road_height, rtol=0, atol=1e-13)


# by bands, of a panel for each thread and of two, and by ripples
@pytest.mark.parametrize(("count", "diffusivity"), [(4100, 0.05), (8200, 0.05), (4100, 2e-4)])
def test_threads_change_no_bit(count, diffusivity):
    case = tr.Scene(
        tr.Road(0.87 * count, 0.02, diffusivity, tr.Sine(1.5, 2 * np.pi / 8.7)), tr.Fleet(count, 0.1), 12 * 0.87
    )
    before = numba.get_num_threads()
    if before < 2:
        pytest.skip("one thread is all there is")
    roads = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        roads.append(run(case, [0.0, 12 * 0.87], nodes=count * 8, relax_every=4)[-1].road_height)
    numba.set_num_threads(before)
    for road in roads:
        np.testing.assert_array_equal(road, roads[0])


def test_compiled_sweep_is_found_again_by_another_process():
    program = (
        "import sys; sys.modules['dask'] = None\n"  # which xarray loads wherever it is
        "import traffic_road as tr; from traffic_road.models import even_kernels\n"
        "tr.simulate(tr.preset('paper'), 'cars', samples=2, nodes=64, hold=3)\n"
        "print(sum(even_kernels.sweep_even(8, 3, 0, 8, few=True).stats.cache_hits.values()))"
    )
    tr.simulate(tr.preset("paper"), "cars", samples=2, nodes=64, hold=3)  # compiles it, if that has not been done
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "1"


def test_a_last_interval_with_a_band_where_the_others_have_none(monkeypatch):
    # 4 and 8 headways smooth too far for a band, the last 2 do not: no margin was made for it
    road = tr.Road(2 * np.pi / K * 9, 0.006, 0.01, tr.Sine(1e-2, K))
    case = tr.Scene(road, tr.Fleet(72, 0.1), 100.0)
    ring = layout(72, 192)
    assert even_relaxation._weights(case, 72 * 192, ring, 2) and not even_relaxation._weights(case, 72 * 192, ring, 4)
    asked = case, case.headway_time * np.array([0.0, 20.0]), {"nodes": 72 * 192, "hold": 3, "relax_every": 8}
    *_, a = cars.samples(*asked)
    monkeypatch.setattr(even_relaxation, "_weights", lambda *interval: None)
    *_, b = cars.samples(*asked)
    np.testing.assert_allclose(a.road_height, b.road_height, atol=1e-9 * np.ptp(b.road_height), rtol=0)
