"""Neutral curve, stability boundary and fastest mode against roots of the cubic, dense scans and exact rationals."""

from fractions import Fraction

import numpy as np
import pytest

from traffic_road.errors import SceneError
from traffic_road.scales import Scales
from traffic_road.theory import stability as st

DAMPINGS = [0.05, 0.1, 0.3, 0.45, 0.5, 0.55, 0.7, 0.9, 0.95]


def cubic_sigma(k, softness, diffusivity, damping, rate=0.0):
    """The fastest root of Eq. (15)."""
    total = rate + diffusivity * k**2 - 1j * k
    s = np.roots([1, 2 * damping + total + softness, 1 + 2 * damping * total, total])
    return s[np.argmax(s.real)] - 1j * k


def growth(k, ratio, damping):
    """Re sigma / alpha of Eq. (16) without hardening, by complex arithmetic."""
    s = 1j * np.asarray(k)
    return (-ratio * k**2 - s**2 / (s**2 + 2 * damping * s + 1)).real


def golden(function, low, high):
    """Maximum of a unimodal function, by golden section."""
    shrink = (np.sqrt(5) - 1) / 2
    for _ in range(80):
        a, b = high - shrink * (high - low), low + shrink * (high - low)
        low, high = (low, b) if function(a) > function(b) else (a, high)
    return 0.5 * (low + high)


def exact_slope(k, damping):
    """F'(k^2) in rational arithmetic: no rounding at all."""
    q, g = Fraction(float(k)) ** 2, 4 * Fraction(damping) ** 2
    return ((1 - q) ** 2 - g * q**2) / ((1 - q) ** 2 + g * q) ** 2


def test_neutral_softness_zeroes_the_cubic_and_growth_changes_sign_there():
    rng = np.random.default_rng(np.random.SeedSequence(1))
    k, diffusivity, damping = 10 ** rng.uniform([[-2], [-5], [-2]], [[1], [1], [0.5]], (3, 300))
    rate = np.where(np.arange(300) % 2, 0.0, 10 ** rng.uniform(-5, 0.5, 300))
    softness = st.neutral_softness(k, diffusivity=diffusivity, damping=damping, hardening_rate=rate)
    for case in zip(k, softness, diffusivity, damping, rate, strict=True):
        k_, a, *rest = case
        # np.roots is good to a few eps times the largest root, which is of order 1 + k + Delta k^2
        assert abs(cubic_sigma(*case).real) < 1e-14 * (1 + k_ + rest[0] * k_**2)
        assert cubic_sigma(k_, a * (1 - 1e-4), *rest).real < 0 < cubic_sigma(k_, a * (1 + 1e-4), *rest).real


def test_neutral_softness_is_the_only_one():
    for k, damping in [(0.3, 0.8), (0.9, 0.1), (1.0, 0.1), (1.3, 0.1), (3.0, 0.02)]:
        a = st.neutral_softness(k, diffusivity=0.01, damping=damping)
        for factor in np.geomspace(1e-4, 1e4, 161):  # an odd count: the middle is the neutral one itself
            if abs(factor - 1) > 1e-6:
                assert np.sign(cubic_sigma(k, a * factor, 0.01, damping).real) == np.sign(factor - 1)


def test_neutral_softness_to_rounding_in_rationals():
    # with s = i kappa, the two parts of the cubic: kappa by bisection, then alpha
    for k, diffusivity, damping in [(0.5, 1e-9, 0.3), (0.999, 1e-3, 0.01), (1.0, 1e-6, 0.1), (2.0, 5.0, 1.5)]:
        a = Fraction(float(st.neutral_softness(k, diffusivity=diffusivity, damping=damping)))
        k, damping = Fraction(k), Fraction(damping)
        total = Fraction(diffusivity) * k**2
        low, high = Fraction(0), min(k, Fraction(1))
        for _ in range(120):  # bisection, rounded to 150 bits
            middle = Fraction(int((low + high) / 2 * 2**150), 2**150)
            inside = (k - middle) * (1 - middle**2) > 2 * damping * total * middle
            low, high = (middle, high) if inside else (low, middle)
        exact = total * (1 - low**2) / low**2 + 2 * damping * (k - low) / low
        assert abs(a / exact - 1) < 2e-15  # about ten roundings


def test_neutral_softness_limits():
    assert st.neutral_softness(0.8, diffusivity=0, damping=0.3) == 0
    assert st.neutral_softness(1.0, diffusivity=0, damping=0.3) < 1e-30
    assert st.neutral_softness(2.0, diffusivity=0, damping=0.3) == pytest.approx(0.6, rel=1e-15)  # 2 Gamma (k - 1)
    assert st.neutral_softness(0.0, diffusivity=0.1, damping=0.3, hardening_rate=0.1) == np.inf
    assert np.isnan(st.neutral_softness(0.0, diffusivity=0.1, damping=0.3))
    k = np.array([0.2, 0.9, 1.4])
    same = st.neutral_softness(k[:, None], diffusivity=0.01, damping=[0.1, 0.5])
    assert same.shape == (3, 2)
    np.testing.assert_array_equal(same, st.neutral_softness(-k[:, None], diffusivity=0.01, damping=[0.1, 0.5]))


def test_neutral_softness_tends_to_leading_order_linearly():
    scale = np.geomspace(1e-5, 1e-3, 5)
    exact = st.neutral_softness(0.85, diffusivity=scale, damping=0.2)
    error = np.abs(exact / (scale * 0.85**2 / st.gain(0.85, 0.2)) - 1)
    assert np.polyfit(np.log(scale), np.log(error), 1)[0] == pytest.approx(
        1, abs=0.05
    )  # curvature: Delta/Gamma^2 = 2 %


@pytest.mark.parametrize("damping", DAMPINGS)
def test_boundary_ends(damping):
    ds = st.stability_boundary(damping)
    start = 1 / (4 * damping * (1 - damping)) if damping < 0.5 else 1.0
    assert ds.hardening_rate[0] == 0 and ds.diffusivity[-1] == 0
    assert abs(ds.diffusivity[0] - start) < 1e-12
    assert abs(ds.hardening_rate[-1] - 1 / (4 * damping * (1 + damping))) < 1e-12
    assert abs(ds.k[0] ** 2 - max(0, 1 - 2 * damping)) < 1e-12
    assert abs(ds.k[-1] ** 2 - 1 / (1 + 2 * damping)) < 1e-12
    assert ds.sizes == {"k": 401} and all(
        v.attrs["units"] == "1" and v.attrs["long_name"] for v in ds.variables.values()
    )


@pytest.mark.parametrize("damping", DAMPINGS)
def test_boundary_is_where_the_global_maximum_is_zero(damping):
    ds = st.stability_boundary(damping, points=41)
    assert (ds.diffusivity >= 0).all() and (ds.hardening_rate >= 0).all()
    k = np.concatenate([np.linspace(0, 2, 4001), np.geomspace(2, 1e3, 200)])
    for row in ds.to_dataframe().reset_index().itertuples():
        # rounding of F, which is of order 1/(4 Gamma) and as steep as 1/Gamma^2 near k = 1
        assert abs(growth(row.k, row.diffusivity, damping) - row.hardening_rate) < 1e-13 / damping**2
        assert np.max(growth(k, row.diffusivity, damping)) < row.hardening_rate + 1e-13 / damping**2
    # the boundary is the envelope of lines of slope -k^2
    fine = st.stability_boundary(damping)
    slope = np.diff(fine.hardening_rate) / np.diff(fine.diffusivity)
    middle = ((fine.k.values[1:] + fine.k.values[:-1]) / 2) ** 2
    np.testing.assert_allclose(slope, -middle, atol=1e-4)  # O(step^2), step of q < 1/200


@pytest.mark.parametrize("damping", [0.55, 0.7, 0.95])
def test_boundary_is_tangent_to_the_diffusivity_axis(damping):
    ds = st.stability_boundary(damping, points=2001).isel(k=slice(5, 20))
    curvature = ds.hardening_rate / (1 - ds.diffusivity) ** 2
    # q < 1e-4 here: the next term of the expansion, a few q/(4 Gamma^2 - 1), is below 1 %
    np.testing.assert_allclose(curvature, 1 / (4 * (4 * damping**2 - 1)), rtol=0.01)


def test_boundary_at_half_is_tangent_more_weakly():
    ds = st.stability_boundary(0.5, points=2001).isel(k=slice(100, 200))
    np.testing.assert_allclose(
        ds.hardening_rate, 2 * ((1 - ds.diffusivity) / 3) ** 1.5, rtol=0.02
    )  # next term O(q), q < 0.005


def test_small_damping_line():
    """beta(1+Gamma) + Delta(1-Gamma) = alpha/4Gamma holds to Gamma^2/2; the paper's Delta + beta only to Gamma."""
    dampings = np.geomspace(0.005, 0.08, 7)
    better, paper = [], []
    for damping in dampings:
        ds = st.stability_boundary(damping)
        line = ds.hardening_rate * (1 + damping) + ds.diffusivity * (1 - damping)
        better.append(np.max(np.abs(4 * damping * line - 1)))
        paper.append(np.max(np.abs(4 * damping * (ds.hardening_rate + ds.diffusivity) - 1)))
    # widths: the next orders at the largest damping
    assert np.polyfit(np.log(dampings), np.log(better), 1)[0] == pytest.approx(2, abs=0.01)
    assert np.polyfit(np.log(dampings), np.log(paper), 1)[0] == pytest.approx(1, abs=0.05)
    assert better[0] / dampings[0] ** 2 == pytest.approx(0.5, abs=1e-3)


def test_critical_ratio_lies_on_the_boundary():
    for damping in DAMPINGS:
        ds = st.stability_boundary(damping, points=33)
        ratio = st.critical_ratio(damping, ds.hardening_rate.values)
        # slope k^2 amplifies the rounding of the hardening rate near small k; values are of order 1/(4 Gamma)
        np.testing.assert_allclose(ratio, ds.diffusivity, rtol=0, atol=1e-11 / damping)
    assert st.critical_ratio(0.2) == 1 / (4 * 0.2 * (1 - 0.2)) and st.critical_ratio(0.8) == 1
    assert st.critical_ratio(0.2, 1.05) == 0 and st.critical_ratio(0.2, 1.03) > 0  # end at 1/(4*0.2*1.2) = 1.0417


@pytest.mark.parametrize("damping", [0.02, *DAMPINGS, 1.5])
def test_fastest_mode_against_scan(damping):
    grid = np.linspace(0, 3, 30001)
    end = 1 / (4 * min(damping, 0.5) * (1 - min(damping, 0.5)))
    for ratio in end * np.array([0, 0.01, 0.2, 0.5, 0.8, 0.95, 0.999, 1.001, 1.5]):
        k = st.fastest_mode(ratio, damping)
        i = np.argmax(growth(grid, ratio, damping))
        found = golden(lambda x, r=ratio: growth(x, r, damping), grid[max(i - 1, 0)], grid[i + 1]) if i else 0.0
        # golden section sees only half the digits of a flat top; the tops near (Gamma = 1/2, ratio 1) are flatter still
        assert k == pytest.approx(found, abs=2e-6)


def test_fastest_mode_to_rounding_in_rationals():
    for damping in [0.02, 0.3, 0.5, 0.7, 1.5]:
        end = 1 / (4 * min(damping, 0.5) * (1 - min(damping, 0.5)))
        for ratio in (end * (1 - np.geomspace(1, 1e-6, 7))).tolist():
            k, width = float(st.fastest_mode(ratio, damping)), Fraction(1, 10**14)  # measured: 6e-15
            assert exact_slope(Fraction(k) * (1 - width), damping) > Fraction(ratio)
            assert exact_slope(Fraction(k) * (1 + width), damping) < Fraction(ratio)


def test_fastest_mode_discards_other_roots_of_the_papers_equation():
    damping, ratio = 0.3, 0.01
    q = np.polynomial.Polynomial([0, 1])
    equation = (1 - q) ** 2 - 4 * damping**2 * q**2 - ratio * ((1 - q) ** 2 + 4 * damping**2 * q) ** 2
    roots = equation.roots()
    roots = np.sqrt(roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real)
    beyond = roots[roots > 1]
    assert len(beyond) == 2  # a minimum, and a maximum that decays
    step = 1e-3
    tops = [k for k in beyond if growth(k, ratio, damping) > max(growth(k + np.array([-step, step]), ratio, damping))]
    assert len(tops) == 1 and growth(tops[0], ratio, damping) < -1
    assert st.fastest_mode(ratio, damping) == pytest.approx(
        roots[roots < 1].item(), abs=1e-10
    )  # conditioning of the roots
    assert growth(st.fastest_mode(ratio, damping), ratio, damping) > 0


@pytest.mark.parametrize("k", [0.1, 0.4, 0.7, 0.95])
def test_jump_across_the_dotted_curve(k):
    ratio, damping = st.jump_ratio(k), (1 - k**2) / 2
    assert growth(k, ratio, damping) == pytest.approx(0, abs=1e-13 / damping**2)  # as high as k = 0; rounding of F
    below, above = st.fastest_mode(ratio * (1 + 1e-9 * np.array([-1, 1])), damping)
    assert below == pytest.approx(k, abs=1e-6)  # 1e-9 over the slope of the maximum's position, 2e-3 k^3 at least
    assert above == 0


def interior_maxima(ratio, damping):
    k = np.linspace(1e-3, 0.999, 200001)
    return np.sum(np.diff(np.sign(np.diff(growth(k, ratio, damping)))) < 0)


@pytest.mark.parametrize("k", [0.3, 0.6, 0.9])
def test_local_maximum_vanishes_on_the_dashed_curve(k):
    ratio, damping = st.merging_ratio(k), (1 - k**2) / (2 * np.sqrt(1 + k**2 + k**4))
    assert ratio > st.jump_ratio(np.sqrt(1 - 2 * damping))  # beyond the dotted curve
    assert interior_maxima(ratio * (1 - 1e-4), damping) == 1
    assert interior_maxima(ratio * (1 + 1e-4), damping) == 0
    assert st.fastest_mode(ratio * (1 - 1e-4), damping) == 0


def test_dotted_and_dashed_meet_at_half():
    assert st.jump_ratio(0.0) == st.merging_ratio(0.0) == 1
    assert st.fastest_mode(1 - 1e-12, 0.5) == pytest.approx((1e-12 / 3) ** 0.25, rel=1e-3)  # 1 - F' = 3 q^2 (1 + O(q))
    assert st.fastest_mode(1.0, 0.5) == 0
    k = np.array([0.01, 0.02])
    gap = (st.merging_ratio(k) - 1) / (st.jump_ratio(k) - 1)  # (3 k^4)/(k^4), next order k^2
    np.testing.assert_allclose(gap, 3, rtol=2e-3)


def test_exact_fastest_mode_against_scan():
    cases = [
        (0.004, 0.01, 0.1, 0.0),
        (0.1, 0.0, 0.05, 0.0),
        (0.006, 0.003, 0.7, 0.0),
        (2.0, 0.1, 0.3, 0.2),
        (0.01, 0.1, 0.2, 0),
    ]
    for softness, diffusivity, damping, rate in cases:
        k, sigma = st.fastest_mode_exact(softness, diffusivity, damping, rate)
        grid = np.linspace(0, 4, 2001)
        top = [cubic_sigma(x, softness, diffusivity, damping, rate).real for x in grid]
        assert k == pytest.approx(grid[np.argmax(top)], abs=0.002)
        assert sigma == pytest.approx(cubic_sigma(k, softness, diffusivity, damping, rate), abs=1e-14)  # np.roots
        nearby = [cubic_sigma(k + d, softness, diffusivity, damping, rate).real for d in (-1e-4, 1e-4) if k + d > 0]
        assert sigma.real >= max(nearby)
    assert st.fastest_mode_exact(0.01, 0.1, 0.2) == (0, 0)  # stable: the flat wave


def test_exact_fastest_mode_tends_to_leading_order_linearly():
    softness = np.geomspace(1e-5, 1e-3, 5)
    k, sigma = st.fastest_mode_exact(softness, 0.5 * softness, 0.3)
    error = np.abs(k - st.fastest_mode(0.5, 0.3))
    assert np.polyfit(np.log(softness), np.log(error), 1)[0] == pytest.approx(1, abs=0.05)  # alpha/2 Gamma^2 < 0.6 %
    rates = np.abs(sigma.real / softness / growth(st.fastest_mode(0.5, 0.3), 0.5, 0.3) - 1)
    assert np.polyfit(np.log(softness), np.log(rates), 1)[0] == pytest.approx(1, abs=0.05)


def test_soft_roads_grow_fastest_beyond_the_natural_wavenumber():
    # "In no case do we find k_max to be above 1" holds at leading order only
    k, sigma = st.fastest_mode_exact(0.1, 0.0, 0.05)
    assert k > 1.01 and sigma.real > cubic_sigma(1.0, 0.1, 0.0, 0.05).real > 0


def test_critical_speed_in_dimensionless_units():
    frequency, sink, spread, hardening = 1.5, 2e-6, 3e-6, 1.0
    for damping in (0.1, 0.3, 0.8):
        for harder in (0.0, hardening):
            speed = st.critical_speed(frequency, damping, sink, diffusion_per_passage=spread, hardening=harder)
            for factor, unstable in ((0.999, False), (1.001, True)):
                scales = Scales(speed=factor * speed, frequency=frequency, vehicles_per_day=100.0)
                ratio = scales.diffusivity(spread, 1.0) / scales.softness(sink, 1.0)
                top = np.max(growth(np.linspace(0.001, 2, 20001), ratio, damping)) - harder * scales.height
                assert (top > 0) == unstable
    assert st.critical_speed(1.5, 0.8, sink, diffusion_per_passage=spread) == pytest.approx(
        np.sqrt(9.81 * 1.5), rel=1e-15
    )
    assert st.critical_speed(1.5, 0.3, sink, diffusion_per_passage=spread, hardening=1e3) == np.inf
    assert st.critical_speed(1.5, 0.3, sink) == 0


def test_critical_flux():
    speed = st.critical_speed(2.0, 0.3, 1e-6, diffusion_per_second=1e-8, diffusion_per_passage=1e-7, flux=0.01)
    road = {"diffusion_per_second": 1e-8, "diffusion_per_passage": 1e-7}
    assert st.critical_flux(speed, 2.0, 0.3, 1e-6, **road) == pytest.approx(0.01, rel=1e-13)  # its inverse
    by_traffic = st.critical_speed(2.0, 0.3, 1e-6, diffusion_per_passage=1e-7)
    fluxes = st.critical_flux(by_traffic * np.array([0.99, 1.01]), 2.0, 0.3, 1e-6, diffusion_per_passage=1e-7)
    np.testing.assert_array_equal(fluxes, [np.inf, 0])  # all or nothing: the flux drops out
    assert st.critical_flux(by_traffic * 0.99, 2.0, 0.3, 1e-6, **road) == np.inf


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: st.neutral_softness(0.5, diffusivity=-1, damping=0.1), "diffusivity = -1"),
        (lambda: st.neutral_softness(0.5, diffusivity=1, damping=0), "damping = 0.0: must be finite and > 0"),
        (lambda: st.neutral_softness("a", diffusivity=1, damping=1), "k = 'a'"),
        (lambda: st.stability_boundary(0.3, points=1), "points = 1"),
        (lambda: st.stability_boundary(-0.3), "damping = -0.3"),
        (lambda: st.critical_ratio(0.3, [0.1, -0.1]), "hardening = -0.1"),
        (lambda: st.fastest_mode(np.nan, 0.3), "ratio = nan"),
        (lambda: st.jump_ratio(1.0), "k = 1.0: must be finite and >= 0 and < 1"),
        (lambda: st.merging_ratio(-0.1), "k = -0.1"),
        (lambda: st.fastest_mode_exact(0, 0.1, 0.1), "softness = 0"),
        (lambda: st.critical_speed(1.5, 0.3, 1e-6, diffusion_per_second=1e-8), "flux = None"),
        (lambda: st.critical_flux(0, 1.5, 0.3, 1e-6), "speed = 0"),
    ],
)
def test_bad_values_are_named(call, match):
    with pytest.raises(SceneError, match=match):
        call()
