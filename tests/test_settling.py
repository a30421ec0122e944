"""The settling road against its closed forms, another integrator, and the growth of a perturbation on it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from traffic_road.errors import SceneError
from traffic_road.laws import Bounded, Constant, Exponential
from traffic_road.theory.settling import algebraic_exponent, settle

LAWS = [Constant(0.01), Exponential(0.02, 0.5), Bounded(0.02, 2.0)]


def test_constant_softness_sinks_steadily_exactly():
    times = np.array([0.0, 1.0, 10.0, 500.0])
    full, closed = settle(0.01, 0.2, times), settle(0.01, 0.2, times, full=False)
    np.testing.assert_allclose(closed.road_height, -0.01 * times, rtol=1e-15)
    for name in ("road_height", "car_height"):  # the settled start has no transient; some hundred steps of rounding
        np.testing.assert_allclose(full[name], closed[name], rtol=1e-13, atol=1e-15)
    assert (full.hardening_rate == 0).all() and (full.softness == 0.01).all()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("height", [0.0, -0.7, 0.4])
def test_closed_forms_solve_the_small_softness_equation(law, height):
    times = np.linspace(0, 300, 31)
    ds = settle(law, 0.2, times, height=height, full=False)
    solved = solve_ivp(lambda _, h: -law(h), (0, 300), [height], method="Radau", t_eval=times, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(ds.road_height, solved.y[0], atol=1e-8)  # the tolerance of Radau, a hundredfold
    assert ds.road_height[0] == height
    np.testing.assert_array_equal(ds.car_height, ds.road_height)
    np.testing.assert_allclose(ds.hardening_rate, law.derivative(ds.road_height.values))


def test_closed_form_of_the_paper():
    times = np.linspace(0, 5000, 11)
    ds = settle(Exponential(0.004, 0.5), 0.1, times, full=False)
    start = 1 / (0.5 * 0.004)
    np.testing.assert_allclose(ds.softness, 1 / (0.5 * (times + start)), rtol=1e-13)  # Eq. (21), through log and exp
    np.testing.assert_allclose(ds.hardening_rate, 1 / (times + start), rtol=1e-13)  # Eq. (22)


def test_closed_form_limits():
    times = np.array([0.0, 3.0, 1e6])
    plain = settle(Exponential(0.02, 0.0), 0.2, times, full=False)
    np.testing.assert_allclose(plain.road_height, -0.02 * times)
    deep = settle(Bounded(0.02, 2.0), 0.2, times, full=False)
    assert deep.road_height[-1] == -2 and deep.softness[-1] == 0
    below = settle(Bounded(0.02, 2.0), 0.2, times, height=-3.0, full=False)
    assert (below.road_height == -3).all()  # harder than hard: it stays


@pytest.mark.parametrize("law", LAWS[1:], ids=lambda law: type(law).__name__)
def test_full_settling_solves_the_equations(law):
    """Z and dZ/dt as unknowns, another integrator: Eqs. (7) and (8) as the paper writes them."""
    damping, times = 0.2, np.linspace(0, 100, 21)

    def rates(_, y):
        road, car, speed = y
        sink = -law(road) * max(0.0, 1 + road - car)
        return [sink, speed, -2 * damping * (speed - sink) - (car - road)]

    start = [0.3, 0.3, -float(law(0.3))]
    solved = solve_ivp(rates, (0, 100), start, method="Radau", t_eval=times, rtol=1e-10, atol=1e-13).y
    ds = settle(law, damping, times, height=0.3)
    np.testing.assert_allclose(ds.road_height, solved[0], atol=1e-8)  # the tolerance of Radau, a hundredfold
    np.testing.assert_allclose(ds.car_height - ds.road_height, solved[1] - solved[0], atol=1e-8)


def test_hardening_rate_is_the_logarithmic_derivative_of_softness():
    step = 1e-3
    for law in LAWS[1:]:
        for time in (0.5, 20.0):
            ds = settle(law, 0.2, [time - step, time, time + step])
            slope = -np.log(ds.softness[2] / ds.softness[0]) / (2 * step)
            assert ds.hardening_rate[1] == pytest.approx(slope.item(), rel=1e-8)  # Eq. (12); step^2, and 1e-13/step


def test_small_softness_error_scales_as_hardening_times_softness_squared():
    """With u = exp(-eps H), du/dt = eps alpha0 (1 + eps alpha^2): alpha is too large by eps alpha0^2 (u-1)/u^2."""

    def error(softness, hardening):
        law, times = Exponential(softness, hardening), np.linspace(0, 2 / (hardening * softness), 41)
        full, closed = settle(law, 0.3, times), settle(law, 0.3, times, full=False)
        assert closed.softness[-1] == pytest.approx(softness / 3)
        return np.max(np.abs(full.softness / closed.softness - 1)).item()

    softness = np.array([0.02, 0.01, 0.005])
    errors = [error(value, 0.25) for value in softness]
    # widths: the next order, eps alpha0, is half a per cent
    assert np.polyfit(np.log(softness), np.log(errors), 1)[0] == pytest.approx(2, abs=0.01)
    hardening = np.array([0.5, 0.25, 0.125])
    assert np.polyfit(np.log(hardening), np.log([error(0.01, e) for e in hardening]), 1)[0] == pytest.approx(
        1, abs=0.01
    )
    assert errors[-1] / (0.25 * 0.005**2) == pytest.approx(0.25, rel=0.01)


def test_strong_settling_lifts_the_car():
    # a soft road that hardens at once drops away under the car, which bounces: the force is clipped in between
    law = Exponential(5.0, 8.0)
    ds = settle(law, 0.05, np.linspace(0, 200, 2001))
    force = 1 + ds.road_height - ds.car_height
    assert force.min() < -0.1 and abs(force[-1] - 1) < 0.02  # exp(-0.05 * 200) = 5e-5 of a swing of a few
    assert (np.diff(ds.road_height) <= 1e-12).all()  # never pulled up; tolerance of the integrator
    airborne = force.values < 0
    still = airborne[1:] & airborne[:-1]
    assert np.ptp(np.diff(ds.road_height)[still]) < 1e-12 and (ds.hardening_rate.values[airborne] == 0).all()


@pytest.mark.parametrize(("k", "damping", "diffusivity"), [(0.75, 0.3, 0.5), (0.6, 0.7, 0.2), (1.1, 0.3, 0.5)])
def test_algebraic_exponent_of_a_perturbation_on_the_settling_road(k, damping, diffusivity):
    """Eqs. (10)-(11) with alpha, beta, Delta of Eqs. (21)-(22), integrated in time: error linear in alpha."""
    hardening, ratio = 0.5, diffusivity
    exponent = algebraic_exponent(k, softness=0.006, diffusivity=0.006 * ratio, damping=damping, hardening=hardening)

    def rates(t, y):
        h, z, p = y
        alpha = 1 / (hardening * t)
        lift = z - h
        road = -(ratio * alpha * k**2 + hardening * alpha) * h + alpha * lift
        return [road, p - 2 * damping * lift - 1j * k * z, -lift - 1j * k * p]

    def measured(start):
        solved = solve_ivp(
            rates, (start, 4 * start), [1 + 0j, 0, 0], method="DOP853", rtol=1e-9, atol=1e-12, dense_output=True
        )
        h = np.abs(solved.sol(np.array([2 * start, 4 * start]))[0])
        return np.log(h[1] / h[0]) / np.log(2)

    starts = np.array([500.0, 2000.0])
    errors = np.abs([measured(start) - exponent for start in starts])
    assert errors[1] < 0.01 * (1 + abs(exponent))  # alpha/Gamma^2 = 0.6 % at time 4000
    assert np.log(errors[0] / errors[1]) / np.log(4) == pytest.approx(1, abs=0.15)


def test_algebraic_exponent_by_hand():
    # k = 1: F = 0
    assert algebraic_exponent(1.0, softness=0.5, diffusivity=0.25, damping=0.3, hardening=0.5) == -2.0
    wide = algebraic_exponent([0.5, 0.8], softness=0.006, diffusivity=0.01, damping=[[0.1], [0.2]], hardening=0.01)
    assert wide.shape == (2, 2) and (wide[0] > wide[1]).all()


def test_dataset_and_errors():
    ds = settle(LAWS[1], 0.1, [0.0])
    assert ds.sizes == {"time": 1} and ds.road_height[0] == 0
    assert all(v.attrs["units"] == "1" and v.attrs["long_name"] for v in ds.variables.values())
    for times in ([1.0, 0.5], [-1.0, 1.0], [[0.0]], []):
        with pytest.raises(SceneError, match="times"):
            settle(0.01, 0.1, times)
    with pytest.raises(SceneError, match="damping = 0"):
        settle(0.01, 0, [1.0])
    with pytest.raises(SceneError, match="law"):
        settle(-1, 0.1, [1.0])
    with pytest.raises(SceneError, match="hardening = 0"):
        algebraic_exponent(0.9, softness=0.006, diffusivity=0.01, damping=0.1, hardening=0)
