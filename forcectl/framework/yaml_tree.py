"""Scenario text as a tree of plain values, and operations on trees.

A tree consists of mappings, lists, text, numbers, true/false and null. A mapping may carry a tag, as in
`!Integral {integral_gain: 3}`. Scalars follow YAML 1.2, as in Drake: `2e5` is a number and `on` is text.

From Python a tree may also hold objects, such as the configuration of a controller. An object is a leaf: it is passed
on as it is, and never copied. A mapping that is merged on top of an object holds the changes, and the object in
`given`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from enum import Enum
from functools import lru_cache
from pathlib import PurePath
from typing import Any, cast

import yaml

from forcectl.errors import BadInputError
from forcectl.framework.files.text_file import MOST_CHARACTERS
from forcectl.framework.files.yaml_places import ZeroBeforeError, places

IMPORT = "Import"  # tag for a class given by its import path, allowed in every slot
_MOST_VALUES = 100_000  # values in one text
_SHALLOW = 100  # levels of nesting
_MERGE = "tag:yaml.org,2002:merge"
_UNPRINTABLE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")  # not allowed in the files of a run

Tree = Any  # a Tagged mapping, a list of trees, a scalar or an object


class Tagged(dict[str, Any]):
    """A mapping with a YAML tag.

    Args:
        values: keys and values.
        tag: tag without the `!`; None for none.
        given: object that the values change; None for none.

    Attributes:
        lines: line of each dotted key in the text that the tree was read from; at the root only.
    """

    def __init__(self, values: Mapping[str, Any] | None = None, tag: str | None = None, given: Any = None):
        super().__init__(values or {})
        self.tag = tag
        self.given = given
        self.lines: dict[str, int] = {}

    def __repr__(self) -> str:
        return f"!{self.tag}" if self.tag and not self else super().__repr__()


class _Loader(yaml.SafeLoader):
    """Plain values, tagged mappings, YAML 1.2 scalars; a key written twice is an error."""

    def __init__(self, text: str):
        super().__init__(text)
        self._merging: list[yaml.MappingNode] = []
        self._merged = 0  # number of keys in all mappings with a merge key

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        if any(node is one for one in self._merging):
            raise _refusal(node, "a mapping is merged into itself")
        self._merging.append(node)
        merges = any(key.tag == _MERGE for key, _ in node.value)
        super().flatten_mapping(node)
        self._merging.pop()
        self._merged += len(node.value) * merges
        if self._merged > _MOST_VALUES:  # repeated merging can expand a short text without limit
            raise _refusal(node, f"more than {_MOST_VALUES} keys are merged")


class _Dumper(yaml.SafeDumper):
    """Writes what `_Loader` reads: short lists of scalars on one line, mappings over several."""

    def ignore_aliases(self, data: Any) -> bool:  # equal parts are written out instead of as aliases
        return True

    def serialize_node(self, node: Any, parent: Any, index: Any) -> None:
        if isinstance(node, yaml.MappingNode):
            node.flow_style = not node.value
        super().serialize_node(node, parent, index)


_SCALARS = (
    ("null", re.compile(r"^(?:~|null|)$"), ["~", "n", ""]),
    ("bool", re.compile(r"^(?:true|false)$"), list("tf")),
    ("int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789")),
    (
        "float",
        re.compile(
            r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
        ),
        list("-+.0123456789"),
    ),
)
_ZERO_BEFORE = re.compile(r"[-+]?0[0-9]")
for _class in (_Loader, _Dumper):
    _class.yaml_implicit_resolvers = {}
    for _name, _pattern, _first in _SCALARS:
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", _pattern, _first)
    _class.add_implicit_resolver(_MERGE, re.compile(r"^(?:<<)$"), ["<"])
_PLAIN = ("null", "bool", "int", "float", "str", "seq", "map")  # YAML's own tags that are allowed in a tree
_Loader.yaml_constructors = {
    tag: construct
    for tag, construct in yaml.SafeLoader.yaml_constructors.items()
    if tag is None or tag.rpartition(":")[2] in _PLAIN
}


def _refusal(node: yaml.Node, text: str) -> yaml.YAMLError:
    return yaml.constructor.ConstructorError(None, None, text, node.start_mark)


def _construct_mapping(loader: _Loader, node: yaml.Node, tag: str | None = None) -> Iterator[Tagged]:
    if not isinstance(node, yaml.MappingNode):
        raise _refusal(node, "expected a mapping")
    written = set()
    for key_node, _ in node.value:
        key = (key_node.tag, key_node.value if isinstance(key_node, yaml.ScalarNode) else None)
        if key in written and key_node.value != "<<":
            raise _refusal(key_node, f"key {key_node.value!r} is written twice")
        written.add(key)
    result = Tagged(tag=tag)
    yield result
    result.update(cast("dict[str, Any]", loader.construct_mapping(node)))


def _construct_tagged(loader: _Loader, suffix: str, node: yaml.Node) -> Any:
    if not suffix:
        raise _refusal(node, "a tag needs a name, as in !Integral")
    if isinstance(node, yaml.ScalarNode) and node.value == "":
        return Tagged(tag=suffix)
    if not isinstance(node, yaml.MappingNode):
        raise _refusal(node, f"!{suffix} must be followed by a mapping")
    return _construct_mapping(loader, node, suffix)


def _number(node: yaml.ScalarNode) -> str:
    """The text of a number; one with a leading zero is refused: octal in YAML 1.1, decimal in YAML 1.2."""
    if _ZERO_BEFORE.match(node.value):
        raise ZeroBeforeError(node)
    return node.value


def _construct_int(loader: _Loader, node: yaml.ScalarNode) -> int | float:
    # Python refuses to parse and print integers of thousands of digits; as floats they are infinite.
    text = _number(node)
    return int(text) if len(text) < 300 else float(text)


def _construct_float(loader: _Loader, node: yaml.ScalarNode) -> float:
    return float(re.sub(r"\.(?=[a-zA-Z])", "", _number(node).lower()))


_Loader.add_constructor("tag:yaml.org,2002:map", _construct_mapping)
_Loader.add_constructor("tag:yaml.org,2002:int", _construct_int)
_Loader.add_constructor("tag:yaml.org,2002:float", _construct_float)
_Loader.add_multi_constructor("!", _construct_tagged)


_Dumper.add_representer(
    Tagged,
    lambda dumper, data: dumper.represent_mapping(
        f"!{data.tag}" if data.tag else "tag:yaml.org,2002:map", data.items()
    ),
)


def parse(text: str, origin: str) -> Tree:
    """The tree of a YAML text; `origin` is a file name or an option, for messages.

    The result for a text is cached and copied, as every scenario reads the same presets and robot parameters.

    Raises:
        BadInputError: the text is not YAML; the message names the line and column.
    """
    read = _read(text, origin)
    tree = plain(read)
    if isinstance(tree, Tagged):
        tree.lines = read.lines
    return tree


@lru_cache(maxsize=64)
def _read(text: str, origin: str) -> Tree:
    if len(text) > MOST_CHARACTERS:
        raise BadInputError(f"{origin}: not usable: more than {MOST_CHARACTERS} characters")
    try:
        count, depth = _written(text)
        if count > _MOST_VALUES:
            raise BadInputError(f"{origin}: not usable: more than {_MOST_VALUES} values")
        loader = _Loader(text)
        node = _composed(loader, text, fast=0 < depth <= _SHALLOW)  # the parser in C recurses once per level
        tree = None if node is None else loader.construct_document(node)
        values = _values(tree)
        for part in values:
            if isinstance(part, str) and _UNPRINTABLE.search(part):
                raise BadInputError(f"{origin}: not usable: control character in {part[:40]!r}")
        if len(values) >= _MOST_VALUES:
            raise BadInputError(f"{origin}: not usable: more than {_MOST_VALUES} values, or an alias that holds itself")
        if isinstance(tree, Tagged) and node is not None:
            tree.lines = {key: first.start_mark.line + 1 for key, first, _ in places(node)}
        return tree
    except BadInputError:
        raise
    except ZeroBeforeError as error:
        raise error.bad_input(node, origin) from None
    except yaml.YAMLError as error:
        raise BadInputError(f"{origin}: not valid YAML: {_one_line(error, text)}") from None
    except RecursionError:
        raise BadInputError(f"{origin}: not valid YAML: nested too deeply") from None
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        # Errors inside the parser for odd scalars and keys, such as a mapping used as a key.
        raise BadInputError(f"{origin}: not valid YAML: {_one_line(error, text)}") from None


def _written(text: str) -> tuple[int, int]:
    """Number of values in a text, up to one more than allowed, and their deepest level; much faster than parsing.

    0 levels for a short text that is not YAML: then the parser in Python reads it, whose error messages are shown.
    """
    count = depth = deepest = 0
    try:
        for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # a build may be without C
            count += isinstance(event, yaml.NodeEvent)
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            deepest = max(deepest, depth)
            if count > _MOST_VALUES or depth > 10 * _SHALLOW:  # beyond Python's recursion limit
                break
    except yaml.YAMLError:
        if len(text) > _MOST_VALUES:  # in characters: the parser in Python would take seconds
            raise
        return 0, 0
    return count, deepest


def _composed(loader: _Loader, text: str, fast: bool) -> yaml.Node | None:
    """The nodes of a text; `fast`: by the loader in C, if there is one, and in Python where that one fails."""
    if fast and hasattr(yaml, "CSafeLoader"):
        quick = yaml.CSafeLoader(text)
        quick.yaml_implicit_resolvers = loader.yaml_implicit_resolvers
        with suppress(yaml.YAMLError):  # its messages differ
            return quick.get_single_node()
    return loader.get_single_node()


def _values(tree: Tree) -> list[Tree]:
    found = [tree]
    for part in found:  # the list grows meanwhile
        if len(found) >= _MOST_VALUES:  # aliases can expand a short text to any size, even to an infinite tree
            break
        if isinstance(part, Tagged | list):
            found.extend([*part.keys(), *part.values()] if isinstance(part, Tagged) else part)
    return found


def place(origin: str, lines: Mapping[str, int], key: str) -> str:
    """File and line of a dotted key, for messages; a key that is not in the file has the line of the part around it."""
    while key and key not in lines:
        key = key.rpartition(".")[0]
    return f"{origin}:{lines[key]}" if key else origin


def _one_line(error: Exception, text: str) -> str:
    if isinstance(error, yaml.reader.ReaderError):
        before = text[: int(error.position)]
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        return f"{error.reason} (line {line}, column {column})"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem:
        mark = error.problem_mark
        where = f" (line {mark.line + 1}, column {mark.column + 1})" if mark else ""
        return " ".join(f"{error.problem}{where}".split())
    return " ".join(str(error).split())


def dump(tree: Tree) -> str:
    """YAML text that `parse` reads back as the same tree."""
    return yaml.dump(tree, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def merge(base: Tree, over: Tree) -> Tree:
    """`base` overlaid with the values of `over`; neither is modified.

    Mappings are merged key by key, unless `over` has another tag, or `!Import` with another path: then it replaces
    `base` as a whole. Keys that are whole numbers address the elements of a list. A tag may be given as text.
    Everything else is replaced.
    """
    if isinstance(over, Tagged) and over.tag is None and over.given is None:
        if isinstance(base, str):
            base = Tagged(tag=base.removeprefix("!")) if base else base
        elif is_object(base):
            base = Tagged(given=base)
    if isinstance(base, list) and isinstance(over, Tagged) and over and all(_is_index(k, base) for k in over):
        items = list(base)
        for key, value in over.items():
            items[int(key)] = merge(items[int(key)], value)
        return items
    if not isinstance(base, Tagged) or not isinstance(over, Tagged) or replaces(over, base):
        return plain(over)
    result = Tagged(base, base.tag, base.given)
    for key, value in over.items():
        if key in base:
            result[key] = merge(base[key], value)
        elif is_object(base.given) and is_object(getattr(base.given, str(key), None)):
            result[key] = merge(getattr(base.given, key), value)
        else:
            result[key] = plain(value)
    return result


def replaces(over: Tagged, base: Tagged) -> bool:
    """Whether `merge` puts `over` in place of `base` as a whole."""
    return over.given is not None or (over.tag is not None and _is_other_part(over, base))


def _is_other_part(part: Tagged, base: Tagged) -> bool:
    """Whether a part has another tag, or `!Import` with another path."""
    return part.tag != base.tag or (part.tag == IMPORT and part.get("path", base.get("path")) != base.get("path"))


def is_object(value: Any) -> bool:
    """Whether a part of a tree is an object from Python: no mapping, list, scalar or file name."""
    return not isinstance(value, Mapping | list | tuple | str | int | float | bool | PurePath | Enum | None)


def _is_index(key: object, items: list[Any]) -> bool:
    return isinstance(key, str) and key.isdecimal() and len(key) < 9 and int(key) < len(items)


def nest(overrides: Mapping[str, Any]) -> Tagged:
    """`{"a.b.c": v}` as `{a: {b: {c: v}}}`; later keys win."""
    tree = Tagged()
    for dotted, value in overrides.items():
        branch: Tree = plain(value)
        for name in reversed(str(dotted).split(".")):
            branch = Tagged({name: branch})
        tree = merge(tree, branch)
    return tree


def plain(value: Any) -> Tree:
    """A value from Python (dicts, tuples, NumPy numbers and arrays) as a tree; a tree is copied.

    Raises:
        BadInputError: it is nested too deeply, or contains itself.
    """
    return _plain(value, _SHALLOW)


def _plain(value: Any, levels: int) -> Tree:
    if levels < 0:
        raise BadInputError(f"mappings and lists must be nested at most {_SHALLOW} levels deep")
    if isinstance(value, Mapping):
        items = {k: _plain(v, levels - 1) for k, v in value.items()}
        return Tagged(items, getattr(value, "tag", None), getattr(value, "given", None))
    if isinstance(value, list | tuple):
        return [_plain(v, levels - 1) for v in value]
    if hasattr(value, "tolist"):  # NumPy, without importing it
        return _plain(value.tolist(), levels)
    return value


def as_json(tree: Tree) -> Any:
    """A tree as strict JSON: tags become entries `_tag`, as in Drake, and infinity becomes text."""
    if isinstance(tree, Tagged):
        tag = {"_tag": f"!{tree.tag}"} if tree.tag else {}
        return tag | {str(key): as_json(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [as_json(value) for value in tree]
    return str(tree) if isinstance(tree, float) and not math.isfinite(tree) else tree


def difference(base: Tree, other: Tree) -> Tree:
    """The smallest tree that turns `base` into `other` when merged on top; an empty mapping for equal mappings."""
    if not isinstance(base, Tagged) or not isinstance(other, Tagged) or set(base) - set(other):
        return plain(other)
    if _is_other_part(other, base):
        return plain(other)
    changed = Tagged()
    for key, value in other.items():
        if key not in base or not equal(base[key], value):
            changed[key] = difference(base.get(key), value)
    return changed


def equal(one: Tree, other: Tree) -> bool:
    """Whether two trees have the same tags, keys and values; true and 1 differ."""
    if isinstance(one, Tagged) and isinstance(other, Tagged):
        return one.tag == other.tag and set(one) == set(other) and all(equal(one[k], other[k]) for k in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(equal, one, other))
    return type(one) is type(other) and bool(one == other)
