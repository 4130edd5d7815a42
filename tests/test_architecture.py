"""Rooms stand on floors: an import goes down or stays in its room, and inside a room nothing goes in a circle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"astrojax": "astrojax/src", "owm_envs": "outofthisworldmodel-envs/src", "owm": "outofthisworldmodel/src"}
FLOORS = {
    "astrojax": [
        {"_types", "constants", "compilation"},
        {"time", "attitude", "propagate"},
        {"frames", "ephemeris"},
        {"orbits"},
        {"forces"},
        {"estimate"},
    ],
    "owm_envs": [
        {"words", "registration", "files", "cores", "flags", "view", "pipeline"},
        {"shell", "station", "claims", "video", "hub_client"},
        {"config", "hub", "figures"},
        {"dynamics"},
        {"task"},
        {"camera"},
        {"env"},
        {"field", "episode"},
        {"policies"},
        {"rollout", "adapters"},
        {"datasets", "testing", "pettingzoo", "sb3"},
        {"film"},
        {"replay"},
        {"commands"},
        {"cli"},
        {"__main__"},
    ],
    "owm": [
        {"interface", "checkpoint", "console", "stages"},
        {"data"},
        {"motion"},
        {"model", "scores"},
        {"report", "planning", "testing"},
        {"training"},
        {"baselines"},
        {"catalogue"},
        {"study"},
        {"commands"},
        {"cli"},
        {"__main__"},
    ],
}
"""Rooms of a package, from the ground up; those on one floor do not know each other."""


def modules(package: str) -> dict[str, Path]:
    """Every module of a package by its dotted name; a package's `__init__` has the package's."""
    source = ROOT / SOURCES[package]
    files = (source / package).rglob("*.py")
    return {".".join(f.relative_to(source).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


MODULES = {package: modules(package) for package in SOURCES}
EVERY = {name for names in MODULES.values() for name in names}


def imports(name: str, file: Path) -> set[str]:
    """The modules of this project that a module imports, wherever in it the import stands."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports here are absolute"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (inside & EVERY) or {node.module}
    return {module for module in found if module in EVERY and module != name}


def room(module: str) -> str:
    """The part of a package that a module belongs to."""
    return (module.split(".") + [""])[1]


@pytest.mark.parametrize("package", SOURCES)
def test_no_module_is_part_of_a_circle(package):
    graph = {name: imports(name, file) & set(MODULES[package]) for name, file in MODULES[package].items()}
    # A room's `__init__` is its front door: it names what is inside, and is no part of a circle with it.
    inside = {name: {d for d in found if not name.startswith(d + ".")} for name, found in graph.items()}
    try:
        tuple(TopologicalSorter(inside).static_order())
    except CycleError as error:
        pytest.fail(f"a circle: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize("package", FLOORS)
def test_no_room_knows_one_above_it(package):
    floor = {name: level for level, rooms in enumerate(FLOORS[package]) for name in rooms}
    unplaced = {room(name) for name in MODULES[package]} - {*floor, ""}
    assert not unplaced, f"rooms without a floor: {sorted(unplaced)}"
    upward = [
        f"{name} -> {other}"
        for name, file in MODULES[package].items()
        for other in imports(name, file)
        if room(name) and room(other) and other.split(".")[0] == package and room(other) != room(name)
        if floor[room(other)] >= floor[room(name)]
    ]
    assert not upward, "\n".join(sorted(upward))


def test_no_package_knows_one_that_stands_on_it():
    order = list(SOURCES)
    upward = [
        f"{name} -> {other}"
        for level, package in enumerate(order)
        for name, file in MODULES[package].items()
        for other in imports(name, file)
        if order.index(other.split(".")[0]) > level
    ]
    assert not upward, "\n".join(sorted(upward))
