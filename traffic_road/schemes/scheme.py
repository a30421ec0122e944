"""What is to be known of a scheme before it is used: its order, its stability limit, its cost and its source."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ..errors import StabilityError


class Scheme(NamedTuple):
    """One step of its kind; the tables STEPPERS, RELAXATIONS and PASSAGES name them and say what `step` takes."""

    step: Callable
    order: int | None  # None: exact
    limit: Callable  # the largest step (or softness) that does not blow up; inf where there is none
    cost: int  # multiply-adds
    source: str


def refuse_beyond(limit: float, value: float, quantity: str, name: str, remedy: str) -> None:
    """StabilityError, in one line with the limit and the remedy, unless value <= limit."""
    if not value <= limit:
        raise StabilityError(f"{quantity} = {value:.4g}: {name} is stable up to {limit:.4g}; {remedy}")
