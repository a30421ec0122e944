"""Which scenes a sweep runs: paths to fields of a scene, the values that they take, and the scene of one point."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import NamedTuple

import numpy as np

from ..errors import SceneError, shown
from ..laws import LAWS, finite
from ..profiles import Noise
from ..scene import Scene

MOST_POINTS = 10_000_000
PER_CAR = ("fleet.damping", "fleet.speed", "fleet.frequency", "fleet.mass")  # one number stands for all cars


class Axis(NamedTuple):
    """One field of the scene and its values: plain float, int, bool or str."""

    path: str
    values: tuple

    @property
    def dim(self) -> str:
        """The path as a netCDF name."""
        return self.path.replace(".", "_")


def checked_axes(scene: Scene, over, members: int | None = None) -> tuple[Axis, ...]:
    """The axes that `over` (path -> values) names, checked; SceneError names a path or value that cannot be used.

    members: so many roads of the scene's Noise besides, with seeds spawned from the one that it has.
    """
    if not isinstance(over, dict):
        raise SceneError(
            f"over = {shown(over)}: must be a dict of paths and values, as {{'road.softness': [0.004, 0.006]}}"
        )
    if members is not None:
        over = {**over, "road.profile.seed": _seeds(scene, over, members)}
    if not over:
        raise SceneError("over: names no field of the scene; give one, as {'road.softness': [0.004, 0.006]}")
    found = tuple(Axis(path, _values(path, _kind(path, _field(scene, path)), given)) for path, given in over.items())
    for outer in over:
        for inner in over:
            if inner.startswith(f"{outer}."):
                raise SceneError(f"over: {outer} replaces all of what {inner} is a part of; name one of the two")
    points = int(np.prod([float(len(axis.values)) for axis in found]))
    if points > MOST_POINTS:
        raise SceneError(f"over: {points} points, must be at most {MOST_POINTS}; give fewer values")
    return found


def _seeds(scene, over, members):
    if isinstance(members, bool) or not isinstance(members, (int, np.integer)) or members < 1:
        raise SceneError(f"members = {shown(members)}: must be a whole number >= 1")
    if not isinstance(scene.road.profile, Noise) or "road.profile.seed" in over:
        raise SceneError(f"members = {members}: needs a profile of Noise whose seed is not in `over`")
    spawned = np.random.SeedSequence(scene.road.profile.seed).spawn(members)
    return [int(seed.generate_state(1, np.uint64)[0] >> np.uint64(1)) for seed in spawned]


def _field(scene, path):
    """What the scene has at `path`."""
    here = scene
    parts = path.split(".") if isinstance(path, str) else [path]
    for i, part in enumerate(parts):
        names = [f.name for f in fields(here)] if is_dataclass(here) else []
        if part not in names:
            owner = ".".join(parts[:i]) or "a scene"
            kind = f" ({type(here).__name__})" if i and names else ""
            remedy = f"{owner}{kind} has {', '.join(names)}" if names else f"{owner} is a value and has no fields"
            raise SceneError(f"over: {shown(path)}: no such field; {remedy}")
        here = getattr(here, part)
    return here


def _kind(path, here) -> type:
    """The type of values that may stand at `path` in the place of what is there."""
    if isinstance(here, (bool, int, str)):
        return type(here)
    if isinstance(here, (float, *LAWS.values())) or path in PER_CAR:
        return float
    if is_dataclass(here):
        names = ", ".join(f"{path}.{f.name}" for f in fields(here))
        raise SceneError(f"over: {path}: is a {type(here).__name__} and no single value; name one of {names}")
    raise SceneError(f"over: {path}: is no single value in this scene, so that it has none to vary")


def _values(path, kind, given) -> tuple:
    if isinstance(given, (str, bytes, dict, set)) or not np.iterable(given):
        raise SceneError(f"over: {path} = {shown(given)}: must be a sequence of values, as a list or an array")
    values = tuple(_value(f"over: {path}[{i}]", kind, value) for i, value in enumerate(given))
    if not values:
        raise SceneError(f"over: {path}: has no values; give at least one")
    if len(set(values)) < len(values):
        twice = next(value for i, value in enumerate(values) if value in values[:i])
        raise SceneError(f"over: {path}: {twice!r} stands there twice; name each value once")
    return values


def _value(name, kind, value):
    if kind in (bool, str):
        if not isinstance(value, (kind, np.bool_) if kind is bool else kind):
            raise SceneError(f"{name} = {shown(value)}: must be {'True or False' if kind is bool else 'a text'}")
        return kind(value)
    if kind is float:
        return finite(name, value)
    if isinstance(value, (float, np.floating)) and value == np.rint(value) and abs(value) < 2**53:
        value = int(value)  # linspace(4, 8, 5) holds whole numbers, too
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or abs(value) >= 2**63:
        raise SceneError(f"{name} = {shown(value)}: must be a whole number")
    return int(value)


def scene_at(scene: Scene, values: dict) -> Scene:
    """The scene with `values` (path -> value) in it, all changed at once; SceneError if there is no such scene."""
    tree: dict = {}
    for path, value in values.items():
        *parents, leaf = path.split(".")
        branch = tree
        for parent in parents:
            branch = branch.setdefault(parent, {})
        branch[leaf] = value
    return _changed(scene, tree)


def _changed(thing, tree):
    return replace(
        thing,
        **{name: _changed(getattr(thing, name), new) if isinstance(new, dict) else new for name, new in tree.items()},
    )


def parse_over(texts) -> dict:
    """`over` from the command line: PATH=START:STOP:NUMBER (evenly spaced, ends included) or PATH=VALUE,VALUE,..."""
    over = {}
    for text in texts:
        path, sign, values = text.partition("=")
        if not sign or not path or not values:
            raise SceneError(f"--over {shown(text)}: must be PATH=START:STOP:NUMBER or PATH=VALUE,VALUE,...")
        if path in over:
            raise SceneError(f"--over: {path} stands there twice; name all its values in one")
        over[path] = _spaced(text, values) if ":" in values else [_literal(value) for value in values.split(",")]
    return over


def _spaced(text, values):
    try:
        start, stop, number = values.split(":")
        start, stop, number = float(start), float(stop), int(number)
    except ValueError:
        number = 0
    if not 1 <= number <= MOST_POINTS or not np.isfinite(stop - start):
        raise SceneError(f"--over {shown(text)}: must be two numbers and how many values, as 0.004:0.006:9")
    return np.linspace(start, stop, number).tolist()


def _literal(text):
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
