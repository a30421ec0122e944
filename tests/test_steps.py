"""The longest step of the continuum: from its closed form, on the step's matrix, and on runs of bouncing cars."""

import warnings

import numpy as np
import pytest
from scipy.linalg import expm

import traffic_road as tr
from traffic_road.models import continuum
from traffic_road.models.continuum_state import Continuum
from traffic_road.schemes.exponential import amplification, doubled, exact, exponentials, step_limit

K, NODES = 0.9, 32
SCENES = [  # damping, softness, diffusivity, factor of the limit by which roads blow up: harmonics move it
    (0.1, 0.006, 0.01, 1.25),
    (0.1, 0.004, 0.01, 1.02),
    (0.05, 0.002, 0.01, 1.02),
    (0.05, 0.003, 0.02, 1.15),
]


@pytest.mark.parametrize("norm", [1e-6, 0.03, 1.0, 30.0, 1e3])
def test_maps_of_a_step_are_those_of_the_augmented_matrix(norm):
    # by scipy's matrix exponential (Al-Mohy and Higham), of systems in no order and of norms that differ by 1e4
    rng = np.random.default_rng(1)
    system = rng.normal(size=(5, 3, 3)) + 1j * rng.normal(size=(5, 3, 3))
    system -= 3.0 * np.eye(3)  # decaying: no entry of the exponential is lost beside another
    system *= norm * np.array([1.0, 1e-4, 0.5, 1e-2, 1.0])[:, None, None]
    source, step = np.array([1.0, -1.0, 0.3]), 0.7
    augmented = np.zeros((5, 6, 6), dtype=complex)
    augmented[:, :3, :3], augmented[:, :3, 3] = step * system, step * source
    augmented[:, 3, 4] = augmented[:, 4, 5] = 1.0
    right = expm(augmented)[:, :3].transpose(1, 2, 0)
    off = np.abs(exact(system, source, step) - right).max(axis=(0, 1)) / np.abs(right).max(axis=(0, 1))
    twice = np.abs(doubled(exact(system, source, step / 2)) - right).max(axis=(0, 1)) / np.abs(right).max(axis=(0, 1))
    alone = np.abs(exponentials(step * system) - expm(step * system)).max()
    # rounding of a norm of up to 12 times as much, of which the systems after the largest have their share
    assert max(off.max(), twice.max(), alone) < 50 * np.finfo(float).eps * max(1.0, 12 * norm)


def scene(damping, softness, diffusivity, amplitude=1e3, duration=1e5):
    return tr.Scene(
        tr.Road(2 * np.pi / K, softness, diffusivity, tr.Sine(amplitude, K)), tr.Fleet(8, damping), duration
    )


def limit(case):
    return continuum.longest_step(case, {"nodes": NODES, "step": 1e5})


@pytest.mark.parametrize(("damping", "softness", "diffusivity", "factor"), SCENES)
def test_high_waves_decay_inside_the_limit_and_grow_beyond(damping, softness, diffusivity, factor):
    case = scene(damping, softness, diffusivity)
    longest = limit(case)

    def size(step):
        road = Continuum(case, NODES)
        road.renew(step)
        road.advance(step, 2000)
        return np.abs(road.state[0, 1:]).max()

    assert size(0.98 * longest) < 20  # of 1000, with cars in contact at the end
    assert not size(factor * longest) < 1e6


@pytest.mark.parametrize(
    ("damping", "softness", "diffusivity"),
    [(0.3, 0.05, 0.01), (0.1, 0.02, 0.01), (0.1, 0.006, 0.001), (0.05, 0.003, 0.005)],
)
def test_growth_beyond_saturation_is_that_of_the_equations_inside_the_limit_and_twice_it_beyond(
    damping, softness, diffusivity
):
    case = scene(damping, softness, diffusivity)
    longest = limit(case)

    def rate(step):
        road, steps = Continuum(case, NODES), int(1000 / step)
        road.renew(step)
        size = []
        for _ in range(2):
            road.advance(step, steps)
            size.append(abs(road.state[0, 1]))
        return np.log(size[1] / size[0]) / (steps * step)

    assert rate(0.8 * longest) < 2 * rate(1.0) < rate(1.1 * longest)


def test_the_limit_is_where_the_matrix_of_a_step_grows():
    case = scene(*SCENES[0][:3])
    system, source = continuum.start(case, NODES).linear
    row = np.zeros(system.shape[:2], dtype=complex)
    row[:, 1] = -0.5 * system[:, 0, 1]
    longest = step_limit(system, source, row, 1e4)
    assert longest == pytest.approx(limit(case), rel=1e-12)

    def radius(step):
        return np.abs(np.linalg.eigvals(amplification(system, source, row, step))).max()

    assert radius(0.98 * longest) <= 1 + 1e-9 < 1.001 < radius(1.02 * longest)


def test_the_matrix_of_a_step_is_the_equation_to_order_4():
    system, source = continuum.start(scene(*SCENES[0][:3]), NODES).linear
    row = np.zeros(system.shape[:2], dtype=complex)
    row[:, 1] = -0.5 * system[:, 0, 1]
    steps = 1.0 / 2 ** np.arange(5)
    wanted = system[:3] + source[:, None] * row[:3, None, :]
    errors = []
    for step in steps:
        true = exact(wanted, source, step)[:, :3].transpose(2, 0, 1)
        errors.append(np.abs(amplification(system[:3], source, row[:3], step) - true).max())
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(5.0, abs=0.15)  # of one step


def test_a_step_that_drives_growth_beyond_saturation_is_refused():
    case = scene(0.3, 0.05, 0.01, amplitude=1.5, duration=16000.0)  # 1.14 times the saturation limit
    for step in (100.0, 1000.0):
        with pytest.raises(tr.StabilityError, match=r"blows up from 98\.\d+ on"):
            tr.simulate(case, "continuum", samples=3, nodes=NODES, step=step)


def test_a_step_beyond_it_is_refused_and_may_be_studied():
    case = scene(0.1, 0.004, 0.01, amplitude=2.0, duration=5000.0)
    longest = limit(case)
    assert tr.simulate(case, "continuum", samples=3, nodes=NODES, step=0.99 * longest).status == "ok"
    with pytest.raises(tr.StabilityError, match=rf"step = .*blows up from {longest:.4g} on; use a shorter step"):
        tr.simulate(case, "continuum", samples=3, nodes=NODES, step=1.01 * longest)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ds = tr.simulate(case, "continuum", samples=3, nodes=NODES, step=1.01 * longest, allow_unstable=True)
    assert ds.error_estimate == np.inf and "outside a stability limit" in ds.error_method


def test_no_limit_where_nothing_is_clipped():
    low = scene(0.1, 0.004, 0.01, amplitude=1e-3, duration=100.0)
    assert limit(low) == np.inf
    high = scene(0.1, 0.004, 0.01)
    assert limit(tr.Scene(high.road, high.fleet, high.duration, lift_off=False)) == np.inf
    assert continuum.longest_step(high, {"nodes": NODES, "step": 1.0}) == np.inf
