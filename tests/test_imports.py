"""One way through: scene -> model -> Dataset -> analysis -> figure -> command line, theory beside. No import goes back."""

import ast
import re
from pathlib import Path

import traffic_road

ROOT = Path(traffic_road.__file__).parent

# a module may import those of a lower rank, and those of its own package where MAY says so
RANK = {
    "errors": 0,
    "compiled": 0,
    "laws": 1,
    "memory": 1,
    "profiles": 2,
    "schemes": 2,
    "scales": 2,
    "scene": 3,
    "presets": 4,
    "theory": 4,
    "models": 4,
    "store": 4,
    "estimate": 5,
    "health": 5,
    "costs": 5,
    "outlook": 5,
    "predict": 6,
    "predict_runs": 7,
    "planning": 8,
    "stream": 5,
    "checkpoint": 5,
    "signals": 5,
    "keeper": 6,
    "run": 9,
    "measures": 8,
    "sweeps": 10,
    "sweep_command": 11,
    "analysis": 5,
    "comparison": 10,
    "plots": 11,
    "cli": 12,
    "": 0,  # traffic_road/__init__.py: names only, loaded when asked for
}
PACKAGES = {"schemes", "theory", "models", "sweeps"}
# what the rank would allow and the house rules do not: physics knows no files, schemes no scenes, plots do not simulate
FORBIDDEN = {
    ("models", "scene"),
    ("models", "profiles"),
    ("models", "scales"),
    ("schemes", "profiles"),
    ("theory", "scene"),
    ("theory", "profiles"),
    ("plots", "run"),
    ("plots", "models"),
    ("plots", "sweeps"),
    ("plots", "estimate"),
    ("analysis", "models"),
    ("analysis", "schemes"),
    ("store", "models"),
    ("store", "theory"),
}
ALLOWED = {
    ("theory/floquet", "models/cars"),  # in a function: the defaults of the scheme that it describes
    ("models/linear_state", "theory/floquet"),  # the one model that is a closed form
    ("models/linear_state", "theory/dispersion"),
}


def imports(path):
    """Modules of the package that the file at `path` imports, as "laws" or "models/cars"; "" is the package itself."""
    here = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            targets = [alias.name.split(".") for alias in node.names if alias.name.split(".")[0] == "traffic_road"]
            yield from ("/".join(target[1:]) for target in targets)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                base = [*here[: len(here) + 1 - node.level], *(node.module or "").split(".")]
            elif (node.module or "").split(".")[0] == "traffic_road":
                base = node.module.split(".")[1:]
            else:
                continue
            base = [part for part in base if part]
            for alias in node.names:
                inner = ROOT.joinpath(*base, alias.name)
                is_module = inner.is_dir() or inner.with_suffix(".py").exists()
                yield "/".join([*base, alias.name] if is_module else base)


def wrong(module, target):
    """Why `module` may not import `target`; None if it may."""
    if (module, target) in ALLOWED:
        return None
    own, other = module.split("/")[0], target.split("/")[0]
    if own == other and own in PACKAGES:
        return None
    for name in (own, other):
        if name not in RANK:
            return f"{name} has no rank: give it one in {Path(__file__).name}"
    if (own, other) in FORBIDDEN:
        return "the house rules forbid it"
    return None if RANK[other] < RANK[own] else f"rank {RANK[other]} is not below {RANK[own]}"


def test_no_import_goes_back():
    found = []
    for path in sorted(ROOT.rglob("*.py")):
        module = path.relative_to(ROOT).with_suffix("").as_posix().removesuffix("__init__").rstrip("/")
        for target in imports(path):
            reason = wrong(module, target) if module else None
            if reason:
                found.append(f"{module} imports {target}: {reason}")
    assert not found, "\n".join(found)


def test_the_rule_bites():
    for module, target in (
        ("schemes/oscillator", "scene"),
        ("schemes/passage", "models/even_kernels"),
        ("laws", "models"),
        ("profiles", "scene"),
        ("scene", "store"),
        ("models/cars", "store"),
        ("models/cars", "run"),
        ("models/even_kernels", "analysis"),
        ("models/continuum", "theory/dispersion"),
        ("theory/dispersion", "models/cars"),
        ("theory/waves", "store"),
        ("store", "run"),
        ("analysis", "run"),
        ("plots", "run"),
        ("run", "plots"),
        ("run", "cli"),
        ("newcomer", "laws"),
    ):
        assert wrong(module, target), (module, target)
    for module, target in (("theory/floquet", "schemes/oscillator"), ("models/cars", "laws"), ("cli", "run")):
        assert wrong(module, target) is None


def test_imports_are_seen():
    assert {"errors", "laws", "models/cars_even"} <= set(imports(ROOT / "models" / "cars.py"))
    assert "models/cars" in set(imports(ROOT / "theory" / "floquet.py"))  # inside a function
    assert {"run", "plots", "store"} <= set(imports(ROOT / "cli.py"))


def test_what_takes_long_to_load_waits_until_it_is_asked_for():
    # at the top of any module it would be loaded by every run, and by every process of a sweep
    slow = re.compile(r"^(from|import) scipy\b", re.M)
    assert [path.name for path in ROOT.rglob("*.py") if slow.search(path.read_text(encoding="utf-8"))] == []


def test_public_names_exist():
    for name in traffic_road.__all__:
        assert getattr(traffic_road, name) is not None
