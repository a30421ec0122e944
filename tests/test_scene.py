"""Scenes, laws and profiles: what is accepted, what is refused and in which words, and what survives a round trip."""

import json
import os
import pickle
import re
import sys
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
import tomli_w

import traffic_road as tr
from traffic_road.laws import as_law
from traffic_road.profiles import Heights

LENGTH = 2 * np.pi / 0.9
ROAD = {"length": LENGTH, "softness": 0.006, "diffusivity": 0.01, "profile": tr.Sine(1e-3, 0.9)}
FLEET = {"count": 3, "damping": 0.1}
NUMBERS = ("soft", "1", b"1", True, np.bool_(True), None, [1.0], [[1.0]], 1j, np.nan, np.inf, 10**400, 10**5000)


def scene(*, road=None, fleet=None, **keys):
    return tr.Scene(
        tr.Road(**{**ROAD, **(road or {})}), tr.Fleet(**{**FLEET, **(fleet or {})}), **{"duration": 9.0, **keys}
    )


def refusal(build, *args, **keys):
    """The message of the SceneError that `build` raises: one short line."""
    with pytest.raises(tr.SceneError) as caught:
        build(*args, **keys)
    text = str(caught.value)
    assert "\n" not in text and 10 < len(text) < 300
    return text


# ---------------------------------------------------------------- construction


@pytest.mark.parametrize("value", NUMBERS, ids=lambda v: type(v).__name__)
@pytest.mark.parametrize(
    "build",
    [
        lambda v: tr.Road(v, 0.1),
        lambda v: tr.Scene(tr.Road(LENGTH, 0.1), tr.Fleet(1, 0.1), v),
        lambda v: tr.Sine(v, 0.9),
        lambda v: tr.Sine(1.0, v),
        lambda v: tr.Sine(1.0, 0.9, v),
        lambda v: tr.Noise(v, 2.0),
        lambda v: tr.Noise(1.0, v),
        lambda v: tr.Constant(v),
        lambda v: tr.Exponential(v, 1.0),
        lambda v: tr.Exponential(1.0, v),
        lambda v: tr.Bounded(v, 1.0),
        lambda v: tr.Bounded(1.0, v),
        lambda v: tr.Scales(v, 11.0, 200.0),
        lambda v: tr.Scales(11.0, 11.0, 200.0, gravity=v),
    ],
)
def test_not_a_finite_number(build, value):
    assert "must be a finite number" in refusal(build, value)


@pytest.mark.parametrize("name", ["damping", "speed", "frequency", "mass"])
def test_not_a_number_for_a_fleet(name):
    for value in NUMBERS:
        refusal(tr.Fleet, **{"count": 3, "damping": 0.1, name: value})
        if not isinstance(value, list):
            assert f"Fleet.{name}[1]" in refusal(tr.Fleet, **{**FLEET, name: [1.0, value, 1.0]})
    for value in ({0.1, 0.2, 0.3}, {0.1: 1, 0.2: 1, 0.3: 1}, b"abc", np.ones((3, 2))):
        assert f"Fleet.{name}" in refusal(tr.Fleet, **{**FLEET, name: value})


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: tr.Road(0.0, 0.1), "Road.length = 0.0: must be a finite number > 0"),
        (lambda: tr.Road(LENGTH, -0.1), "Road.softness = -0.1: must be a finite number >= 0"),
        (lambda: tr.Road(LENGTH, 0.1, -1), "Road.diffusivity = -1: must be a finite number >= 0"),
        (lambda: tr.Road(LENGTH, [0.1, 0.1]), "or one of the laws"),
        (lambda: tr.Exponential(0.1, -1.0), "a road hardens as it sinks"),
        (lambda: tr.Bounded(0.1, 0.0), "Bounded.depth = 0.0: must be a finite number > 0"),
        (lambda: tr.Fleet(0, 0.1), "Fleet.count = 0: must be a whole number >= 1"),
        (lambda: tr.Fleet(8.0, 0.1), "Fleet.count = 8.0"),
        (lambda: tr.Fleet("8", 0.1), "Fleet.count = '8'"),
        (lambda: tr.Fleet(True, 0.1), "Fleet.count = True"),
        (lambda: tr.Fleet(10**400, 0.1), "Fleet.count = 1000"),
        (lambda: tr.Fleet(10**5000, 0.1), "Fleet.count = <int too long to print>"),
        (lambda: tr.Fleet(3, -0.1), "Fleet.damping = -0.1: must be a finite number >= 0"),
        (lambda: tr.Fleet(3, 0.1, speed=0), "Fleet.speed = 0: must be a finite number > 0"),
        (lambda: tr.Fleet(3, 0.1, frequency=[1, 1, -1]), r"Fleet.frequency\[2\] = -1"),
        (lambda: tr.Fleet(3, 0.1, mass=[1, 1]), "Fleet.mass has 2 values for 3 cars: give a number or one per car"),
        (lambda: tr.Fleet(3, 0.1, mass=[]), "Fleet.mass has 0 values for 3 cars"),
        (lambda: tr.Fleet(3, 0.1, position=[0, 1]), "Fleet.position has 2 values for 3 cars"),
        (lambda: tr.Fleet(3, 0.1, position=1.0), "Fleet.position has 1 values for 3 cars"),
        (lambda: tr.Fleet(3, 0.1, position=[0, np.nan, 1]), r"Fleet.position\[1\] = nan"),
        (lambda: tr.Fleet(3, 0.1, start="fast"), "Fleet.start = 'fast': must be one of settled, rest"),
        (lambda: tr.Fleet(3, 0.1, start=np.ones(40)), "Fleet.start = array"),
        (lambda: tr.Fleet(3, 0.1, start=[]), "Fleet.start"),
        (lambda: tr.Noise(1.0, 1.0, seed=-1), "Noise.seed = -1"),
        (lambda: tr.Noise(1.0, 1.0, seed=1.0), "Noise.seed = 1.0"),
        (lambda: tr.Noise(1.0, 1.0, seed=2**63), "Noise.seed = 9223372036854775808"),
        (lambda: tr.Noise(-1.0, 1.0), "Noise.rms = -1.0"),
        (lambda: tr.Noise(1e10, 1.0), "Noise.rms = 10000000000.0: .* >= 0, at most 1e\\+09 in size"),
        (lambda: tr.Sine(-1e10, 1.0), "Sine.amplitude = -10000000000.0: .*at most 1e\\+09 in size"),
        (lambda: scene(duration=0), "Scene.duration = 0: must be a finite number > 0"),
        (lambda: scene(lift_off=1), "Scene.lift_off = 1: must be True or False"),
        (lambda: scene(lift_off="no"), "Scene.lift_off = 'no'"),
        (lambda: scene(scales={"speed": 1}), "Scene.scales = .*must be Scales or None"),
        (lambda: tr.Scene(np.ones((9, 9)), tr.Fleet(1, 0.1), 1.0), "Scene.road = array.*must be a Road"),
        (lambda: tr.Scene(tr.Road(LENGTH, 0.1), {}, 1.0), "Scene.fleet = {}: must be a Fleet"),
        (lambda: tr.Scales(0, 11, 200), "Scales.speed = 0"),
        (lambda: tr.preset("papre"), "preset 'papre': there is none of that name; choose paper or gravel"),
        (lambda: tr.preset(["paper"]), "choose paper or gravel"),
    ],
)
def test_refused_in_these_words(build, words):
    assert re.search(words, refusal(build))


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        (tr.Sine(1e-3, 0.95), "must be a whole number >= 1; use wavenumber 0.9"),
        (tr.Sine(1e-3, 0.1), "must be a whole number >= 1; use wavenumber 0.9"),
        (tr.Sine(1e-3, 1e300), "at most 10000000"),
        (tr.Noise(1e-3, 0.5), "no wave of a ring of length 6.98132 is that long; use at least 0.9"),
        (tr.Noise(1e-3, 1e308), "at most 10000000"),
        ("flat", "must be Sine, Noise, an array of heights, or None"),
        (1.0, "must be Sine, Noise, an array of heights, or None"),
        ({"kind": "sine"}, "must be Sine, Noise, an array of heights, or None"),
        (np.zeros((3, 4)), r"shape \(nodes,\), not \(3, 4\)"),
        (np.zeros(0), r"shape \(nodes,\), not \(0,\)"),
        ([[1.0], [1.0, 2.0]], "numbers only"),
        (["1", "2"], "numbers only"),
        ([True, False], "numbers only"),
        ([None, 1.0], "numbers only"),
        (np.array([1 + 1j]), "numbers only"),
        ([0.0, np.nan], "height 1 is nan"),
        ([np.inf, 0.0], "height 0 is inf"),
        ([0.0, 0.0, -1e10], "height 2 is -1"),
    ],
)
def test_profile_refused(profile, words):
    assert re.search(words, refusal(tr.Road, LENGTH, 0.1, profile=profile))


def test_the_remedy_for_a_wavenumber_works():
    text = refusal(tr.Road, 7.0, 0.1, profile=tr.Sine(1e-3, 2.6))
    wavenumber, length = (float(text.split(f"{word} ")[-1].split(" ")[0]) for word in ("use wavenumber", "or length"))
    tr.Road(7.0, 0.1, profile=tr.Sine(1e-3, wavenumber))
    tr.Road(length, 0.1, profile=tr.Sine(1e-3, 2.6))


@pytest.mark.parametrize(
    "position",
    [
        (0.0, 1.0, 1.0),
        (0.0, 1.0, LENGTH),
        (0.5, 1.0, 0.5 - LENGTH),
        (0.0, 1.0, 3 * LENGTH),
        (0.0, 1.0, -1e-20),
        (2.0, 1.0, 2.0 + 1e-15),
    ],
)
def test_shared_position(position):
    text = refusal(scene, fleet={"position": position})
    assert "share position" in text and "move one" in text


def test_shared_position_names_the_cars():
    assert "cars 1 and 2 share position 1 " in refusal(scene, fleet={"position": (0.0, 1.0, 1.0)})


def test_positions_lie_on_the_ring():
    assert scene().fleet.positions(6.0).tolist() == [0.0, 2.0, 4.0]
    fleet = tr.Fleet(3, 0.1, position=(-1e-20, LENGTH + 1, -1.0))
    np.testing.assert_allclose(fleet.positions(LENGTH), [0, 1, LENGTH - 1], atol=1e-14)
    assert fleet.positions(LENGTH)[0] == 0.0  # numpy's mod says LENGTH, which is no place on the ring


def test_what_is_allowed():
    assert tr.Road(LENGTH, 0).softness == tr.Constant(0.0)  # no compaction
    assert tr.Road(np.float32(3.0), np.int64(1), np.array(0.5)).diffusivity.value == 0.5
    assert isinstance(tr.Road(np.float64(3.0), 0.1).length, float)
    assert tr.Fleet(np.int32(2), np.float32(0.5)).damping == 0.5
    assert tr.Fleet(1, 0.0, position=4.0).position == (4.0,)
    assert tr.Fleet(3, 0.1, speed=2.0).per_car("speed").tolist() == [2.0, 2.0, 2.0]
    assert scene(lift_off=np.bool_(False)).lift_off is False
    assert scene().headway == pytest.approx(LENGTH / 3)
    assert scene(fleet={"speed": (1, 2, 3)}).headway_time == pytest.approx(LENGTH / 6)
    assert not tr.Road(LENGTH, 0.1).profile.sample(LENGTH, 8).any()


def test_the_hash_of_another_process_is_not_taken_over():
    first = scene(fleet={"start": "rest"})  # strings have another hash in every process
    object.__setattr__(first, "_hash", 1)
    again = pickle.loads(pickle.dumps(first))
    assert hash(first) == 1 and again == first and hash(again) == hash(scene(fleet={"start": "rest"})) != 1
    assert hash(replace(first, duration=8.0)) != 1 and "_hash" not in first.to_dict()


def test_frozen_equal_hashable():
    one, other = scene(fleet={"mass": [1, 2, 3]}), scene(fleet={"mass": np.array([1.0, 2.0, 3.0])})
    assert one == other == scene(fleet={"mass": (1, 2, 3)}) and hash(one) == hash(other)
    assert one != scene(fleet={"mass": (1, 2, 4)}) and one != replace(one, duration=8.0)
    assert tr.Road(1.0, 0.1, profile=np.array([0.0, 1.0])) == tr.Road(1.0, 0.1, profile=[0, 1])
    assert len({one, other, scene()}) == 2
    for value, name in ((one, "duration"), (one.road, "length"), (one.fleet, "count"), (one.road.profile, "amplitude")):
        with pytest.raises(FrozenInstanceError):
            setattr(value, name, 1.0)


# ---------------------------------------------------------------- laws

LAWS = [tr.Constant(0.3), tr.Exponential(0.3, 2.0), tr.Bounded(0.3, 0.7), tr.Exponential(0.3, 0.0), tr.Constant(0.0)]


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_law(law):
    height = np.linspace(-0.65, 1.0, 34)
    step = 1e-6  # differences: truncation step^2 and rounding eps/step, both below 1e-9
    difference = (law(height + step) - law(height - step)) / (2 * step)
    np.testing.assert_allclose(law.derivative(height), difference, atol=1e-8)
    assert np.all(law(height) >= 0) and np.all(np.diff(law(height)) >= 0)
    assert law(0.0) == law.value and law(height).shape == law.derivative(height).shape == height.shape
    assert law(np.arange(3)).dtype == float


def test_laws_by_hand():
    assert tr.Exponential(2.0, 3.0)(-1.0) == pytest.approx(2 * np.exp(-3), rel=1e-15)
    assert tr.Bounded(2.0, 4.0)(-1.0) == pytest.approx(1.5, rel=1e-15)
    assert tr.Bounded(2.0, 4.0)(-4.0) == tr.Bounded(2.0, 4.0)(-9.0) == tr.Bounded(2.0, 4.0).derivative(-9.0) == 0
    assert as_law("softness", tr.Bounded(2, 4)) == tr.Bounded(2.0, 4.0) and as_law("softness", 2) == tr.Constant(2.0)


# ---------------------------------------------------------------- profiles


def test_sine_is_exact():
    x = np.arange(48) * LENGTH / 48
    exact = 0.3 * np.sin(3 * 0.9 * x + 0.4)
    np.testing.assert_allclose(tr.Sine(0.3, 2.7, 0.4).sample(LENGTH, 48), exact, atol=1e-15)
    assert "at least 7 nodes" in refusal(tr.Sine(0.3, 2.7).sample, LENGTH, 6)
    for wave in (tr.Sine(1.0, 0.9 * 5000), tr.Sine(1.0, 0.9 * 3, phase=2 * np.pi * 1e6)):  # no digit lost to many turns
        spectrum = np.abs(np.fft.rfft(wave.sample(LENGTH, 16384), norm="forward"))
        spectrum[wave.highest_wave(LENGTH)] = 0
        assert spectrum.max() < 1e-15


def test_noise_is_one_road_on_every_grid():
    noise = tr.Noise(rms=0.2, max_wavenumber=0.9 * 5.5, seed=3)
    assert noise.highest_wave(LENGTH) == 5
    coarse, fine = (np.fft.rfft(noise.sample(LENGTH, n), norm="forward") for n in (11, 64))
    np.testing.assert_allclose(fine[:6], coarse, atol=1e-16)
    np.testing.assert_allclose(fine[6:], 0, atol=1e-16)
    assert abs(fine[0]) < 1e-16 and np.all(np.abs(fine[1:6]) > 0)
    assert np.std(noise.sample(LENGTH, 64)) == pytest.approx(0.2, rel=1e-14)
    assert "at least 11 nodes" in refusal(noise.sample, LENGTH, 10)
    other = replace(noise, seed=4).sample(LENGTH, 64)
    assert np.abs(np.corrcoef(other, noise.sample(LENGTH, 64))[0, 1]) < 0.99
    wider = np.fft.rfft(tr.Noise(1.0, 0.9 * 9, 3).sample(LENGTH, 64))  # the same lower waves, up to a factor
    np.testing.assert_allclose(wider[1:6] / wider[1], fine[1:6] / fine[1], rtol=1e-12)
    assert tr.Noise(1.0, 0.9 * 5).highest_wave(LENGTH) == 5  # the band's end belongs to it, whatever the rounding


def test_noise_is_gaussian():
    roads = np.array([tr.Noise(1.0, 0.9 * 50, seed).sample(LENGTH, 128)[::7] for seed in range(200)]).ravel()
    assert abs(np.mean(roads**4) - 3) < 0.3  # the standard error of the kurtosis of 3800 is 0.08


@pytest.mark.parametrize("nodes", [15, 16, 33])
@pytest.mark.parametrize(
    "profile",
    [
        tr.Sine(0.3, 4.5, phase=0.7),
        tr.Sine(-0.3, 0.9),
        tr.Noise(0.1, 6.3, seed=3),
        Heights((0.1, 0.3, -0.2, 0.05)),
        Heights((0.2,)),
    ],
)
def test_spectrum_is_that_of_the_heights(profile, nodes):
    heights = profile.sample(LENGTH, nodes)
    np.testing.assert_allclose(
        profile.spectrum(LENGTH, nodes), np.fft.rfft(heights, norm="forward"), rtol=0, atol=1e-16
    )


def test_heights_are_the_trigonometric_interpolant():
    def road(n):
        x = 2 * np.pi * np.arange(n) / n
        return 0.1 + 0.2 * np.sin(x + 0.3) - 0.4 * np.cos(3 * x)

    heights = Heights(road(8))
    assert heights.highest_wave(LENGTH) == 3
    for nodes in (7, 9, 64, 33):
        np.testing.assert_allclose(heights.sample(LENGTH, nodes), road(nodes), atol=1e-15)
    assert np.array_equal(heights.sample(LENGTH, 8), road(8))
    assert "at least 7 nodes" in refusal(heights.sample, LENGTH, 6)
    assert Heights(road(64)).highest_wave(LENGTH) == 3 and len(Heights(road(64)).sample(LENGTH, 7)) == 7


@pytest.mark.parametrize("values", [(0.1, -0.1), (1.0, 0.0, 0.0, 0.0), (3.0,), (0.0, 0.0), (1.0, 2.0, 5.0)])
def test_heights_pass_through_their_points(values):
    heights = Heights(values)
    nodes = 6 * len(values)
    np.testing.assert_allclose(heights.sample(LENGTH, nodes)[::6], values, atol=1e-15)
    # what every user of `highest_wave` relies on
    assert heights.sample(LENGTH, 2 * heights.highest_wave(LENGTH) + 1) is not None


# ---------------------------------------------------------------- plain data and TOML

SCENES = {
    "plain": scene(),
    "exponential": scene(road={"softness": tr.Exponential(0.1, 3.0), "diffusivity": tr.Exponential(0.01, 1.0)}),
    "bounded": scene(road={"softness": tr.Bounded(1 / 3, 0.7), "diffusivity": tr.Bounded(0.01, 1e-9)}),
    "noise": scene(road={"profile": tr.Noise(1e-3, 3.0, 2**63 - 1)}),
    "heights": scene(road={"profile": np.random.default_rng(1).normal(size=7)}),
    "flat": scene(road={"profile": None}),
    "mixed": scene(
        fleet={
            "damping": (0.1, 1 / 3, 0.2),
            "speed": np.array([1.0, 0.9, 1.1]),
            "frequency": [1, 2, 3],
            "mass": (1.0, 2.0, 0.1 + 0.2),
            "position": (0.0, 1e-7, 20.0),
            "start": "rest",
        },
        lift_off=False,
    ),
    "scales": scene(scales=tr.Scales(11.1, 10.0, 200.0, 9.8)),
    "preset": tr.preset("paper"),
    "gravel": tr.preset("gravel"),
    "extremes": scene(road={"softness": 5e-324}, duration=1.7e308),
}


@pytest.mark.parametrize("name", SCENES)
def test_round_trip(name, tmp_path):
    one = SCENES[name]
    text = one.to_toml(tmp_path / "scene.toml")
    assert text == (tmp_path / "scene.toml").read_text()
    for other in (
        tr.Scene.from_toml(tmp_path / "scene.toml"),
        tr.Scene.from_dict(one.to_dict()),
        tr.Scene.from_dict(json.loads(json.dumps(one.to_dict()))),
    ):
        assert other == one and hash(other) == hash(one) and other.to_toml() == text


def test_toml_by_hand(tmp_path):
    (tmp_path / "a.toml").write_text(
        "duration = 10\n[road]\nlength = 6\nsoftness = 1\nprofile = [0, 0.1]\n[fleet]\ncount = 2\ndamping = [0.1, 1]\n"
    )
    by_hand = tr.Scene(tr.Road(6.0, 1.0, profile=(0.0, 0.1)), tr.Fleet(2, (0.1, 1.0)), 10.0)
    assert tr.Scene.from_toml(tmp_path / "a.toml") == by_hand


GOOD = SCENES["plain"].to_dict()


def changed(path, value):
    """GOOD with one key set to `value`, or left out if that is the class `dict`."""
    data = json.loads(json.dumps(GOOD))
    *parents, key = path.split(".")
    table = data
    for parent in parents:
        table = table[parent]
    table[key] = value
    if value is dict:
        del table[key]
    return data


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("wheels", 1, "scene: unknown key 'wheels'; allowed are road, fleet"),
        ("road.wheels", 1, "road: unknown key 'wheels'; allowed are length"),
        ("fleet.wheels", 1, "fleet: unknown key 'wheels'"),
        ("road.profile.wheels", 1, "road.profile: unknown key 'wheels'; allowed are amplitude"),
        ("scales", {"speed": 1, "frequency": 1, "vehicles_per_day": 1, "g": 9}, "scales: unknown key 'g'"),
        ("duration", dict, "scene: key 'duration' is missing"),
        ("road", dict, "scene: key 'road' is missing"),
        ("road.length", dict, "road: key 'length' is missing"),
        ("fleet.count", dict, "fleet: key 'count' is missing"),
        ("road.profile.amplitude", dict, "road.profile: key 'amplitude' is missing"),
        ("scales", {"speed": 1, "frequency": 1}, "scales: key 'vehicles_per_day' is missing"),
        ("road", 3, "road = 3: must be a table"),
        ("fleet", [1], "fleet = [1]: must be a table"),
        ("scales", "si", "scales = 'si': must be a table"),
        ("duration", "long", "Scene.duration = 'long'"),
        ("lift_off", 1, "Scene.lift_off = 1"),
        ("road.softness", "soft", "Road.softness = 'soft'"),
        ("road.softness", {"law": "x"}, "road.softness.law = 'x': must be one of constant, exponential, bounded"),
        ("road.softness", {}, "road.softness.law = None: must be one of"),
        ("road.softness", {"law": ["x"]}, "road.softness.law = ['x']: must be one of"),
        ("road.softness", {"law": {"a": 1}}, "road.softness.law = {'a': 1}: must be one of"),
        ("road.diffusivity", {"law": "bounded", "value": 1}, "road.diffusivity: key 'depth' is missing"),
        ("road.diffusivity", {"law": "bounded", "value": 1, "depth": "x"}, "Bounded.depth = 'x'"),
        ("road.profile", "flat", "profile = 'flat'"),
        ("road.profile", {"kind": "saw"}, "road.profile.kind = 'saw': must be one of sine, noise, heights"),
        ("road.profile", {"kind": []}, "road.profile.kind = []"),
        ("road.profile", {"kind": "heights", "values": "abc"}, "numbers only"),
        ("fleet.count", "8", "Fleet.count = '8'"),
        ("fleet.damping", {"a": 1}, "Fleet.damping"),
        ("fleet.start", ["rest"], "Fleet.start = ['rest']"),
    ],
)
def test_wrong_toml(path, value, words, tmp_path):
    (tmp_path / "a.toml").write_text(tomli_w.dumps(changed(path, value)))
    text = refusal(tr.Scene.from_toml, tmp_path / "a.toml")
    assert text.startswith(f"{tmp_path}/a.toml: ") and words in text


def test_no_scene_at_all(tmp_path):
    for value in (None, 3, [GOOD], "road"):
        assert "must be a table" in refusal(tr.Scene.from_dict, value)
    assert "unknown key 3" in refusal(tr.Scene.from_dict, {**GOOD, 3: 4})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"road = ", "cannot read the scene: Invalid value"),
        (b"road = 1\nroad = 2", "cannot read the scene: Cannot overwrite"),
        (b"\xff\xfe", "cannot read the scene: 'utf-8' codec"),
        (b"a = " + b"[" * 5000, "cannot read the scene"),
        (b"a = " + b"9" * 5000, "cannot read the scene"),
        (b"", "is missing"),
    ],
)
def test_broken_file(content, words, tmp_path):
    (tmp_path / "a.toml").write_bytes(content)
    assert words in refusal(tr.Scene.from_toml, tmp_path / "a.toml")


def test_a_scene_is_data(tmp_path, opened):
    """No name in it is opened, nothing in it is run."""
    (tmp_path / "secret").write_text("1\n2\n3\n")
    for path, value in (
        ("road.profile", str(tmp_path / "secret")),
        ("road.profile", {"kind": "heights", "values": str(tmp_path / "secret")}),
        ("road.profile", {"kind": "file", "path": str(tmp_path / "secret")}),
        ("road.profile", {"kind": "heights", "values": [], "path": str(tmp_path / "secret")}),
        ("road.softness", f"open({str(tmp_path / 'touched')!r}, 'w')"),
        ("fleet.damping", "__import__('os').system('true')"),
        ("include", str(tmp_path / "secret")),
        ("duration", "${HOME}"),
    ):
        (tmp_path / "a.toml").write_text(tomli_w.dumps(changed(path, value)))
        opened.clear()
        refusal(tr.Scene.from_toml, tmp_path / "a.toml")
        assert [os.path.basename(name) for name in opened] == ["a.toml"]
    assert sorted(os.listdir(tmp_path)) == ["a.toml", "secret"]


@pytest.fixture
def opened():
    """Names of the files that are opened, of processes and of compiled code while the test runs."""
    names, listening = [], [True]
    watched = {
        "open": 0,
        "exec": 0,
        "compile": 1,
        "os.system": 0,
        "subprocess.Popen": 0,
        "import": 0,
        "socket.connect": 1,
    }

    def hook(event, arguments):
        if listening[0] and event in watched:
            names.append(str(arguments[watched[event]]))

    sys.addaudithook(hook)  # for good: Python has no way to take it back
    yield names
    listening[0] = False


def test_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")  # nobody will ever write to it
    for path in (tmp_path / "pipe.toml", "/dev/zero"):
        assert "no regular file" in refusal(tr.Scene.from_toml, path)


def test_no_file(tmp_path):
    assert "No such file" in refusal(tr.Scene.from_toml, tmp_path / "none.toml")
    assert "Is a directory" in refusal(tr.Scene.from_toml, tmp_path)
    assert "cannot read" in refusal(tr.Scene.from_toml, "a\0b")
    assert "cannot read" in refusal(tr.Scene.from_toml, None)
    assert "cannot write the scene: No such file" in refusal(scene().to_toml, tmp_path / "none" / "a.toml")
    assert "cannot write the scene" in refusal(scene().to_toml, "a\0b")
