"""The public names of each room: those of its stub, which load on first use."""

import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

import forcectl as fc
from forcectl.graph.export import Graph
from forcectl.models import models_folder
from forcectl.scenario.catalog import SLOTS
from tests.examples.block_examples import EXAMPLES

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = sorted(stub.parent for stub in [*ROOT.glob("forcectl/__init__.pyi"), *ROOT.glob("forcectl/*/__init__.pyi")])
# Rooms without a stub: the command line, links to folders that hold no blocks, and the doctor, whose modules are called
# as its names.
ELSEWHERE = {"cli", "doctor", "experiments", "models"}


def package(folder: Path) -> str:
    return ".".join(folder.relative_to(ROOT).parts)


def exported() -> dict[str, list[str]]:
    return {package(folder): dir(import_module(package(folder))) for folder in PACKAGES}


def test_every_room_has_a_stub():
    rooms = {init.parent.name for init in ROOT.glob("forcectl/*/__init__.py")}
    assert models_folder().name in rooms
    assert rooms - {folder.name for folder in PACKAGES} == ELSEWHERE


@pytest.mark.parametrize("folder", PACKAGES, ids=package)
def test_names_of_the_stub_are_imported_and_say_what_they_are(folder):
    room = import_module(package(folder))
    lines = [line.split()[-1] for line in (folder / "__init__.pyi").read_text().splitlines() if " as " in line]
    assert dir(room) == sorted(name.rstrip(",") for name in lines) == sorted(room.__all__)
    for name in dir(room):
        value = getattr(room, name)
        assert inspect.getdoc(value), name
        assert inspect.ismodule(value) or value.__module__.startswith(package(folder)), name


@pytest.mark.parametrize("folder", PACKAGES, ids=package)
def test_no_name_is_that_of_a_module(folder):
    """The import of a module sets an attribute of its package; only `forcectl.graph`, which can be called, is both."""
    modules = {path.stem for path in [*folder.glob("*.py"), *(init.parent for init in folder.glob("*/__init__.py"))]}
    assert modules & set(dir(import_module(package(folder)))) == ({"graph"} if folder.name == "forcectl" else set())


def test_every_block_and_what_fills_a_slot_is_exported_by_its_room():
    names = exported()
    public = {(kind.__module__, kind.__name__) for kind in EXAMPLES}
    public |= {tuple(path.split(":")) for fillers in SLOTS.values() for path in fillers.values()}
    assert len(public) > 100
    missing = [f"{m}:{name}" for m, name in public if name not in names[".".join(m.split(".")[:2])]]
    assert missing == []


def test_what_is_exported_is_what_the_modules_have():
    from forcectl.force import IntegralForceLaw
    from forcectl.force.integral import IntegralForceLaw as Original

    assert IntegralForceLaw is Original
    assert issubclass(IntegralForceLaw, LeafSystem)


def test_a_name_that_is_not_there_is_refused():
    with pytest.raises(AttributeError, match=r"^module 'forcectl\.force' has no attribute 'IntegralForceLawyer'$"):
        import_module("forcectl.force").IntegralForceLawyer  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'Nothing'"):
        from forcectl.force import Nothing  # noqa: F401


def test_the_function_graph_and_the_room_graph_do_not_hide_each_other():
    """Importing the room, which the function itself does, sets the attribute `forcectl.graph`."""
    from forcectl.framework import affine
    from forcectl.graph import to_svg

    block = affine(np.eye(1), np.ones(1))
    for _ in range(2):
        assert isinstance(fc.graph(block), Graph)
    assert to_svg(fc.graph(block)).startswith("<svg")


def test_rooms_are_imported_without_drake():
    rooms = ", ".join(package(folder) for folder in PACKAGES)
    code = f"import sys, {rooms}; print(*(name for name in ('pydrake', 'numpy', 'scipy') if name in sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert result.stdout.split() == []
