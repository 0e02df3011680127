"""Docstrings as a reference is made of them: read by napoleon, one argument to a line, each by its name."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from io import StringIO
from typing import NamedTuple

import pytest
from docutils.core import publish_doctree
from docutils.frontend import Values, get_default_settings
from docutils.parsers.rst import Parser
from docutils.readers.standalone import Reader
from docutils.writers.null import Writer
from sphinx.ext.napoleon import Config, GoogleDocstring

from tests.project.test_project import LIBRARY, parsed

NAPOLEON = Config(napoleon_use_ivar=True)  # attributes as fields, which docutils reads without Sphinx's directives
# "name: text", "name, other: text", "*names: text"
ENTRY = re.compile(r"(\*{0,2}\w+(?:, \*{0,2}\w+)*):(?: |$)")
PLAIN = re.compile(r"[A-Za-z0-9 ,.;'()/=<>+-]+")  # one line without a mark: there is nothing to misread
HEADING = re.compile(r"^(\w+):$")


class Documented(NamedTuple):
    """A module, class, function or method of the library and its docstring."""

    name: str
    node: ast.AST
    text: str


def documented(node: ast.Module | ast.ClassDef | ast.FunctionDef, name: str) -> Iterator[Documented]:
    if text := ast.get_docstring(node):
        yield Documented(name, node, text)
    for inner in node.body:
        if isinstance(inner, ast.ClassDef | ast.FunctionDef) and not inner.name.startswith("_"):
            yield from documented(inner, f"{name}:{inner.name}" if ":" not in name else f"{name}.{inner.name}")


@cache
def library() -> tuple[Documented, ...]:
    return tuple(one for path, tree in parsed(LIBRARY) for one in documented(tree, str(path)))


@cache
def settings() -> Values:
    return get_default_settings(Parser, Reader, Writer)


def complaints(text: str) -> list[str]:
    """What napoleon and docutils have to say of a docstring."""
    lines = StringIO()
    options = settings().copy()
    options.warning_stream, options.report_level, options.halt_level = lines, 2, 5
    publish_doctree(str(GoogleDocstring(text, NAPOLEON, what="class")), settings=options)
    return lines.getvalue().splitlines()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("The size |x| of x.", "Undefined substitution"),
        ("One.\n\nentry: long,\n    indented.\nmore", "ends without a blank line"),
        ("See `this.", "start-string without end-string"),
    ],
)
def test_what_cannot_be_read_is_seen(text, complaint):
    assert complaint in complaints(text)[0]


@pytest.mark.slow
def test_napoleon_reads_every_docstring_without_a_warning():
    assert len(library()) > 1000
    marked = [one for one in library() if not PLAIN.fullmatch(one.text)]
    assert len(marked) > 500
    assert {one.name: found for one in marked if (found := complaints(one.text))} == {}


def sections(text: str, *headings: str) -> Iterator[list[str]]:
    """The lines of each section with such a heading, without its indentation."""
    lines = text.splitlines()
    for i, line in enumerate(lines):
        if (found := HEADING.match(line)) and found[1] in headings:
            body = []
            for inside in lines[i + 1 :]:
                if inside.strip() and not inside.startswith("    "):
                    break
                body.append(inside[4:])
            yield [inside for inside in body if inside.strip()]


def entries(lines: list[str]) -> Iterator[tuple[str, str]]:
    """(names, text) of each entry; a line that is neither the first of an entry nor indented counts as an entry."""
    found: list[list[str]] = []
    for line in lines:
        if line.startswith("    ") and found:
            found[-1].append(line.strip())
        else:
            found.append([line])
    for whole in map(" ".join, found):
        entry = ENTRY.match(whole)
        yield (entry[1], whole[entry.end() :]) if entry else ("", whole)


def arguments(node: ast.FunctionDef) -> list[str]:
    a = node.args
    named = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(star for star in (a.vararg, a.kwarg) if star)]
    return [arg.arg for arg in named]


@cache
def classes() -> dict[str, ast.ClassDef]:
    modules = [one.node for one in library() if isinstance(one.node, ast.Module)]
    return {node.name: node for module in modules for node in module.body if isinstance(node, ast.ClassDef)}


@cache
def attributes(node: ast.ClassDef, *, of_instances: bool) -> set[str]:
    """Arguments of the constructor and fields, those of base classes included; and what methods set, and properties."""
    names = set()
    for item in node.body:
        if isinstance(item, ast.AnnAssign):
            names |= {ast.unparse(item.target)}
        elif isinstance(item, ast.Assign):
            names |= {ast.unparse(target) for target in item.targets}
        elif isinstance(item, ast.FunctionDef):
            if item.name == "__init__":
                names |= set(arguments(item))
            if of_instances:
                names |= {item.name} if item.decorator_list else set()
                names |= set(re.findall(r"\bself\.(\w+)\b", ast.unparse(item)))
    for base in node.bases:
        if isinstance(base, ast.Name) and base.id in classes():
            names |= attributes(classes()[base.id], of_instances=of_instances)
    return names


def known(one: Documented, heading: str) -> set[str]:
    if isinstance(one.node, ast.ClassDef):
        return attributes(one.node, of_instances=heading == "Attributes")
    return set(arguments(one.node)) if isinstance(one.node, ast.FunctionDef) else set()


def unclear(one: Documented) -> Iterator[str]:
    """What is wrong with the sections of arguments and attributes of a docstring."""
    for heading in ("Args", "Attributes"):
        names = known(one, heading)
        seen: list[str] = []
        for section in sections(one.text, heading):
            for listed, text in entries(section):
                here = [name.lstrip("*") for name in listed.split(", ")] if listed else []
                if not here:
                    yield f"{one.name}: {heading}: no name: {text}"
                elif not text:
                    yield f"{one.name}: {heading}: {listed}: says nothing"
                yield from (f"{one.name}: {heading}: there is no {name!r}" for name in here if name not in names)
                others = (set(re.findall(r"[.;] (\w+): ", text)) & names) - {"None"}
                yield from (f"{one.name}: {heading}: {name!r} within a line" for name in sorted(others))
                seen += here
        yield from (f"{one.name}: {heading}: {name!r} twice" for name in sorted({n for n in seen if seen.count(n) > 1}))


def read(source: str) -> Documented:
    node = ast.parse(source).body[0]
    assert isinstance(node, ast.ClassDef | ast.FunctionDef)
    return Documented("f", node, ast.get_docstring(node) or "")


@pytest.mark.parametrize(
    ("docs", "complaint"),
    [
        ("a: one. b: two.", "'b' within a line"),
        ("a: one.\n        c: two.", "there is no 'c'"),
        ("a [m]: one.", "no name"),
        ("a: one.\n        a, b: two.", "'a' twice"),
        ("b:", "says nothing"),
    ],
)
def test_unclear_sections_are_seen(docs, complaint):
    assert complaint in " ".join(unclear(read(f'def f(a, b):\n    """F.\n\n    Args:\n        {docs}\n    """')))


def test_clear_sections_are_let_pass():
    docs = "a, b: numbers [m],\n            so: long.\n        rest: None: all. Default: none."
    assert list(unclear(read(f'def f(a, b, *rest):\n    """F.\n\n    Args:\n        {docs}\n    """'))) == []


@pytest.mark.slow
def test_every_argument_has_a_line_of_its_own_and_a_name_that_exists():
    assert [complaint for one in library() for complaint in unclear(one)] == []
    assert sum(bool(list(sections(one.text, "Args"))) for one in library()) > 200
