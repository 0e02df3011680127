"""What may be imported is decided on the text of a path, before anything is imported."""

import re
import sys

import pytest

from forcectl.errors import BadInputError
from forcectl.framework import imports
from forcectl.framework.imports import Imports, allowed_names


@pytest.fixture(autouse=True)
def _nothing_stays():
    yield
    for name in [name for name in sys.modules if name.startswith("of_the_test")]:
        del sys.modules[name]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of a scenario that is not the working directory."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    (tmp_path / "of_the_test.py").write_text(
        "from json import loads\nfrom xarray import Dataset\nclass Law:\n    pass\n"
    )
    return tmp_path


def refused(rules, path, said, imported=()):
    before = {*sys.modules, *imported}
    with pytest.raises(BadInputError, match=re.escape(said)):
        rules.load(path, "path")
    assert [name for name in set(sys.modules) - before if name in path] == []


def test_a_module_beside_the_scenario_is_allowed_and_one_elsewhere_is_not(folder):
    assert Imports(folder).load("of_the_test:Law", "path").__name__ == "Law"
    assert str(folder) not in sys.path
    del sys.modules["of_the_test"]
    refused(Imports(folder / "elsewhere"), "of_the_test:Law", "must be importable, but: No module named 'of_the_test'")


def test_the_working_directory_is_for_modules_that_are_named(folder):
    (folder / "elsewhere" / "of_the_test_two.py").write_text("class Law:\n    pass\n")
    refused(Imports(folder), "of_the_test_two:Law", "or named by --allow-imports of_the_test_two")
    assert Imports(folder, ("of_the_test_two",)).load("of_the_test_two:Law", "path").__name__ == "Law"


def test_a_folder_beside_the_scenario_does_not_stand_for_a_module_elsewhere(folder):
    """A bare folder is a package without code, which is found after any module with code."""
    for name in ("of_the_test_three", "of_the_test_four"):
        (folder / name).mkdir()
    (folder / "elsewhere" / "of_the_test_three.py").write_text("class Law:\n    pass\n")
    (folder / "elsewhere" / "of_the_test_four").mkdir()
    (folder / "elsewhere" / "of_the_test_four" / "laws.py").write_text("class Law:\n    pass\n")
    refused(Imports(folder), "of_the_test_three:Law", "or named by --allow-imports of_the_test_three")
    refused(Imports(folder), "of_the_test_four.laws:Law", "or named by --allow-imports of_the_test_four")


@pytest.mark.parametrize(
    "path", ["os:system", "builtins:exec", "__main__:x", "sitecustomize:X", "antigravity:webbrowser", "os.path:join"]
)
def test_nothing_of_the_standard_library_is_allowed_whoever_asks(folder, path):
    for rules in (Imports(folder), Imports(folder, (path.partition(":")[0],)), Imports(every=True)):
        refused(rules, path, "not of Python's standard library")


@pytest.mark.parametrize("path", ["numpy:memmap", "scipy.io:loadmat", "yaml:load", "pydrake.common:temp_directory"])
def test_an_installed_package_must_be_named(folder, path):
    refused(Imports(folder), path, f"named by --allow-imports {path.partition('.')[0].partition(':')[0]}")


def test_a_file_beside_the_scenario_does_not_stand_for_an_installed_package(folder):
    (folder / "xarray.py").write_text("class Law:\n    pass\n")
    refused(Imports(folder), "xarray:Dataset", "(and no installed one of that name)")


def test_what_a_module_passes_on_counts_as_that_of_its_own_module(folder):
    refused(Imports(folder), "of_the_test:loads", "not of Python's standard library", ["of_the_test"])
    refused(
        Imports(folder),
        "of_the_test:Dataset",
        "must be defined in a module that is allowed, not in xarray",
        ["of_the_test"],
    )
    assert Imports(folder, ("xarray",)).load("of_the_test:Dataset", "path").__name__ == "Dataset"


@pytest.mark.parametrize("path", ["", "os", ":x", "a:", "a.b", "..a:b", "a b:c", "a:b.c", 3, None, "a:b:c", "a\n:b"])
def test_a_path_of_another_form_is_refused(folder, path):
    with pytest.raises(BadInputError, match="must be an import path such as"):
        Imports(folder).check(path, "path")


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("of_the_test_run.py:Law", "No module 'py' in 'of_the_test_run'; write 'of_the_test_run:Law'"),
        ("of_the_test_run.laws.more:Law", "No module 'laws' in 'of_the_test_run'"),
        (
            "of_the_test_pack.laws.py:Law",
            "No module 'py' in 'of_the_test_pack.laws'; write 'of_the_test_pack.laws:Law'",
        ),
        ("of_the_test_pack.lawz:Law", "No module 'lawz' in 'of_the_test_pack'"),
    ],
)
def test_a_module_that_is_not_there_is_refused_before_what_is_around_it_runs(folder, path, said):
    (folder / "of_the_test_pack").mkdir()
    for file in ("of_the_test_run.py", "of_the_test_pack/__init__.py", "of_the_test_pack/laws.py"):
        (folder / file).write_text(f"open({str(folder / 'ran')!r}, 'w')\nclass Law:\n    pass\n")
    for rules in (Imports(folder), Imports(folder, every=True)):
        refused(rules, path, f"path = {path!r}: must be importable, but: {said}")
    assert not (folder / "ran").exists()
    assert Imports(folder).load("of_the_test_pack.laws:Law", "path").__name__ == "Law"


def test_modules_in_folders_without_code_are_found(folder):
    (folder / "of_the_test_five" / "laws").mkdir(parents=True)
    (folder / "of_the_test_five" / "laws" / "mine.py").write_text("class Law:\n    pass\n")
    assert Imports(folder).load("of_the_test_five.laws.mine:Law", "path").__name__ == "Law"


def test_two_scenarios_may_have_modules_of_the_same_name(folder):
    other = folder / "elsewhere"
    (other / "of_the_test.py").write_text("class Law:\n    other = True\n")
    first = Imports(folder).load("of_the_test:Law", "path")
    assert Imports(other).load("of_the_test:Law", "path").other
    again = Imports(folder).load("of_the_test:Law", "path")
    assert not hasattr(again, "other")
    assert first is not again


@pytest.mark.parametrize(
    "what", ["raise SystemExit(7)", "raise BaseException('b')", "x = (", "def __getattr__(n): 1/0"]
)
def test_whatever_a_module_does_is_one_line(folder, what):
    (folder / "of_the_test_bad.py").write_text(f"{what}\n")
    with pytest.raises(BadInputError, match=r"^path = 'of_the_test_bad:Law': must be importable, but: \w+: .*$"):
        Imports(folder).load("of_the_test_bad:Law", "path")


def test_an_error_in_a_module_has_its_line(folder):
    (folder / "of_the_test_line.py").write_text("import numpy\n\nLIMIT = 1 / 0\n")
    with pytest.raises(BadInputError, match=r"ZeroDivisionError: division by zero \(of_the_test_line\.py:3\)$"):
        Imports(folder).load("of_the_test_line:Law", "path")


@pytest.mark.parametrize("names", ["os", ["os"], ["sys.path"], ["a b"], [""], [3], ["../x"]])
def test_names_that_cannot_be_allowed(names):
    with pytest.raises(BadInputError, match=r"^key"):
        allowed_names(names, "key")


def test_packages_that_announce_parts_are_allowed(folder, monkeypatch):
    monkeypatch.setattr(imports, "announcing", lambda: {"of_the_test_two": "force: !Law"})
    (folder / "elsewhere" / "of_the_test_two.py").write_text("class Law:\n    pass\n")
    monkeypatch.syspath_prepend(str(folder / "elsewhere"))
    assert Imports(folder).load("of_the_test_two:Law", "path").__name__ == "Law"
