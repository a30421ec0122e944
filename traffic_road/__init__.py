"""How traffic corrugates roads: discrete cars, the continuum equations of Both, Hong and Kurtze, and their theory."""

from importlib import import_module

# public name -> module; loaded when first asked for, so that `traffic-road --help` does not wait for the compilers
_PUBLIC = {
    "Scene": "scene",
    "Road": "scene",
    "Fleet": "scene",
    "Constant": "laws",
    "Exponential": "laws",
    "Bounded": "laws",
    "Sine": "profiles",
    "Noise": "profiles",
    "Scales": "scales",
    "to_si": "scales",
    "preset": "presets",
    "simulate": "run",
    "rerun": "run",
    "resume": "run",
    "plan": "planning",
    "mode": "analysis",
    "growth_rate": "analysis",
    "phase_velocity": "analysis",
    "coarse_grain": "analysis",
    "compare": "comparison",
    "sweep": "sweeps",
    "TrafficRoadError": "errors",
    "SceneError": "errors",
    "StabilityError": "errors",
    "StoreError": "errors",
}

__all__ = sorted([*_PUBLIC, "open", "save", "theory"])


def __getattr__(name):
    if name == "theory":
        found = import_module(".theory", __name__)
    elif name in ("open", "save"):
        found = getattr(import_module(".store", __name__), {"open": "open_dataset", "save": "save"}[name])
    elif name in _PUBLIC:
        found = getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found  # not asked for again
    return found


def __dir__():
    return __all__
