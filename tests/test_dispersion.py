"""Growth rates against polynomials and equations solved by other means."""

import numpy as np
import pytest
from scipy.optimize import fsolve

import traffic_road as tr
from traffic_road.theory import dispersion, dispersion_leading, dispersion_roots, fleet_dispersion


def cubic(k, alpha, delta, gamma, beta):
    """Coefficients in sigma of (sigma + beta + Delta k^2)(s^2 + 2 Gamma s + 1) + alpha s^2, s = sigma + ik."""
    s = np.poly1d([1, 1j * k])  # left of every product: numpy scalars do not know polynomials
    return (np.poly1d([1, beta + delta * k**2]) * (s * s + s * (2 * gamma) + 1) + s * s * alpha).coefficients


@pytest.mark.parametrize("seed", range(5))
def test_roots_solve_the_cubic(seed):
    rng = np.random.default_rng(seed)
    k, alpha, delta, gamma, beta = 10.0 ** rng.uniform([-2, -6, -6, -2, -6], [1, 0.5, 0, 0.5, 0], (40, 5)).T
    found = dispersion_roots(k, softness=alpha, diffusivity=delta, damping=gamma, hardening_rate=beta)
    for roots, *parameters in zip(found, k, alpha, delta, gamma, beta, strict=True):
        expected = np.sort_complex(np.roots(cubic(*parameters)))
        # the general root finder's own accuracy, on coefficients of very different size
        np.testing.assert_allclose(np.sort_complex(roots), expected, rtol=1e-6, atol=1e-9)
        assert np.all(np.diff(roots.real) <= 0)


def test_tiny_softness_keeps_its_digits():
    # sigma = -alpha R(ik) (1 + O(alpha)): a root 1e9 times smaller than the wavenumber
    sigma = dispersion(0.9, softness=1e-9, diffusivity=0.0, damping=0.1)
    first = dispersion_leading(0.9, softness=1e-9, diffusivity=0.0, damping=0.1)
    assert sigma == pytest.approx(first, rel=1e-6)


def test_physical_root_is_the_fastest_beyond_the_exceptional_point():
    # near k = 1 + Gamma, alpha = Gamma^2 two roots meet; followed from alpha = 0 at fixed k one would end on the slower
    gamma = 0.1
    alpha = np.linspace(1e-6, 0.05, 4001)
    roots = dispersion_roots(1.2, softness=alpha, diffusivity=0.0, damping=gamma)
    followed = [roots[0, np.argmin(np.abs(roots[0]))]]
    for step in roots[1:]:
        followed.append(step[np.argmin(np.abs(step - followed[-1]))])
    assert followed[0].real == pytest.approx(roots[0, 0].real, abs=1e-9)
    assert followed[-1].real < roots[-1, 0].real - 0.01


def test_leading_order_needs_small_softness():
    # off by +32 % at the paper's own Fig. 5 (epsilon = 0.01, t = 0), by second order in alpha elsewhere
    paper = {"softness": 0.004, "diffusivity": 0.01, "damping": 0.1, "hardening_rate": 0.01 * 0.004}
    ratio = dispersion_leading(0.9, **paper).real / dispersion(0.9, **paper).real
    assert ratio == pytest.approx(1.32, abs=0.005)
    alpha = np.geomspace(1e-5, 1e-3, 5)
    arguments = {"softness": alpha, "diffusivity": alpha, "damping": 0.1}
    error = np.abs(dispersion_leading(0.9, **arguments) - dispersion(0.9, **arguments))
    assert np.polyfit(np.log(alpha), np.log(error), 1)[0] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("headway", [0.05, 0.5, 1.5])
@pytest.mark.parametrize("beta", [0.0, 0.003])
def test_discrete_cars_solve_their_relation(headway, beta):
    k, alpha, gamma = 0.9, 0.02, 0.1
    sigma = complex(dispersion(k, softness=alpha, diffusivity=0.0, damping=gamma, hardening_rate=beta, headway=headway))

    def miss(x):
        s = complex(*x) + 1j * k
        push = beta + alpha * s**2 / (s**2 + 2 * gamma * s + 1)
        value = np.tanh(complex(*x) * headway / 2) + headway / 2 * push
        return value.real, value.imag

    expected = complex(*fsolve(miss, [0.01, -0.01], xtol=1e-12))
    assert sigma == pytest.approx(expected, rel=1e-10)


def test_discrete_form_with_diffusion_and_headway_to_zero_is_the_continuum():
    arguments = {"softness": 0.02, "diffusivity": 0.01, "damping": 0.1}
    error = [dispersion(0.9, **arguments, headway=h) - dispersion(0.9, **arguments) for h in (0.4, 0.2, 0.1)]
    assert np.log2(np.abs(error[:-1]) / np.abs(error[1:])) == pytest.approx([2.0, 2.0], abs=0.01)
    with pytest.raises(tr.SceneError, match="headway = 0"):
        dispersion(0.9, **arguments, headway=0)


def test_broadcasting():
    k = np.linspace(0.1, 2, 7)[:, None]
    arguments = {"softness": np.array([0.001, 0.01]), "diffusivity": 0.01, "damping": 0.3}
    for function, shape in ((dispersion, (7, 2)), (dispersion_leading, (7, 2)), (dispersion_roots, (7, 2, 3))):
        assert function(k, **arguments).shape == shape
    assert dispersion(k, **arguments, headway=0.3).shape == (7, 2)
    assert dispersion(0.9, **arguments)[1] == dispersion(0.9, softness=0.01, diffusivity=0.01, damping=0.3)


def test_a_fleet_of_one_kind_is_the_cubic_and_two_kinds_solve_their_relation():
    arguments = {"softness": 0.02, "diffusivity": 0.01, "hardening_rate": 0.001}
    k = np.array([0.4, 0.9])
    one = fleet_dispersion(k, tr.Fleet(7, 0.1), **arguments)
    np.testing.assert_allclose(one, dispersion(k, damping=0.1, **arguments), rtol=1e-12)
    fleet = tr.Fleet(3, damping=(0.1, 0.1, 0.4), speed=(1, 1, 1.2), frequency=(1, 1, 1.5), mass=(1, 1, 2.0))
    for wave, sigma in zip(k, fleet_dispersion(k, fleet, **arguments), strict=True):
        total = sigma + 0.001 + 0.01 * wave**2
        for share, speed, omega, gamma, mass in ((2 / 3, 1, 1, 0.1, 1), (1 / 3, 1.2, 1.5, 0.4, 2.0)):
            s = sigma + 1j * wave * speed
            total += 0.02 * share * mass * omega**2 * s**2 / (s**2 + 2 * gamma * omega * s + omega**2)
        assert abs(total) < 1e-14


ROAD = {"softness": 0.01, "diffusivity": 0.01, "damping": 0.1}
FLEET = tr.Fleet(2, 0.1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: dispersion("0.9", **ROAD), "k = '0.9': must be finite"),
        (lambda: dispersion(np.nan, **ROAD), "k = nan: must be finite"),
        (lambda: dispersion(1e300, **ROAD), r"k = 1e\+300: must be finite, at most 1e\+30 in size"),
        (lambda: dispersion(True, **ROAD), "k = True: must be finite"),
        (lambda: dispersion([1, 10**400], **ROAD), "must be finite"),
        (lambda: dispersion(0.9, **{**ROAD, "softness": -0.01}), "softness = -0.01: must be finite and >= 0"),
        (lambda: dispersion(0.9, **{**ROAD, "damping": [0.1, -1]}), "damping = -1.0: must be finite and >= 0"),
        (lambda: dispersion([1, 2], **{**ROAD, "damping": [1, 2, 3]}), r"shapes do not fit each other: k \(2,\)"),
        (lambda: dispersion(0.9, **ROAD, headway=0), "headway = 0.0: must be finite and > 0"),
        (lambda: dispersion_roots(0.9, **ROAD, hardening_rate=np.inf), "hardening_rate = inf"),
        (lambda: dispersion_leading({}, **ROAD), "k = {}: must be finite"),
        (lambda: dispersion_leading(1, **{**ROAD, "damping": 0}), "damping = 0: undamped cars resonate with k = 1"),
        (lambda: fleet_dispersion(1j, FLEET, softness=0.1, diffusivity=0.1), "k = 1j: must be finite"),
        (lambda: fleet_dispersion(1, 3, softness=0.1, diffusivity=0.1), "fleet = 3: must be a Fleet"),
        (
            lambda: fleet_dispersion(1, FLEET, softness=[0.1], diffusivity=0.1),
            "softness = .0.1.: must be a finite number",
        ),
        (
            lambda: fleet_dispersion(1, tr.Fleet(1, 0.1, frequency=1e200), softness=0.1, diffusivity=0.1),
            "fleet: its speeds, frequencies, damping or masses overflow",
        ),
    ],
)
def test_what_cannot_be_used_is_named(call, words):
    with pytest.raises(tr.SceneError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
