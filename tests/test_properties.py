"""Whatever is put in, a result comes out, or one line of the package's own: no trace, no silent NaN, no hang."""

import contextlib
import io
import math
import os
import signal
import warnings
from functools import lru_cache

import numpy as np
import pytest
import tomli_w
import xarray as xr
from hypothesis import assume, given, note
from hypothesis import strategies as st

import traffic_road as tr
from traffic_road import cli
from traffic_road.models import model
from traffic_road.models.cars import numerics as of_cars

SECONDS = 100  # above what compiling all kernels takes on a busy machine
WORK = 2e6  # car-node updates up to which a scene is run here

# ---------------------------------------------------------------- what is put in

NUMBERS = (0, 0.0, -0.0, -1, 1, 5e-324, 1e-300, 1e-30, 1e-9, 1e9, 1e30, 1e300, 10**400, math.nan, math.inf, -math.inf)
THINGS = (True, None, "", "1", b"1", 1j, [], [1.0], {}, {"a": 1}, object(), np.float32(1), np.array([1.0, 2.0]))
ODD = st.sampled_from(NUMBERS + THINGS)
ANY = st.one_of(ODD, st.floats(), st.integers(-(10**6), 10**6), st.text(max_size=5))
# what a file can hold
PLAIN = st.one_of(
    st.sampled_from(
        [0, -1, 5e-324, 1e-30, 1e30, 1e300, math.nan, math.inf, True, "", [], [1.0], {}, {"law": "constant"}]
    ),
    st.floats(),
    st.integers(-(2**63), 2**63 - 1),
    st.text(st.characters(codec="utf-8"), max_size=5),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.sampled_from(["law", "kind", "value", "depth", "count"]), st.floats(0, 2), max_size=3),
)


def size(low, high):
    """Numbers evenly spread over the decades from `low` to `high`."""
    return st.floats(math.log10(low), math.log10(high)).map(lambda e: 10**e)


LAW = st.one_of(
    st.just(0.0),
    size(1e-6, 10),
    st.builds(lambda v, h: {"law": "exponential", "value": v, "hardening": h}, size(1e-6, 10), size(1e-6, 1e6)),
    st.builds(lambda v, d: {"law": "bounded", "value": v, "depth": d}, size(1e-6, 10), size(1e-6, 1e6)),
)


@st.composite
def tables(draw):
    """The plain data of a scene that is legal, if extreme."""
    length, count = draw(size(1e-2, 1e3)), draw(st.integers(1, 12))
    wave = 2 * math.pi / length

    def per_car(values):
        return draw(st.one_of(values, st.lists(values, min_size=count, max_size=count)))

    profile = draw(
        st.one_of(
            st.just({"kind": "heights", "values": [0.0]}),
            st.builds(
                lambda a, n: {"kind": "sine", "amplitude": a, "wavenumber": n * wave},
                size(1e-9, 1e3),
                st.integers(1, 9),
            ),
            st.builds(
                lambda a, n, s: {"kind": "noise", "rms": a, "max_wavenumber": n * wave, "seed": s},
                size(1e-9, 1e3),
                st.floats(1, 20),
                st.integers(0, 2**63 - 1),
            ),
            st.lists(st.floats(-10, 10), min_size=1, max_size=12).map(lambda v: {"kind": "heights", "values": v}),
        )
    )
    data = {
        "duration": draw(size(1e-3, 1e3)),
        "lift_off": draw(st.booleans()),
        "road": {
            "length": length,
            "softness": draw(LAW),
            "diffusivity": draw(st.one_of(st.just(0.0), LAW)),
            "profile": profile,
        },
        "fleet": {
            "count": count,
            "damping": per_car(size(1e-6, 1e3)),
            "speed": per_car(size(0.03, 30)),
            "frequency": per_car(size(0.03, 30)),
            "mass": per_car(size(1e-3, 1e3)),
            "start": draw(st.sampled_from(["settled", "rest"])),
        },
    }
    if draw(st.booleans()):
        data["fleet"]["position"] = draw(st.lists(st.floats(-1e3, 1e3), min_size=count, max_size=count))
    if draw(st.booleans()):
        scale = size(1e-3, 1e3)
        data["scales"] = {"speed": draw(scale), "frequency": draw(scale), "vehicles_per_day": draw(scale)}
    return data


@st.composite
def spoilt(draw, odd=ANY):
    """The same with one or two values replaced, added or left out."""
    data = draw(tables())
    for _ in range(draw(st.integers(1, 2))):
        table = draw(st.sampled_from([t for t in (data, data.get("road"), data.get("fleet")) if isinstance(t, dict)]))
        inner = [t for t in table.values() if isinstance(t, dict)]
        if inner and draw(st.booleans()):
            table = draw(st.sampled_from(inner))
        key = draw(
            st.one_of(st.sampled_from(sorted(table) or ["x"]), st.sampled_from(["x", "law", "kind", "position"]))
        )
        if draw(st.integers(0, 4)):
            table[key] = draw(odd)
        else:
            table.pop(key, None)
    return data


# ---------------------------------------------------------------- what must come out


class _Hang(BaseException):
    """Passes every `except Exception`."""


@contextlib.contextmanager
def outcome():
    """A one-line error of the package is an outcome; anything else, a warning of numpy too, passes on."""

    def hang(*_):
        raise _Hang(f"still running after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, hang)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            warnings.simplefilter("ignore", UserWarning)
            yield
    except tr.TrafficRoadError as error:
        text = str(error)
        note(text)
        assert type(error) is not tr.TrafficRoadError or "wave" in text or "branch" in text, text
        assert "\n" not in text and 10 < len(text) < 500, text
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def sound(ds, may_be_missing=()):
    """Every number is there: a gap is one that the documentation names."""
    for name, values in ds.variables.items():
        if values.dtype.kind == "f" and name not in may_be_missing:
            assert np.isfinite(values.values).all(), name


def affordable(scene, name, given):
    """Whether a run is short enough to be tried here; SceneError as `simulate` says it."""
    if name == "auto":  # it may take any, with numerics of its own
        return all(affordable(scene, other, {}) for other in ("cars", "continuum"))
    chosen = model(name).numerics(scene, given)
    if name == "linear":
        return chosen["nodes"] < WORK
    if name == "continuum":
        return scene.duration / chosen["step"] * chosen["nodes"] < WORK / 20
    duration = max(
        scene.duration, scene.headway_time * chosen["relax_every"]
    )  # no run of evenly spaced cars is shorter
    updates = duration * float(scene.fleet.per_car("speed").sum()) * chosen["nodes"] / scene.road.length
    relaxed = duration / scene.headway_time / chosen["relax_every"]
    law, dx = scene.road.diffusivity, scene.road.length / chosen["nodes"]
    if not isinstance(law, tr.Constant):  # polynomials in the operator: a transform each
        with np.errstate(all="ignore"):
            most = float(law(np.max(scene.road.profile.sample(scene.road.length, chosen["nodes"]))))
        relaxed *= 30 * (1 + np.sqrt(min(most, 1e30) * scene.headway_time) / dx)
    return updates < WORK and relaxed * chosen["nodes"] < WORK


# ---------------------------------------------------------------- scenes and TOML


@given(spoilt())
def test_a_scene_of_any_data(data):
    with outcome():
        scene = tr.Scene.from_dict(data)
        assert tr.Scene.from_dict(scene.to_dict()) == scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("properties")


@given(spoilt(PLAIN), st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=3), st.integers(0, 3)), max_size=3))
def test_a_scene_of_any_file(folder, data, edits):
    try:
        content = tomli_w.dumps(data).encode()
    except (TypeError, ValueError):
        assume(False)
    for place, added, removed in edits:
        at = int(place * len(content))
        content = content[:at] + added + content[at + removed :]
    (folder / "a.toml").write_bytes(content)
    with outcome():
        scene = tr.Scene.from_toml(folder / "a.toml")
        scene.to_toml(folder / "b.toml")
        assert tr.Scene.from_toml(folder / "b.toml") == scene


# ---------------------------------------------------------------- runs

NUMERICS = {
    "nodes": st.one_of(st.integers(-1, 300), ODD),
    "hold": st.one_of(st.sampled_from([1, 3, 5]), ODD),
    "relax_every": st.one_of(st.integers(1, 50), ODD),
    "step": st.one_of(size(1e-3, 1e3), ODD),
}
SAMPLES = st.one_of(
    st.integers(2, 5), ODD, st.lists(st.floats(0, 10), max_size=4).map(sorted), st.just([0.0, 1.0]), st.just([0, 1e300])
)


@given(
    st.one_of(tables(), spoilt(PLAIN)),
    st.sampled_from(["cars", "continuum", "linear", "auto"]),
    st.one_of(st.just({}), st.fixed_dictionaries({}, optional=NUMERICS)),
    st.one_of(st.just(3), SAMPLES),
    st.one_of(st.just(1.0), ODD),
)
def test_a_run(data, name, given, samples, tolerance):
    with outcome():
        scene = tr.Scene.from_dict(data)
        last = (
            samples[-1] if isinstance(samples, list) and samples and isinstance(samples[-1], float) else scene.duration
        )
        if not affordable(scene, name, given) or not last <= scene.duration:
            return
        ds = tr.simulate(scene, name, tolerance, samples, **given)
        note(str(ds.attrs))
        assert tr.rerun(ds, samples=2).road_height[0].identical(ds.road_height[0])
        sound(ds)
        assert ds.status == "ok" or ds.status.startswith("diverged between time ")
        assert ds.error_estimate >= 0 and ds.road_height.dims == ("time", "x")
        assert ds.time[0] == 0 and np.all(np.diff(ds.time) > 0)


@given(tables(), st.one_of(st.none(), size(1e-3, 1e3)))
def test_a_comparison(data, wavenumber):
    with outcome():
        scene = tr.Scene.from_dict(data)
        if not all(affordable(scene, name, {}) for name in ("cars", "continuum")):
            return
        ds = tr.compare(scene, wavenumber=wavenumber, samples=5, tolerance=1.0)
        theory = ("growth_rate", "phase_velocity", "growth_rate_difference", "phase_velocity_difference")
        sound(ds, theory)


# ---------------------------------------------------------------- theory

K = st.one_of(size(1e-6, 1e6), ANY)
POSITIVE = st.one_of(size(1e-9, 1e3), ANY)
ROAD = {"softness": POSITIVE, "diffusivity": POSITIVE, "damping": POSITIVE}
RATE = {"hardening_rate": POSITIVE}
THEORY = {
    "dispersion": ([K], ROAD, RATE | {"headway": POSITIVE}),
    "dispersion_roots": ([K], ROAD, RATE),
    "dispersion_leading": ([K], ROAD, RATE),
    "neutral_softness": ([K], {"diffusivity": POSITIVE, "damping": POSITIVE}, RATE),
    "stability_boundary": ([POSITIVE], {}, {"points": st.one_of(st.integers(0, 50), ODD)}),
    "critical_ratio": ([POSITIVE], {}, {"hardening": POSITIVE}),
    "fastest_mode": ([POSITIVE, POSITIVE], {}, {}),
    "fastest_mode_exact": ([POSITIVE, POSITIVE, POSITIVE], {}, RATE),
    "jump_ratio": ([K], {}, {}),
    "merging_ratio": ([K], {}, {}),
    "critical_speed": (
        [POSITIVE] * 3,
        {},
        {"diffusion_per_passage": POSITIVE, "hardening": POSITIVE, "flux": POSITIVE},
    ),
    "critical_flux": ([POSITIVE] * 4, {}, {"diffusion_per_passage": POSITIVE, "diffusion_per_second": POSITIVE}),
    "algebraic_exponent": ([K], ROAD | {"hardening": POSITIVE}, {}),
    "settle": (
        [POSITIVE, POSITIVE, st.lists(size(1e-3, 1e3), max_size=3).map(sorted)],
        {},
        {"height": ANY, "full": st.booleans()},
    ),
}
# values that are documented to be so: no finite answer, or an iteration without a root
INFINITE = {"neutral_softness", "critical_speed", "critical_flux"}
MISSING = {"neutral_softness", "dispersion"}


def test_a_softness_that_no_integrator_can_follow_is_refused():
    with outcome(), pytest.raises(tr.TrafficRoadError, match="softness"):
        tr.theory.settle(1e300, 1.0, [1.0])


def test_a_wave_shorter_than_two_nodes_has_no_growth_rate_on_the_grid():
    scene = tr.Scene(tr.Road(10.0, 0.0, 0.0), tr.Fleet(1, 0.1, speed=10**-1.25, frequency=10**-0.75), 1.0)
    assert np.isfinite(tr.theory.floquet(scene, 0.999 * np.pi * 4 / 10, nodes=4))
    with outcome(), pytest.raises(tr.TrafficRoadError, match="two nodes"):
        tr.theory.floquet(scene, 6.698965412102164e16, nodes=4, relax_every=4)


@given(st.data(), st.sampled_from(sorted(THEORY)))
def test_theory(data, name):
    positional, needed, optional = THEORY[name]
    arguments = [data.draw(a) for a in positional]
    keys = data.draw(st.fixed_dictionaries(needed, optional=optional))
    note(f"{name}({arguments}, {keys})")
    with outcome():
        found = getattr(tr.theory, name)(*arguments, **keys)
        for values in found.variables.values() if isinstance(found, xr.Dataset) else np.atleast_1d(found):
            values = np.asarray(values)
            allowed = np.isfinite(values)
            if name in INFINITE:
                allowed |= np.isinf(values)
            if name in MISSING and (name != "dispersion" or "headway" in keys):
                allowed |= np.isnan(values)
            assert allowed.all(), values


@given(tables(), K, st.fixed_dictionaries({}, optional={n: NUMERICS[n] for n in ("nodes", "hold", "relax_every")}))
def test_theory_of_a_scene(data, k, given):
    with outcome():
        scene = tr.Scene.from_dict(data)
        assert np.isfinite(tr.theory.fleet_dispersion(k, scene.fleet, softness=0.1, diffusivity=0.01)).all()
    with outcome():
        scene = tr.Scene.from_dict(data)
        if of_cars(scene, given)["nodes"] <= 200 * scene.fleet.count:  # seconds for a larger matrix
            assert np.isfinite(tr.theory.floquet(scene, k, **given))


# ---------------------------------------------------------------- results and files


@lru_cache
def result(name):
    scene = tr.Scene.from_dict({**tr.preset("paper").to_dict(), "duration": 20.0})
    if name == "compare":
        return tr.compare(scene, samples=4, nodes=64, tolerance=1.0)
    return tr.simulate(scene, name, samples=4, tolerance=1.0, nodes=64)


@st.composite
def damaged(draw):
    """A result with some of its parts missing, renamed or of another kind."""
    ds = result(draw(st.sampled_from(["cars", "continuum", "compare"]))).copy(deep=True)
    for _ in range(draw(st.integers(0, 3))):
        what = draw(st.integers(0, 4))
        name = draw(st.sampled_from(sorted(map(str, ds.variables)) or ["x"]))
        if what == 0:
            ds = ds.drop_vars([name], errors="ignore")
        elif what == 1 and name in ds.dims:
            ds = ds.isel({name: slice(0, draw(st.integers(0, 1)))})
        elif what == 2 and name in ds:
            ds = ds.rename({name: "other"}) if "other" not in ds.variables else ds
        elif what == 3 and name in ds and ds[name].dtype.kind == "f":
            ds[name] = ds[name].dims, np.full(ds[name].shape, draw(st.sampled_from([np.nan, np.inf, 0.0, 1e300])))
        else:
            ds.attrs[draw(st.sampled_from(sorted(ds.attrs)))] = draw(st.one_of(ODD, st.just("{}")))
    return ds


@given(st.one_of(damaged(), ANY), st.one_of(st.just(0.9), ANY))
def test_analysis(ds, wavenumber):
    scales = tr.Scales(11.0, 11.0, 200.0)
    for call in (tr.mode, tr.growth_rate, tr.phase_velocity):
        with outcome():
            call(ds, wavenumber)
    for call in (tr.coarse_grain, tr.rerun):
        with outcome():
            call(ds)
    for other in (scales, wavenumber):
        with outcome():
            tr.to_si(ds, other)


@given(
    st.sampled_from(["cars", "continuum", "compare"]),
    st.lists(st.tuples(st.floats(0, 1), st.integers(0, 7)), max_size=4),
    st.one_of(st.just(1.0), st.floats(0, 1)),
)
def test_a_file_with_wrong_bits(folder, name, flips, kept):
    path = folder / f"{name}.nc"
    if not path.exists():
        tr.save(result(name), path)
    content = bytearray(path.read_bytes())
    for place, bit in flips:
        content[min(int(place * len(content)), len(content) - 1)] ^= 1 << bit
    (folder / "wrong.nc").write_bytes(content[: int(kept * len(content))])
    with outcome():
        ds = tr.open(folder / "wrong.nc")
        for use in (
            lambda: tr.mode(ds, 0.9),
            lambda: tr.coarse_grain(ds),
            lambda: tr.to_si(ds, tr.Scales(11, 11, 200)),
        ):
            with outcome():
                use()


# ---------------------------------------------------------------- command lines

TOKENS = (
    "run compare plot presets paper gravel s.toml r.nc o.nc p.png -o --model cars continuum --plot --samples 3 --nodes 64 "
    "--hold --relax-every --step 0.5 -h -- --wavenumber 0.9 --tolerance 1 nan -1 1e400 . / /dev/null none/x.nc auto"
)
WORDS = st.one_of(st.sampled_from(TOKENS.split()), st.text(st.characters(blacklist_characters="/"), max_size=4))
LINES = st.one_of(
    st.lists(WORDS, max_size=8),
    st.lists(WORDS, max_size=4).map(lambda w: ["run", "s.toml", "-o", "o.nc", "--samples", "3", "--nodes", "64", *w]),
    st.lists(WORDS, max_size=4).map(
        lambda w: ["compare", "s.toml", "-o", "c.nc", "--samples", "3", "--nodes", "64", *w]
    ),
)


@given(LINES)
def test_a_command_line(folder, words):
    with contextlib.chdir(folder):
        scene = {**tr.preset("paper").to_dict(), "duration": 5.0}
        tr.Scene.from_dict(scene).to_toml("s.toml")
        if not os.path.exists("r.nc"):
            tr.save(result("cars"), "r.nc")
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), outcome():
            try:
                status = cli.main(words)
            except SystemExit as stop:
                status = stop.code
        assert status in (0, 1, 2), words
        lines = err.getvalue().splitlines()
        assert all(line.startswith("traffic-road: ") and "unexpected" not in line for line in lines), err.getvalue()
        assert (status == 0) == (not any("warning" not in line for line in lines)), err.getvalue()
