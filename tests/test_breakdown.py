"""Where methods fail: every limit in closed form against the spectral radius and against runs of cars on their road."""

import numpy as np
import pytest

from traffic_road.errors import StabilityError
from traffic_road.schemes.oscillator import least_response, propagator
from traffic_road.schemes.passage import PASSAGES, limit_from_before, refuse_softness
from traffic_road.schemes.relaxation import RELAXATIONS, refuse_diffusion, symbol
from traffic_road.schemes.ring import Ring, threshold
from traffic_road.schemes.steppers import STEPPERS, refuse_interval

HEADWAYS = 800  # of a run: 1 % beyond the least steep limit, forward Euler's at damping 0.3, a wave grows by e^5
GROWTH = 1e-9  # of a spectral radius over 1: rounding is below


def on_ring(A, B):
    return tuple(np.moveaxis(matrix, (-2, -1), (0, 1)) for matrix in (A, B))


def car(name, damping):
    """Rings over steps x of the car; the road relaxes well, so that the limit is the car's and not the corrugation's."""

    def rings(x):
        A, B = on_ring(*STEPPERS[name].step(x, 1.0, damping))
        factor = symbol(1.0, 8, 8)  # Delta * headway = dx^2
        return Ring(2, 4, A, B, np.full(x.shape, 3e-4), factor=factor.reshape(-1, *np.ones(x.ndim, int)))

    return rings, STEPPERS[name].limit(1.0, damping), (1e-2, 10.0)


def relaxation(name):
    """Rings over x = Delta * interval/dx^2. They are short, L = 1.6: no wave of them grows by itself."""

    def rings(x):
        A, B = (c[0].reshape(2, -1, *np.ones(x.ndim, int)) for c in propagator(0.1, 1.0, 0.1, 3))
        factor = np.stack([RELAXATIONS[name].step(d, 16, 16) for d in x.ravel()], axis=-1).reshape(9, *x.shape)
        return Ring(2, 8, A, B, np.full(x.shape, 1e-3), factor=factor)

    return rings, RELAXATIONS[name].limit(1.0), (1e-2, 1e3)


def passage(name, dx, hold, damping):
    """Rings over the softness of a passage: two cars, two nodes each, so that no wave is long beside the grid's shortest."""
    A, B = (c[0] for c in propagator(dx, 1.0, damping, hold))

    def rings(x):
        a, b = (c.reshape(2, -1, *np.ones(x.ndim, int)) for c in (A, B))
        return Ring(2, 2, a, b, x, passage=PASSAGES[name].step)

    return rings, PASSAGES[name].limit(A, B, 1.0, 1.0), (1e-2, 2e1)


CASES = {f"car, {name}, damping {damping}": (car, name, damping) for name in STEPPERS for damping in (0.3, 1.5)}
CASES |= {f"relaxation, {name}": (relaxation, name) for name in RELAXATIONS}
CASES |= {
    f"passage, {name}, dx = {dx}, hold {hold}": (passage, name, dx, hold, damping)
    for name in PASSAGES
    for dx, hold, damping in ((0.01, 1, 2.0), (0.3, 3, 2.0), (0.3, 5, 2.0))
}


@pytest.mark.parametrize("case", CASES)
def test_limit(case):
    build, *arguments = CASES[case]
    rings, limit, (low, high) = build(*arguments)
    measures = {
        "spectral radius": lambda x: rings(x).radius() > 1 + GROWTH,
        "run": lambda x: rings(x).grows(HEADWAYS),
    }
    for measure, grows in measures.items():
        found = float(threshold(grows, low, high)[0])
        print(f"{case}, {measure}: {found:.4f} for {limit:.4f}")
        if np.isinf(limit):
            assert np.isinf(found), measure
        else:
            assert abs(found / limit - 1) < 0.01, measure
            assert grows(limit * np.array([[0.98], [1.02]])).ravel().tolist() == [False, True], measure


@pytest.mark.parametrize("name", [name for name in STEPPERS if np.isfinite(STEPPERS[name].limit(1.0, 0.5))])
def test_limit_of_a_car_at_any_damping_and_frequency(name):
    damping, omega = np.geomspace(1e-3, 1e2, 201), 2.5
    limit = STEPPERS[name].limit(omega, damping)
    for share, stable in (
        (0.01, True),
        (0.5, True),
        (0.9, True),
        (0.9999, True),
        (1.0001, False),
        (1.1, False),
        (3, False),
    ):
        A, _ = STEPPERS[name].step(share * limit, omega, damping)
        assert np.all((np.abs(np.linalg.eigvals(A)).max(axis=-1) < 1) == stable), share


# ---- methods without a limit: what is left of a short wave, or of a stiff car, after one long step


@pytest.mark.parametrize(
    ("name", "left"),
    [("trapezoid", -1.0), *((name, 0.0) for name in STEPPERS if name.startswith("exact"))],
)
def test_long_steps_of_a_car_without_limit(name, left):
    A, _ = STEPPERS[name].step(1e6, 1.0, 0.3)
    assert np.linalg.eigvals(A[0]) == pytest.approx(left, abs=1e-5)  # trapezoid: 1 + 4 Gamma/step


@pytest.mark.parametrize(("name", "left"), [("Crank-Nicolson", -1.0), ("backward Euler", 0.0), ("exact", 0.0)])
def test_long_steps_of_a_relaxation_without_limit(name, left):
    assert RELAXATIONS[name].step(1e6, 16, 16)[-1] == pytest.approx(left, abs=2e-6)  # CN: -1 + 1e-6


def test_soft_roads_without_limit():
    # the passage (1 - delta/2)/(1 + delta/2): the bumps of a road with delta > 2 invert, but never grow
    for delta, left in ((2.0, 0.0), (1e6, -1.0)):
        _, after = PASSAGES["midpoint"].step(1.0, 0.0, 0.0, delta, 1.0, weight=0.0)
        assert after == pytest.approx(left, abs=1e-5)


@pytest.mark.parametrize(("name", "rings"), [("Crank-Nicolson", True), ("backward Euler", False), ("exact", False)])
def test_cars_feel_the_ringing(name, rings):
    # Delta * interval = 100 dx^2: after 20 headways a rough road should be level; the compression of the cars tells
    whole = relaxation(name)[0](np.array([100.0]))
    road = np.random.default_rng(1).standard_normal((2, 8, 1))
    road -= road.mean()
    state = np.zeros((5, 2, 1))
    shortest = []
    for _ in range(20):
        road, state = whole.headway(road, state, weight=0.0)
        shortest.append(float((road.ravel() * (-1.0) ** np.arange(16)).mean()))
    alternates = np.sign(shortest[1:]) == -np.sign(shortest[:-1])
    assert (alternates.all() and abs(shortest[-1]) > 0.5 * abs(shortest[0])) == rings
    if not rings:
        assert abs(shortest[-1]) < 1e-4


# ---- limits that are not the method's alone


@pytest.mark.parametrize(("headway", "count"), [(0.3, 1), (1.0, 1), (2.0, 1), (4.0, 1), (0.3, 2), (1.0, 2)])
def test_force_from_before_lets_long_waves_grow_earlier(headway, count):
    # on the road of N cars: delta = 2 (1 - 1/k^2) of the longest wave k > 1 with k l = pi + 2 atan(2 Gamma k/(k^2 - 1))
    # + 2 pi n/N, from |1 - delta R(ik)| = 1 and exp(ikl) = its phase
    damping, rows = 0.1, max(16, round(headway / 0.05))
    A, B = (c[0].reshape(2, -1, 1, 1) for c in propagator(headway / rows, 1.0, damping, 5))
    k = np.linspace(1.0 + 1e-6, 40 / headway, 400_001)
    phase = (k * headway - np.pi - 2 * np.arctan2(2 * damping * k, k**2 - 1)) * count / (2 * np.pi)
    longest = k[1:][np.diff(np.floor(phase)) > 0][0]
    limit = 2 * (1 - 1 / longest**2)
    found = threshold(
        lambda x: Ring(count, rows, A, B, x, passage=PASSAGES["force from before"].step).radius() > 1 + GROWTH,
        1e-2,
        1e1,
    )
    assert found == pytest.approx(limit, rel=0.01)
    grid = propagator(headway / rows, 1.0, damping, 5)
    turn = np.exp(1j * longest * headway / rows)
    assert limit_from_before(grid[0][0], grid[1][0], 1.0, 1.0, turn) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize(("damping", "headway"), [(2.0, 0.6), (0.3, 0.2), (0.3, 1.0)])
def test_inverted_bumps_look_long_to_the_cars(damping, headway):
    # the midpoint has no limit of its own, but on a soft road bumps invert at each passage, and a wave of two headways
    # then looks level to a car: at delta = 4 Gamma cot(l/2) it is at resonance, as tanh(sigma l/2) = -(alpha l/2) R says
    rows = 12
    A, B = (c[0].reshape(2, -1, 1, 1) for c in propagator(headway / rows, 1.0, damping, 5))
    found = threshold(lambda x: Ring(2, rows, A, B, x).radius() > 1 + GROWTH, 1e-1, 1e2)
    assert found == pytest.approx(4 * damping / np.tan(headway / 2), rel=0.01)


@pytest.mark.parametrize("damping", [0.1, 0.15])
def test_forward_euler_corrugates_a_stable_road_inside_its_limit(damping):
    # it steps a car as if its damping were Gamma - dt/2: no wave grows while alpha/Delta < 4 Gamma (1 - Gamma) of that
    softness, count, rows = 1e-3, 4, 12
    left = 0.55 * damping
    length = 2 * np.pi / np.sqrt(1 - 2 * left)  # the first wave to grow
    while length / (count * rows) > 2 * (damping - left):
        rows += 1
    dx = length / (count * rows)
    left = damping - dx / 2
    headway, nodes = length / count, count * rows

    def limit(stepper):
        A, B = (c[0][..., None, None] for c in stepper(dx, 1.0, damping))

        def grows(x):  # over alpha/Delta
            factor = np.stack([symbol(softness / r * headway, length, nodes) for r in x.ravel()], axis=-1)[..., None]
            return Ring(count, rows, A, B, np.full(x.shape, softness * headway), factor=factor).radius() > 1 + 1e-8

        return threshold(grows, 0.02, 2.0, ways=16)[0]  # within 0.9 %

    assert limit(STEPPERS["forward Euler"].step) == pytest.approx(4 * left * (1 - left), rel=0.05)  # dt^2 beside dt
    assert limit(STEPPERS["exact, linear hold"].step) > 1.5 * 4 * left * (1 - left)
    assert limit(STEPPERS["trapezoid"].step) > 1.5 * 4 * left * (1 - left)


@pytest.mark.parametrize(("hold", "damping"), [(1, 0.1), (1, 0.3), (3, 0.02), (3, 0.1)])
def test_exact_cars_on_a_coarse_grid_lift_its_shortest_wave(hold, damping):
    # beside passages the exact propagator, too, has a limit: the grid on which the discrete car pulls a wave up
    def grows(x):
        A, B = on_ring(*propagator(x, 1.0, damping, hold))
        return Ring(2, 1, A, B, np.full(x.shape, 1e-3)).radius() > 1 + GROWTH

    def lifts(x):
        return least_response(*propagator(x, 1.0, damping, hold), x) < 0

    found = threshold(grows, 0.3, 10.0, ways=32)
    assert found == pytest.approx(threshold(lifts, 0.3, 10.0, ways=32), rel=0.01)
    assert found > 3


# ---- refusals


def test_refusals_name_limit_and_remedy():
    A, B = (c[0] for c in propagator(0.01, 1.0, 0.1, 1))
    cases = [
        (refuse_interval, ("RK4", 0.9, 4.0, 0.1), "stable up to 0.7377"),
        (refuse_interval, ("forward Euler", np.nan, 1.0, 0.1), "stable up to 0.2"),
        (refuse_diffusion, ("explicit", 0.6, 1.0), "stable up to 0.5"),
        (refuse_softness, ("force from before", 2.1, A, B, 1.0, 1.0), "stable up to 2"),
    ]
    for refuse, arguments, message in cases:
        with pytest.raises(StabilityError, match=message) as error:
            refuse(*arguments)
        assert "; " in str(error.value) and "\n" not in str(error.value)
    refuse_interval("trapezoid", 1e9, 1.0, 0.1)
    refuse_interval("RK4", 0.6, 4.0, 0.1)
    refuse_diffusion("explicit", 0.5, 1.0)
    refuse_softness("midpoint", 1e9, A, B, 1.0, 1.0)
