"""Softness and diffusivity as functions of the road height H (the admissible laws of Fig. 2 of Both, Hong and Kurtze).

A law is a positive, non-decreasing function of H: a road that has sunk is harder. Each law knows its value, its
derivative and `kernel`, the (kind, value, shape) triple by which the compiled loops know it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .errors import SceneError, shown

CONSTANT, EXPONENTIAL, BOUNDED = 0, 1, 2
LARGEST = 1e30  # argument of a closed form: far beyond any use, and products of them do not overflow


def finite(
    name: str,
    value,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    remedy: str = "",
) -> float:
    """`value` as a float; SceneError if it is not a finite number > `above`, >= `least`, <= `most` in size."""
    try:
        if type(value) is not float:
            plain = np.asarray(value)
            if plain.ndim or plain.dtype.kind not in "iufO":  # float() would take True, "1", b"1" and [1]
                raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    low = (above is not None and number <= above) or (least is not None and number < least)
    if not math.isfinite(number) or low or (most is not None and abs(number) > most):
        allowed = "a finite number"
        if above is not None:
            allowed += f" > {above:g}"
        if least is not None:
            allowed += f" >= {least:g}"
        if most is not None:
            allowed += f", at most {most:g} in size"
        raise SceneError(f"{name} = {shown(value)}: must be {allowed}{remedy and '; ' + remedy}")
    return number


def whole(name: str, value, least: int, most: int) -> int:
    """`value` as an int; SceneError if it is not a whole number from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not least <= value <= most:
        raise SceneError(f"{name} = {shown(value)}: must be a whole number >= {least} and <= {most}")
    return int(value)


def checked(name: str, value, *, above=-np.inf, least=-np.inf, below=np.inf) -> np.ndarray:
    """`value` as a float array; SceneError unless all of it is > `above`, >= `least`, < `below` and <= LARGEST in size."""
    bounds = {">": above, ">=": least, "<": below}
    allowed = "finite" + "".join(f" and {sign} {bound:g}" for sign, bound in bounds.items() if np.isfinite(bound))
    allowed += f", at most {LARGEST:g} in size"
    if above == 0:
        above = 1 / LARGEST  # so near 0 that its square is nothing
        allowed += f" and more than {above:g}"
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":  # True, "1" and 1j are no real numbers
            raise TypeError
        array = array.astype(float)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(f"{name} = {shown(value)}: must be {allowed}; give a number or an array of numbers") from None
    bad = ~(np.isfinite(array) & (array > above) & (array >= least) & (array < below) & (np.abs(array) <= LARGEST))
    if bad.any():
        raise SceneError(f"{name} = {array[bad].flat[0]}: must be {allowed}")
    return array


def together(**arrays) -> list[np.ndarray]:
    """The arrays, broadcast against each other; SceneError names their shapes if that cannot be."""
    try:
        return np.broadcast_arrays(*arrays.values())
    except ValueError:
        shapes = ", ".join(f"{name} {np.shape(value)}" for name, value in arrays.items())
        raise SceneError(f"shapes do not fit each other: {shapes}; give numbers, or arrays that broadcast") from None


@dataclass(frozen=True)
class Constant:
    """The same `value` at every height."""

    value: float

    def __post_init__(self):
        object.__setattr__(self, "value", finite("Constant.value", self.value, least=0))

    def __call__(self, height):
        return np.full_like(np.asarray(height, dtype=float), self.value)

    def derivative(self, height):
        return np.zeros_like(np.asarray(height, dtype=float))

    @property
    def kernel(self) -> tuple[int, float, float]:
        return CONSTANT, self.value, 0.0


@dataclass(frozen=True)
class Exponential:
    """value * exp(hardening * H), Eq. (19) of the paper; `hardening` (the paper's epsilon) >= 0."""

    value: float
    hardening: float

    def __post_init__(self):
        object.__setattr__(self, "value", finite("Exponential.value", self.value, least=0))
        object.__setattr__(
            self,
            "hardening",
            finite("Exponential.hardening", self.hardening, least=0, remedy="a road hardens as it sinks"),
        )

    def __call__(self, height):
        return self.value * np.exp(self.hardening * np.asarray(height, dtype=float))

    def derivative(self, height):
        return self.hardening * self(height)

    @property
    def kernel(self) -> tuple[int, float, float]:
        return EXPONENTIAL, self.value, self.hardening


@dataclass(frozen=True)
class Bounded:
    """value * max(0, 1 + H/depth): vanishes once the road has sunk by `depth` > 0."""

    value: float
    depth: float

    def __post_init__(self):
        object.__setattr__(self, "value", finite("Bounded.value", self.value, least=0))
        object.__setattr__(self, "depth", finite("Bounded.depth", self.depth, above=0))

    def __call__(self, height):
        return self.value * np.maximum(0.0, 1.0 + np.asarray(height, dtype=float) / self.depth)

    def derivative(self, height):
        return np.where(np.asarray(height, dtype=float) > -self.depth, self.value / self.depth, 0.0)

    @property
    def kernel(self) -> tuple[int, float, float]:
        return BOUNDED, self.value, 1.0 / self.depth


LAWS = {"constant": Constant, "exponential": Exponential, "bounded": Bounded}


def as_law(name: str, law) -> Constant | Exponential | Bounded:
    """`law` itself, or a number taken as `Constant`."""
    if isinstance(law, tuple(LAWS.values())):
        return law
    return Constant(finite(name, law, least=0, remedy="or one of the laws Constant, Exponential, Bounded"))
