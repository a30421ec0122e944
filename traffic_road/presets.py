"""Named scenes."""

from __future__ import annotations

import numpy as np

from .errors import SceneError, shown
from .profiles import Noise, Sine
from .scales import Scales
from .scene import Fleet, Road, Scene


def paper() -> Scene:
    """One unstable wave of Both, Hong and Kurtze (k = 0.9, Gamma = 0.1, Delta = 0.01, alpha = 0.006), 8 cars on it."""
    return Scene(
        road=Road(length=2 * np.pi / 0.9, softness=0.006, diffusivity=0.01, profile=Sine(1e-3, 0.9)),
        fleet=Fleet(count=8, damping=0.1),
        duration=400.0,
    )


def gravel() -> Scene:
    """A gravel road, 200 vehicles a day at 40 km/h, fourteen days from a freshly bladed surface.

    Typical measured values: wheel hop near 11 Hz (10 to 15 Hz for cars and light trucks), damping ratio of the wheel
    0.3 (0.2 to 0.4), speed and flux of a minor rural road. Guesses: the road sinks 10 micrometres per passage of the
    static load (a loose, dry surface), and its diffusion per passage is set so that the critical speed
    v_c^2 = 4 Gamma (1 - Gamma) g D / sink is 22.5 km/h; the initial roughness (rms 0.04 mm below 1.6 m wavelength) is
    what a blade may leave at these wavelengths. Nothing here hardens, and the softness lies beyond the limit up to which
    waves saturate: the corrugation takes cars into the air in the second week and grows until the grader comes back.
    """
    scales = Scales(speed=40 / 3.6, frequency=11.0, vehicles_per_day=200.0)
    damping, critical_speed, sink_per_passage = 0.3, 22.5 / 3.6, 1.0e-5
    diffusion_per_passage = critical_speed**2 * sink_per_passage / (4 * damping * (1 - damping) * scales.gravity)
    waves, cars_per_wave, wavenumber, days = 12, 8, 0.7, 14
    length = 2 * np.pi * waves / wavenumber
    headway = length / (waves * cars_per_wave)
    return Scene(
        road=Road(
            length=length,
            softness=scales.softness(sink_per_passage, headway),
            diffusivity=scales.diffusivity(diffusion_per_passage, headway),
            profile=Noise(rms=4e-5 / scales.height, max_wavenumber=1.4, seed=1),
        ),
        fleet=Fleet(count=waves * cars_per_wave, damping=damping),
        duration=days * scales.vehicles_per_day * headway,
        scales=scales,
    )


PRESETS = {"paper": paper, "gravel": gravel}


def preset(name: str) -> Scene:
    """The scene called `name`; SceneError if there is none."""
    if not isinstance(name, str) or name not in PRESETS:
        raise SceneError(f"preset {shown(name)}: there is none of that name; choose {' or '.join(PRESETS)}")
    return PRESETS[name]()
