"""What is simulated: a road, a fleet, a duration. Frozen, validated on construction, read from and written to TOML.

Units (Both, Hong and Kurtze): time 1/omega_0, distance v/omega_0, height g/omega_0^2, for a reference car of angular
frequency omega_0, speed v and mass 1.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path

import numpy as np
import tomli_w

from .errors import SceneError, shown
from .laws import LAWS, Bounded, Constant, Exponential, as_law, finite, whole
from .profiles import PROFILES, Heights, Noise, Sine, as_profile
from .scales import Scales

START = ("settled", "rest")
MOST_CARS = 10_000_000


@dataclass(frozen=True)
class Road:
    """A ring of `length` with `softness` alpha(H), `diffusivity` Delta(H) and an initial `profile`.

    Laws: Constant (or a number), Exponential, Bounded. Profile: Sine, Noise, an array of heights, None for flat.
    """

    length: float
    softness: float | Constant | Exponential | Bounded
    diffusivity: float | Constant | Exponential | Bounded = 0.0
    profile: Sine | Noise | Heights | tuple | None = None

    def __post_init__(self):
        object.__setattr__(self, "length", finite("Road.length", self.length, above=0))
        object.__setattr__(self, "softness", as_law("Road.softness", self.softness))
        object.__setattr__(self, "diffusivity", as_law("Road.diffusivity", self.diffusivity))
        object.__setattr__(self, "profile", as_profile(self.profile))
        self.profile.highest_wave(self.length)


@dataclass(frozen=True)
class Fleet:
    """`count` cars; `damping` Gamma, `speed`, `frequency`, `mass`: a number for all or one per car.

    position: where each car stands at the start (any number, taken modulo the ring), None for even spacing from x = 0.
    start: "settled" (each car rides in the periodic response to the road as it is) or "rest" (it stands on the road).
    """

    count: int
    damping: float | tuple[float, ...]
    speed: float | tuple[float, ...] = 1.0
    frequency: float | tuple[float, ...] = 1.0
    mass: float | tuple[float, ...] = 1.0
    position: tuple[float, ...] | None = None
    start: str = "settled"

    def __post_init__(self):
        object.__setattr__(self, "count", whole("Fleet.count", self.count, 1, MOST_CARS))
        for name, bound in (
            ("damping", {"least": 0.0}),
            ("speed", {"above": 0.0}),
            ("frequency", {"above": 0.0}),
            ("mass", {"above": 0.0}),
        ):
            object.__setattr__(self, name, self._per_car(name, getattr(self, name), bound))
        if self.position is not None:
            position = self._per_car("position", self.position, {})
            if not isinstance(position, tuple):
                position = (position,)
            if len(position) != self.count:
                raise SceneError(f"Fleet.position has {len(position)} values for {self.count} cars: give one per car")
            object.__setattr__(self, "position", position)
        if not isinstance(self.start, str) or self.start not in START:
            raise SceneError(f"Fleet.start = {shown(self.start)}: must be one of {', '.join(START)}")

    def _per_car(self, name, value, bound):
        if isinstance(value, (str, bytes, dict, set)) or not np.iterable(value):
            return finite(f"Fleet.{name}", value, **bound)
        values = tuple(finite(f"Fleet.{name}[{i}]", v, **bound) for i, v in enumerate(value))
        if len(values) != self.count:
            raise SceneError(
                f"Fleet.{name} has {len(values)} values for {self.count} cars: give a number or one per car"
            )
        return values

    def per_car(self, name: str) -> np.ndarray:
        """The values of `name` for every car, shape (count,)."""
        return np.broadcast_to(np.asarray(getattr(self, name), dtype=float), (self.count,))

    def positions(self, length: float) -> np.ndarray:
        """Positions at the start on a ring of `length`, in [0, length), shape (count,)."""
        if self.position is None:
            return np.arange(self.count) * (length / self.count)
        position = np.mod(self.position, length)
        return np.where(position < length, position, 0.0)  # -1e-20 modulo the ring rounds to its length


@dataclass(frozen=True)
class Scene:
    """A road, a fleet, a duration (in 1/omega_0). lift_off=False lets an airborne car pull the road up (linear theory).

    scales: the SI units of the scene, if it has any (see Scales).
    """

    road: Road
    fleet: Fleet
    duration: float
    lift_off: bool = True
    scales: Scales | None = field(default=None)

    def __post_init__(self):
        for name, kind in (("road", Road), ("fleet", Fleet)):
            if not isinstance(getattr(self, name), kind):
                raise SceneError(f"Scene.{name} = {shown(getattr(self, name))}: must be a {kind.__name__}")
        if self.scales is not None and not isinstance(self.scales, Scales):
            raise SceneError(f"Scene.scales = {shown(self.scales)}: must be Scales or None")
        object.__setattr__(self, "duration", finite("Scene.duration", self.duration, above=0))
        if not isinstance(self.lift_off, (bool, np.bool_)):
            raise SceneError(f"Scene.lift_off = {shown(self.lift_off)}: must be True or False")
        object.__setattr__(self, "lift_off", bool(self.lift_off))
        if self.fleet.position is not None:
            self._refuse_shared_positions()

    def __hash__(self):
        known = vars(self).get("_hash")  # asked for at every turn, by what is known of a scene already
        if known is None:
            known = hash((self.road, self.fleet, self.duration, self.lift_off, self.scales))
            object.__setattr__(self, "_hash", known)
        return known

    def __getstate__(self):
        # not the hash: another process has others of strings
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def _refuse_shared_positions(self):
        length = self.road.length
        position = self.fleet.positions(length)
        order = np.argsort(position, kind="stable")
        gap = np.diff(position[order], append=position[order[0]] + length)
        if self.fleet.count > 1 and gap.min() <= 1e-12 * length:
            first = int(np.argmin(gap))
            pair = sorted((int(order[first]), int(order[(first + 1) % len(order)])))
            raise SceneError(
                f"Fleet.position: cars {pair[0]} and {pair[1]} share position {position[order[first]]:.6g} "
                f"on a ring of length {length:.6g}; move one"
            )

    @property
    def headway(self) -> float:
        """Mean distance between cars, L/N."""
        return self.road.length / self.fleet.count

    @property
    def headway_time(self) -> float:
        """Mean time between passages of a point, L / sum of speeds."""
        speed = self.fleet.speed
        return self.road.length / (math.fsum(speed) if isinstance(speed, tuple) else self.fleet.count * speed)

    def to_dict(self) -> dict:
        """Plain numbers, strings, lists and dicts that rebuild the scene; what is None is left out."""
        out: dict = {"duration": self.duration, "lift_off": self.lift_off}
        road = {"length": self.road.length}
        for name in ("softness", "diffusivity"):
            road[name] = _law_to_plain(getattr(self.road, name))
        road["profile"] = _tagged(self.road.profile, PROFILES, "kind")
        out["road"] = road
        fleet = vars(self.fleet)
        out["fleet"] = {k: list(v) if isinstance(v, tuple) else v for k, v in fleet.items() if v is not None}
        if self.scales is not None:
            out["scales"] = dict(vars(self.scales))
        return out

    @classmethod
    def from_dict(cls, data: dict) -> Scene:
        """The scene that `to_dict` describes; SceneError names a missing or unknown key."""
        data = _table("scene", data)
        parts = dict(data)
        if "road" in data:
            road = _table("road", data["road"])
            for name in ("softness", "diffusivity"):
                if isinstance(road.get(name), dict):
                    road[name] = _untagged(f"road.{name}", road[name], LAWS, "law")
            if isinstance(road.get("profile"), dict):
                road["profile"] = _untagged("road.profile", road["profile"], PROFILES, "kind")
            parts["road"] = _build(Road, "road", road)
        if "fleet" in data:
            parts["fleet"] = _build(Fleet, "fleet", _table("fleet", data["fleet"]))
        if "scales" in data:
            parts["scales"] = _build(Scales, "scales", _table("scales", data["scales"]))
        return _build(cls, "scene", parts)

    def to_toml(self, path=None) -> str:
        """The scene as TOML text; written to `path` if given."""
        text = tomli_w.dumps(self.to_dict())
        if path is not None:
            try:
                Path(path).write_text(text, encoding="utf-8")
            except (OSError, ValueError, TypeError) as error:
                reason = getattr(error, "strerror", None) or error
                raise SceneError(f"{path}: cannot write the scene: {reason}; name a file in a folder") from None
        return text

    @classmethod
    def from_toml(cls, path) -> Scene:
        """The scene in the TOML file at `path`; SceneError if it is missing, broken or not a scene."""
        try:
            path = Path(path)
            if (
                path.exists() and not path.is_file() and not path.is_dir()
            ):  # a pipe waits for a writer, /dev/zero never ends
                raise OSError("it is no regular file")
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, TypeError, RecursionError) as error:
            # ValueError: broken TOML, not UTF-8, a NUL in the path; RecursionError: brackets in thousands
            reason = getattr(error, "strerror", None) or error
            raise SceneError(f"{path}: cannot read the scene: {reason}; it must be a TOML file in UTF-8") from None
        try:
            return cls.from_dict(data)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None


def _table(where, data) -> dict:
    if not isinstance(data, dict):
        raise SceneError(f"{where} = {shown(data)}: must be a table of keys and values")
    return dict(data)


def _build(kind, where, data):
    names = [f.name for f in fields(kind)]
    for key in data:
        if key not in names:
            raise SceneError(f"{where}: unknown key {shown(key)}; allowed are {', '.join(names)}")
    for f in fields(kind):
        if f.default is MISSING and f.name not in data:
            raise SceneError(f"{where}: key {f.name!r} is missing; add it")
    return kind(**data)


def _law_to_plain(law):
    return law.value if isinstance(law, Constant) else _tagged(law, LAWS, "law")


def _tagged(value, kinds, tag):
    name = next(name for name, kind in kinds.items() if type(value) is kind)
    return {tag: name} | {k: list(v) if isinstance(v, tuple) else v for k, v in vars(value).items()}


def _untagged(where, data, kinds, tag):
    name = data.get(tag)
    if not isinstance(name, str) or name not in kinds:
        raise SceneError(f"{where}.{tag} = {shown(name)}: must be one of {', '.join(kinds)}")
    return _build(kinds[name], where, {k: v for k, v in data.items() if k != tag})
