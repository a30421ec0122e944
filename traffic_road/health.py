"""Is a run still sound, and if it is not, why: growth that nothing in the model holds, or the numerics.

Saturated waves cease at an upper softness (`theory.saturation_limit`). Beyond it the corrugation of a bouncing fleet grows
without end: that is the model's own answer, is foretold, kept up to where no wave can be saturated, and followed further
where that was asked for. Where theory says that it cannot be so large, the numerics have failed: the run is stopped there.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .errors import TrafficRoadError
from .laws import Constant
from .theory.dispersion import dispersion, fleet_dispersion
from .theory.stability import neutral_softness, unstable
from .theory.waves import saturation_limit

RUNAWAY = 1e12  # corrugation (g/omega_0^2) beyond which the road has blown up and rounding eats what is left
ALARM = 1e3  # times the start and the static deflection: no saturated wave is that high, but close to its limit
CLOSE = 0.95  # of the saturation limit: the amplitude, as 1/(limit - softness), is still finite but large
MOST_WAVES = 1000  # of the ring that are asked for their growth
INVERTS = 2.0  # softness of a passage, in units of a car's compliance, beyond which it turns bumps into dips
SHORTEST = 1.5  # k u/omega: shorter waves than that do not grow


class Watch:
    """Looks at the road of one run: `trouble` says in words why it must stop, or nothing while it is sound.

    A look costs the highest and the lowest node. Theory is asked once, when the corrugation is ALARM times what it began
    with; where theory does not rule out that it is held further up, or lift_off=False, the run goes on to RUNAWAY.
    """

    def __init__(self, scene, model: str, outside: str | None = None, further: bool = False):
        """outside: the stability limit that the run was started beyond, if any, for study: only RUNAWAY ends it, as it does
        growth beyond the saturation limit where the run is to go `further`."""
        self.scene, self.model, self.outside, self.further = scene, model, outside, further
        frequency = scene.fleet.frequency
        slowest = min(frequency) if isinstance(frequency, tuple) else frequency
        self.start = 1 / slowest**2  # and the profile, from the first look that needs it
        self.most = RUNAWAY if outside else min(ALARM * self.start, RUNAWAY)
        self.knows_profile = bool(outside)
        self.growth: Growth | None = None

    def trouble(self, road_height) -> str | None:
        """None, or the reason to stop at this road (nodes,)."""
        size = corrugation(road_height)
        if size < self.most:
            return None
        if not self.knows_profile:
            profile, length = self.scene.road.profile, self.scene.road.length
            self.start += corrugation(profile.sample(length, 4 * profile.highest_wave(length) + 4))
            self.most, self.knows_profile = min(ALARM * self.start, RUNAWAY), True
            if size < self.most:
                return None
        if self.growth is None:
            height = float(np.mean(road_height))
            self.growth = unheld_growth(self.scene, height if np.isfinite(height) else 0.0, self.model)
            ends = self.growth.lift_off is not None and not (self.growth.possible and self.further)
            most = ALARM * max(self.start, self.growth.lift_off) if ends else RUNAWAY
            self.most = min(max(self.most, most), RUNAWAY)
            if size < self.most:
                return None
        # the same words whenever the clock has made it look
        found = f"corrugation beyond {self.most:.3g}, or no number (NaN)"
        if self.outside:
            return f"{found}; numerical: {self.outside}"
        if self.growth.possible:
            further = "" if self.most == RUNAWAY else "; allow_unstable=True follows it further"
            return f"{found}; {self.growth.reason}{further}"
        return f"{found}; numerical: {self.growth.reason}; use more nodes, a shorter step or relax more often"


def corrugation(road_height) -> float:
    """Highest less lowest node; NaN or infinite where a number has been lost."""
    return float(
        road_height[road_height.argmax()] - road_height[road_height.argmin()]
    )  # in a third of the time of max()


class Growth(NamedTuple):
    """Whether the scene's corrugation may grow without end, the reason in words, and the highest amplitude at lift-off.

    lift_off: far beyond it the corrugation is certainly not held any more; None where that is not certain at any amplitude.
    """

    possible: bool
    reason: str
    lift_off: float | None = 0.0
    unknown: bool = False


def unheld_growth(scene, height: float, model: str) -> Growth:
    """What theory knows of growth without end on the whole ring, with the laws as they are at the mean `height`."""
    softness, diffusivity = (float(law(height)) for law in (scene.road.softness, scene.road.diffusivity))
    longest = 2 * np.pi / scene.road.length
    speed, frequency, mass = map(scene.fleet.per_car, ("speed", "frequency", "mass"))
    last = max(1, int(SHORTEST * float(np.max(frequency / speed)) / longest))
    k = longest * np.unique(np.linspace(1, last, min(last, MOST_WAVES)).astype(int))
    if not (np.isfinite([softness, diffusivity]).all() and softness > 0):
        return Growth(False, f"softness {softness:.3g} and diffusivity {diffusivity:.3g} let no wave grow")
    passage = softness * scene.headway * float(np.max(mass * frequency**2 / speed))  # of `schemes.passage.midpoint`
    if model == "cars" and scene.lift_off and passage > INVERTS:
        what = f"softness * headway * mass * frequency^2 / speed = {passage:.3g} > {INVERTS:g}: bumps invert at each passage"
        return Growth(
            True,
            f"{what}, and no theory tells what holds them; use more cars, a lower softness or frequency",
            None,
            True,
        )
    hardening = float(scene.road.softness.derivative(height)) * float(np.mean(mass))
    sigma = fleet_dispersion(
        k, scene.fleet, softness=softness, diffusivity=diffusivity, hardening_rate=hardening if scene.lift_off else 0.0
    )
    growing = sigma.real > 0
    if not growing.any():
        return Growth(False, "no wave of this ring grows by theory")
    fastest = int(np.argmax(sigma.real))
    if not scene.lift_off:
        return Growth(
            True,
            f"the wave k = {k[fastest]:.4g} grows at {sigma.real[fastest]:.3g} and lift_off=False holds nothing",
            None,
        )
    unit = reference(scene)
    if unit is None or hardening > 0:
        what = "a softness that varies" if hardening > 0 else "a mixed fleet"
        return Growth(True, f"no theory tells where {what} saturates; repeat it with finer numerics", None, True)
    kappa, alpha, delta, damping = (
        k[growing] * unit.length,
        softness * unit.softness,
        diffusivity * unit.diffusivity,
        unit.damping,
    )
    neutral = neutral_softness(kappa, diffusivity=delta, damping=damping)
    worst = int(np.argmin(neutral))
    limit = _limit(float(kappa[worst]), delta, damping)
    values = f"softness {softness:.4g} of a road with diffusivity {diffusivity:.3g}"
    high = float(np.max(lift_off_height(kappa, damping))) * unit.height
    of_wave = f"the saturation limit {limit / unit.softness:.4g} of its wave k = {k[growing][worst]:.4g}"
    if alpha > limit:
        return Growth(
            True, f"{values} is beyond {of_wave}: airborne cars hold no amplitude; use a lower softness", high
        )
    if np.isnan(limit):
        return Growth(True, f"{values}: its saturation limit is not known; repeat it with finer numerics", None, True)
    if not alpha < CLOSE * limit:
        return Growth(
            True, f"{values} is close to {of_wave}, where the amplitude is infinite; use a lower softness", None
        )
    return Growth(False, f"{values} is within {of_wave}", high)


def foreseen(scene) -> str | None:
    """A line that tells, before a run, that its corrugation will pass lift-off and that nothing will hold it then; or None."""
    road, unit = scene.road, reference(scene)
    if (
        unit is None
        or not scene.lift_off
        or not (isinstance(road.softness, Constant) and isinstance(road.diffusivity, Constant))
    ):
        return None
    alpha, delta, damping = road.softness.value * unit.softness, road.diffusivity.value * unit.diffusivity, unit.damping
    highest = road.profile.highest_wave(road.length)
    if highest == 0 or damping == 0:
        return None
    wave = 2 * np.abs(road.profile.spectrum(road.length, 2 * highest + 1))[1:]
    (present,) = (wave > 1e-14 * wave.max()).nonzero()
    k, wave = 2 * np.pi / road.length * (1 + present), wave[present]
    candidate = unstable(k * unit.length, alpha / 2, delta, damping)  # the limit is twice the neutral softness or more
    if not candidate.any():
        return None
    k, wave = k[candidate], wave[candidate]
    rate = dispersion(k * unit.length, softness=alpha, diffusivity=delta, damping=damping).real
    with np.errstate(divide="ignore", over="ignore"):
        # time at which the wave, if it grows by its rate, lifts cars off
        due = np.log(np.maximum(lift_off_height(k * unit.length, damping) * unit.height / wave, 1.0)) / rate * unit.time
    due[~(rate > 0)] = np.inf
    first = int(np.argmin(due))
    if not due[first] < scene.duration:
        return None
    limit = _limit(float(k[first] * unit.length), delta, damping)
    if not alpha > limit:
        return None
    return (
        f"softness = {road.softness.value:.4g}: beyond the saturation limit {limit / unit.softness:.4g} of the wave "
        f"k = {k[first]:.4g}; from about time {due[first]:.3g}, when cars take off, nothing holds the corrugation: it grows "
        f"until the run ends; use a lower softness, or a higher diffusivity, for a road that saturates"
    )


class Unit(NamedTuple):
    """Factors from a fleet of identical cars to the reference car's units, in which theory is written; and back."""

    length: float  # k u/omega = k * length
    softness: float
    diffusivity: float
    damping: float
    height: float  # g/omega_0^2 = reference height * height
    time: float


def reference(scene) -> Unit | None:
    """The units in which the cars have speed, frequency and mass 1; None for cars that are not all alike."""
    columns = [getattr(scene.fleet, name) for name in ("speed", "frequency", "damping", "mass")]
    if any(isinstance(c, tuple) and min(c) != max(c) for c in columns):
        return None
    u, omega, damping, m = (c[0] if isinstance(c, tuple) else c for c in columns)
    return Unit(u / omega, m * omega, omega / u**2, damping, 1 / omega**2, 1 / omega)


def lift_off_height(kappa, damping):
    """Amplitude of a wave at which cars begin to leave it: sqrt((1 - kappa^2)^2 + 4 Gamma^2 kappa^2)/kappa^2; broadcasts."""
    return np.hypot(1 - kappa**2, 2 * damping * kappa) / kappa**2


@lru_cache(maxsize=256)
def _limit(kappa: float, diffusivity: float, damping: float) -> float:
    """`saturation_limit`; 0 without diffusion, NaN where theory fails."""
    if diffusivity == 0:
        return 0.0
    try:
        return float(saturation_limit(kappa, diffusivity=diffusivity, damping=damping))
    except TrafficRoadError:
        return np.nan
