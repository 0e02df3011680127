"""The block of ports in a docstring, compared with the ports that are really declared."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence

import yaml
from pydrake.systems.framework import Diagram, System

from forcectl.framework.wiring import input_names, output_names

_KEYS = {"name", "input_ports", "output_ports", "parameters"}
_OPTIONAL = re.compile(r"\s*\(optional\)$")


def assert_docstring_matches(block: System) -> None:
    """The docstring of the block's class lists the ports and parameters that the block declares, in this order.

    The list is YAML between two lines of three backticks::

        name: RateLimiter
        input_ports: [command, limit (optional)]
        output_ports: [limited_command]
        parameters: [rate_limit]

    "(optional)" marks what exists only in some configurations. Parameters are compared by name where the block has
    an attribute `parameter_names`, else by number; those of a diagram belong to its blocks and are not compared.

    Raises:
        AssertionError: there is no such list, or it differs; all differences are listed.
    """
    __tracebackhide__ = True
    kind = type(block)
    stated = _parse(kind)
    lines = []
    if stated.get("name") != kind.__name__:
        lines.append(f"  name: {stated.get('name')!r} in the docstring, the class is called {kind.__name__!r}")
    lines += _compare("input_ports", stated.get("input_ports"), input_names(block))
    lines += _compare("output_ports", stated.get("output_ports"), output_names(block))
    if not isinstance(block, Diagram):
        lines += _compare_parameters(stated.get("parameters"), block)
    lines += [f"  {key}: unknown entry, known are {sorted(_KEYS)}" for key in sorted(set(stated) - _KEYS)]
    if lines:
        raise AssertionError("\n".join([f"docstring of {kind.__name__} does not match what it declares:", *lines]))


def _parse(kind: type) -> dict[str, object]:
    text = inspect.cleandoc(kind.__doc__ or "")
    found = re.search(r"^```\w*\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    if found is None:
        raise AssertionError(f"docstring of {kind.__name__} has no block of ports between lines of three backticks")
    try:
        stated = yaml.safe_load(found[1])
    except yaml.YAMLError as error:
        raise AssertionError(f"docstring of {kind.__name__}: the block of ports is no YAML: {error}") from error
    if not isinstance(stated, dict):
        raise AssertionError(f"docstring of {kind.__name__}: the block of ports has no entries such as `input_ports:`")
    return stated


def _entries(stated: object) -> list[tuple[str, bool]]:
    """(name, optional) of each entry."""
    entries = [str(entry) for entry in stated] if isinstance(stated, list) else []
    return [(_OPTIONAL.sub("", entry), bool(_OPTIONAL.search(entry))) for entry in entries]


def _compare(key: str, stated: object, declared: Sequence[str]) -> list[str]:
    entries = _entries(stated)
    expected = [name for name, optional in entries if not optional or name in declared]
    if expected == list(declared):
        return []
    return [f"  {key}: docstring {[name for name, _ in entries]}, declared {list(declared)}"]


def _compare_parameters(stated: object, block: System) -> list[str]:
    names = getattr(block, "parameter_names", ())
    if names:
        return _compare("parameters", stated, names)
    count = block.num_numeric_parameter_groups() + block.num_abstract_parameters()
    entries = _entries(stated)
    required = sum(not optional for _, optional in entries)
    if required <= count <= len(entries):
        return []
    return [f"  parameters: docstring {[name for name, _ in entries]}, declared {count}"]
