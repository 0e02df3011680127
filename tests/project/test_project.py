"""Rules that hold for the whole repository, and that no reader should have to check by eye."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from forcectl.models import list_robots, list_tools
from forcectl.scenario import catalog

ROOT = Path(__file__).resolve().parents[2]
THIS = Path(__file__).relative_to(ROOT)
TOP_LEVEL = {"benchmarks", "diagrams", "docs", "experiments", "forcectl", "models", "tests", ".ci", ".github"}
PACKAGES = {"forcectl", "diagrams", "models", "experiments"}
LINES_PER_FILE = 400
FILES_PER_ROOM = 15
PLACEHOLDER = r"\b(?:TO" r"DO|FIX" r"ME|XX" r"X)\b"


def tracked() -> list[Path]:
    """The files of the repository, relative to its root: what git tracks or would add."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    return [Path(line) for line in listing.splitlines() if (ROOT / line).is_file()]


def texts() -> Iterator[tuple[Path, str]]:
    for path in tracked():
        if (ROOT / path).is_symlink():
            continue
        try:
            yield path, (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:  # a picture
            continue


def sources(*folders: str) -> list[Path]:
    return [path for path in tracked() if path.suffix == ".py" and path.parts[0] in folders]


LIBRARY = sources("forcectl", "diagrams", "models", "experiments")


def matches(pattern: str, *, but: frozenset[Path] = frozenset()) -> list[str]:
    """`file:line: text` of each line of a tracked text file in which the pattern occurs."""
    found = []
    for path, text in texts():
        if path not in but:
            found += [
                f"{path}:{i}: {line.strip()}" for i, line in enumerate(text.splitlines(), 1) if re.search(pattern, line)
            ]
    return found


def test_the_searches_below_see_the_files():
    assert THIS in tracked()
    assert matches(r"^def test_the_searches_below_see_the_files") != []
    assert len(LIBRARY) > 20


@pytest.mark.slow
def test_no_package_registry_is_named():
    hosts = ["py" + "pi.org", "python" + "hosted", "ana" + "conda.org", "npm" + "js", "jsd" + "elivr", "un" + "pkg"]
    assert matches("|".join(map(re.escape, hosts))) == []
    assert matches(r"--(?:extra-)?index-url|--find-links|--trusted-host", but=frozenset({THIS})) == []


def test_no_path_of_one_machine():
    folders = ["home/", "Users/", "root/", "work/", "opt/", "mnt/", "tmp/"]
    assert matches(r"(?<![\w.$})~*/-])/(?:" + "|".join(folders) + r")\w", but=frozenset({THIS})) == []


def test_nothing_left_for_later():
    assert matches(PLACEHOLDER) == []


def test_top_level_folders_are_the_agreed_ones():
    assert {path.parts[0] for path in tracked() if len(path.parts) > 1} - TOP_LEVEL == set()


def test_experiments_hold_no_code():
    assert {path for path in sources("experiments") if path.name != "__init__.py"} == set()
    init = ast.parse((ROOT / "experiments/__init__.py").read_text())
    assert len(init.body) == 1, "experiments/__init__.py is a docstring and nothing else"


def test_links_inside_the_package_are_relative_and_lead_to_the_folders_beside_it():
    for name in ("diagrams", "models", "experiments"):
        link = ROOT / "forcectl" / name
        assert link.is_symlink(), f"{link} should be a link; on Windows use `git config core.symlinks true`"
        assert link.readlink() == Path("..") / name


def parsed(paths: list[Path]) -> Iterator[tuple[Path, ast.Module]]:
    for path in paths:
        yield path, ast.parse((ROOT / path).read_text(encoding="utf-8"))


def test_files_are_short():
    lengths = {str(path): len((ROOT / path).read_text().splitlines()) for path in sources(*TOP_LEVEL)}
    assert {path: n for path, n in lengths.items() if n >= LINES_PER_FILE} == {}


def test_rooms_are_small():
    rooms = Counter(
        str(path.parent) for path in sources("forcectl", "diagrams", "models") if path.name != "__init__.py"
    )
    assert {room: n for room, n in rooms.items() if n > FILES_PER_ROOM} == {}


@pytest.mark.slow
def test_every_class_of_the_library_has_a_name_of_its_own():
    names = Counter()
    for _, tree in parsed(sources("forcectl", "diagrams", "models")):
        names.update(node.name for node in tree.body if isinstance(node, ast.ClassDef))
    assert [name for name, n in names.items() if n > 1] == []


def test_blocks_and_diagrams_derive_from_the_bases_that_are_freed():
    bases = matches(r"^class \w+\((.*, )?(LeafSystem|Diagram)\)")
    library = [line.split(":")[0] for line in bases if line.startswith(("forcectl/", "diagrams/"))]
    assert library == ["forcectl/testing/memory.py"], "PythonBlock or PythonDiagram; memory.py measures Drake's own"


@pytest.mark.slow
def test_imports_are_explicit():
    bad = []
    for path, tree in parsed(sources(*TOP_LEVEL)):
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            bad += [f"{path}:{node.lineno}: {n}" for n in names if n.endswith(".*") or re.match(r"pydrake\.all\b", n)]
    assert bad == []


def undocumented(tree: ast.Module) -> Iterator[str]:
    """Names of public things without a docstring: the module, its classes and functions, the methods of its classes."""
    if not ast.get_docstring(tree):
        yield "module"
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            if not ast.get_docstring(node) and not decorators(node) & {"overload"}:
                yield node.name
            for method in node.body if isinstance(node, ast.ClassDef) else []:
                public = isinstance(method, ast.FunctionDef) and not method.name.startswith("_")
                bare = public and not ast.get_docstring(method)
                if bare and not decorators(method) & {"overload", "override", "setter"}:
                    yield f"{node.name}.{method.name}"


def decorators(node: ast.ClassDef | ast.FunctionDef) -> set[str]:
    """Names of what a class or function is decorated with."""
    return {ast.unparse(each).split(".")[-1] for each in node.decorator_list}


@pytest.mark.slow
def test_public_things_have_docstrings():
    bare = [f"{path}: {name}" for path, tree in parsed(LIBRARY) for name in undocumented(tree)]
    assert bare == []


def unreasoned(tree: ast.Module) -> Iterator[int]:
    """Lines with `pytest.skip`, `pytest.mark.skipif`, ... that do not say why: a bare mark, or an empty text."""
    called = {node.func: node for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Attribute) and node.attr in ("skip", "skipif", "xfail", "importorskip")):
            continue
        owner = ast.unparse(node.value)
        if owner not in ("pytest", "pytest.mark"):
            continue
        call = called.get(node)
        given = [k.value for k in call.keywords if k.arg == "reason"] if call else []
        if call and owner == "pytest" and node.attr in ("skip", "xfail"):
            given += call.args[:1]
        if not given or (isinstance(given[0], ast.Constant) and not str(given[0].value).strip()):
            yield node.lineno


@pytest.mark.slow
def test_every_skip_gives_its_reason():
    assert list(unreasoned(ast.parse("@pytest.mark.skip\ndef test(): pytest.skip('')"))) == [1, 2]
    assert [f"{path}:{line}" for path, tree in parsed(sources("tests")) for line in unreasoned(tree)] == []


@pytest.mark.slow
def test_no_check_that_cannot_fail():
    always = [
        f"{path}:{node.lineno}"
        for path, tree in parsed(sources("tests"))
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert) and isinstance(node.test, ast.Constant | ast.Tuple)
    ]
    assert always == []


@pytest.mark.parametrize("module", ["forcectl", "forcectl.cli", "forcectl.errors", "forcectl.conventions"])
def test_light_modules_do_not_wait_for_drake(module):
    heavy = ("pydrake", "numpy", "scipy", "matplotlib", "xarray", "pandas")
    code = f"import sys, {module}; print(*[name for name in {heavy!r} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == []


def test_python_versions_agree():
    """pyproject.toml, the Makefile's check, the lock and the CI matrix speak of the same Pythons."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["requires-python"] == ">=3.11,<3.14"
    versions = ["3.11", "3.12", "3.13"]
    assert [f"Programming Language :: Python :: {v}" in project["classifiers"] for v in versions] == [True] * 3
    assert "(3, 11) <= v[:2] <= (3, 13)" in (ROOT / "Makefile").read_text()
    assert " ".join(f"python{v}" for v in versions) in (ROOT / "Makefile").read_text()
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    assert re.search(r"python: \[(.*)\]", workflow)[1].replace('"', "") == ", ".join(versions)  # type: ignore[index]


def test_every_dependency_is_locked():
    def canonical(name: str) -> str:
        return re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", name)[0]).lower()  # type: ignore[index]

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = settings["project"]
    extras = [r for extra in project["optional-dependencies"].values() for r in extra]
    wanted = {canonical(r) for r in settings["build-system"]["requires"] + project["dependencies"] + extras}
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.+!-]+( ; .*)?", line) for line in lines)
    assert wanted - {"forcectl"} <= {canonical(line.split("==")[0]) for line in lines}
    # The same lines, each with the hashes of its files, and no more than that: no address, no option.
    hashed = "\n".join(line for line in (ROOT / "hashes.txt").read_text().splitlines() if not line.startswith("#"))
    entries = hashed.replace(" \\\n    ", " ").splitlines()
    assert [re.sub(r" --hash=sha256:[0-9a-f]{64}(?= |$)", "", entry) for entry in entries] == lines
    assert all(entry.count(" --hash=") >= 1 for entry in entries)


def test_every_package_that_is_imported_is_declared_and_every_extra_is_used():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [r for extra in project["optional-dependencies"].values() for r in extra]
    named = " ".join(r.partition(">")[0] for r in project["dependencies"] + extras)
    declared = set(re.findall(r"[\w-]+", named))  # of h5netcdf[h5py] both
    distributions = {"pydrake": "drake", "yaml": "pyyaml"}  # where the name differs
    imported = set()
    for file in (path for path in tracked() if path.suffix == ".py" and path.parts[0] in PACKAGES):
        for node in ast.walk(ast.parse((ROOT / file).read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(str(node.module).partition(".")[0])
    outside = imported - set(sys.stdlib_module_names) - {"forcectl"}
    assert {"numpy", "pydrake", "distributed"} <= outside
    assert {distributions.get(name, name) for name in outside} - declared == set()
    for_users = {name: set(re.findall(r"[\w-]+", " ".join(r))) for name, r in project["optional-dependencies"].items()}
    assert [name for name in for_users.keys() - {"test", "dev"} if not for_users[name] & outside] == []


def fillers() -> tuple[set[str], set[str]]:
    """Names of robots, tools and tags, and of the classes behind the tags."""
    paths = [item for table in catalog.SLOTS.values() for item in table.items()]
    return {tag for tag, _ in paths} | {*list_robots(), *list_tools()}, {path.partition(":")[2] for _, path in paths}


def asked_by_name(tree: ast.Module) -> Iterator[str]:
    """Comparisons with a name, or with a class of another file, of what may fill a slot."""
    names, classes = fillers()
    own = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            constants = (n.value for n in ast.walk(node) if isinstance(n, ast.Constant))
            found = {value for value in constants if isinstance(value, str)} & names
            found |= {n.id for n in ast.walk(node) if isinstance(n, ast.Name)} & (classes - own)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("isinstance", "issubclass"):
            found = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)} & (classes - own)
        elif isinstance(node, ast.MatchValue | ast.MatchClass):
            found = {ast.unparse(node).strip("'\"").partition("(")[0]} & (names | classes - own)
        else:
            continue
        yield from (f"{node.lineno}: {name}" for name in sorted(found))


@pytest.mark.slow
def test_nothing_asks_for_a_robot_a_fidelity_or_the_filler_of_a_slot_by_name():
    """What differs between fillers is said by their methods and attributes, so that one's own can say it, too."""
    assert [f"{path}:{where}" for path, tree in parsed(LIBRARY) for where in asked_by_name(tree)] == []


@pytest.mark.parametrize(
    "code",
    [
        "fidelity == 'Multibody'",
        "robot in ('yumi', 'mine')",
        "isinstance(part, EnvironmentConfig)",
        "isinstance(part, (int, EnvironmentConfig))",
        "type(part) is EnvironmentConfig",
        "match tag:\n    case 'Surface':\n        pass",
        "match part:\n    case EnvironmentConfig():\n        pass",
    ],
)
def test_asking_by_name_is_seen(code):
    assert list(asked_by_name(ast.parse(code))) != []
