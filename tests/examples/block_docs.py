"""What the docstring of a block says about its ports, in the words that the contract test reads.

After the list of ports (see `forcectl.testing.assert_docstring_matches`) come entries, each at the start of a
sentence:

    name, other_name: shape (n,), what it is [unit of each, or one for all]. Feedthrough of x and y at the tick.

The shape is (n,) for any n that the ports with it share, a number, or like (3n,) or (2n + 9,): one for all names of the
entry, one for each, or one "or" another. Units stand in the entry's first brackets that hold nothing but units: one for
all names of the entry, one for each, or those of the parts of a vector. "[rad] or [m]" and "[rad or m]" are
alternatives. An output says what it depends on:

    Feedthrough.    Feedthrough of all inputs.    Feedthrough of all inputs but x.    Feedthrough of x, y and z.
    Feedthrough of x when ...       only in some configurations
    State, ...      Function of time ...

"All outputs are feedthrough of ..." and "All outputs are state ..." speak for every output without a statement of its
own. A port without an entry is looked up in the blocks that the text names in single backticks. In the list of ports,
`<name>` stands for one port that the user names, "(further ...)" for any number of ports of a part the user chooses;
with "(further ...; in any order)" the optional ports of the list come where their parts are, too.

The paragraph `Sampling:` says when the block updates its state:

    Sampling: none; ...                 no state and no events
    Sampling: continuous; ...           continuous states
    Sampling: every `period` [s]; ...   periodic updates; one clause for each argument that is a period
    ... no delay from x to y ...        y is feedthrough of x
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import yaml
from pydrake.systems.framework import System

_ATOM = r"(?:Nms|Nm|N|J|kg|rad|m|s|u|1)(?:\^\d)?"
_UNIT = rf"{_ATOM}(?:[ /]\(?{_ATOM}(?: {_ATOM})*\)?)*"
_UNITS = rf"{_UNIT}(?: or {_UNIT})*(?:, {_UNIT}(?: or {_UNIT})*)*"
_BRACKETS = re.compile(rf"\[({_UNITS})\](?: or \[({_UNITS})\])?")
_SHAPES = re.compile(r"shape (\([^()]+,\)(?:(?: or|,) \([^()]+,\))*)")
_TERM = re.compile(r"(\d*)([a-z]\w*)?(?: \+ (\d+))?")
_STATEMENT = re.compile(
    r"(?:^|(?<=[.;] ))(?P<all>All outputs are )?(?:"
    r"[Ff]eedthrough(?: of (?P<inputs>.+?))?(?: at the tick)?(?P<when> when .+?)?(?:, and held)?"
    r"|(?P<none>[Ss]tate|(?:A f|F|f)unctions? of time)(?:,.*?)?)(?:\.(?= |$)|;)"
)
_NAMES = r"[a-z_0-9]+(?:, [a-z_0-9]+)*"
_ANY, _ANYWHERE, _OPTIONAL = "(further", "; in any order)", " (optional)"


@dataclass(frozen=True)
class Statement:
    """The inputs that an output depends on: always, and in some configurations only."""

    always: frozenset[str] = frozenset()
    sometimes: frozenset[str] = frozenset()

    def __or__(self, other: Statement) -> Statement:
        return Statement(self.always | other.always, self.sometimes | other.sometimes)


class BlockDoc:
    """The docstring of a class of blocks, read.

    Args:
        kind: the class.
        blocks: all classes that the text may refer to, by name.
    """

    def __init__(self, kind: type[System], blocks: Mapping[str, type[System]]):
        self.kind, self._blocks = kind, blocks
        self._text = inspect.cleandoc(kind.__doc__ or "")
        found = re.search(r"^```\n(.*?)^```$", self._text, re.DOTALL | re.MULTILINE)
        assert found, "no list of ports between two lines of three backticks"
        ports = yaml.safe_load(found[1])
        self.listed = {side: [str(name) for name in ports.get(side) or []] for side in ("input_ports", "output_ports")}
        self._parameters = [_bare(str(name)) for name in ports.get("parameters") or []]
        self._body = self._text[found.end() :]
        self._rest = self._text[: found.start()] + self._body

    def ports(self, side: str, declared: Iterable[str]) -> list[str]:
        """The names listed on that side, with the declared ones in place of what stands for any name."""
        listed, declared = self.listed[side], list(declared)
        names = {_bare(name) for name in listed}
        further = [name for name in declared if name not in names]
        if any(name.startswith(_ANY) and name.endswith(_ANYWHERE) for name in listed):
            fixed = [name for name in listed if not name.startswith(_ANY) and not name.endswith(_OPTIONAL)]
            rest = iter(fixed)
            return [next(rest, "") if name in fixed else name for name in declared] + list(rest)
        result: list[str] = []
        for name in listed:
            if name.startswith(("<", _ANY)):
                taken, further = (further[:1], further[1:]) if name.startswith("<") else (further, [])
                result += taken
            elif not name.endswith(_OPTIONAL) or _bare(name) in declared:
                result.append(_bare(name))
        return result

    @property
    def open(self) -> bool:
        """Whether the list of ports stands for more names than it says."""
        return any(name.startswith(("<", _ANY)) for names in self.listed.values() for name in names)

    def _named(self, side: str) -> list[str]:
        return [_bare(name) for name in self.listed[side] if not name.startswith(("<", _ANY))]

    @cached_property
    def _prose(self) -> str:
        """The text about the ports, in one line."""
        end = re.search(r"^(Parameters|Sampling:|Args:|Raises:|Attributes:)", self._body, re.MULTILINE)
        return " ".join((self._body[: end.start()] if end else self._body).split())

    @cached_property
    def _entries(self) -> list[tuple[list[str], str]]:
        """(names, text) of each entry."""
        known = {*self._named("input_ports"), *self._named("output_ports"), *self._parameters}
        starts = [
            found
            for found in re.finditer(rf"(?:^|(?<=\. )|(?<=; ))({_NAMES}): ", self._prose)
            if set(found[1].split(", ")) <= known
        ]
        ends = [*(found.start() for found in starts), len(self._prose)][1:]
        return [(s[1].split(", "), self._prose[s.end() : end]) for s, end in zip(starts, ends, strict=False)]

    def names(self, port: str) -> bool:
        """Whether the list of ports has this name itself."""
        return port in {*self._named("input_ports"), *self._named("output_ports")}

    def units(self, name: str) -> set[str]:
        """The units that the port may have, each as `conventions.unit_of` writes it; none when the text has none."""
        for names, text in self._entries:
            if name not in names:
                continue
            if found := _BRACKETS.search(text):
                return {unit for group in found.groups() if group for unit in _of_name(group, names, name)}
        return {unit for other in self._referred() for unit in other.units(name)}

    def wrong_sizes(self, sizes: Mapping[str, int]) -> dict[str, str]:
        """The shapes that ports have in the text and not in the block, by name.

        Args:
            sizes: of the ports of the block.
        """
        shapes = {name: self._shapes(name) for name in sizes}
        known: dict[str, int] = {}
        for name, (shape, *_) in shapes.items():
            if shape.isidentifier():
                known.setdefault(shape, sizes[name])
        return {
            name: " or ".join(each)
            for name, each in shapes.items()
            if not any(_may_be(shape, sizes[name], known) for shape in each)
        }

    def _shapes(self, name: str) -> list[str]:
        for names, text in self._entries:
            if name in names and (found := _SHAPES.search(text)):
                each = re.split(r"(?<=\)), ", found[1])
                return re.findall(r"\((.+?),\)", each[names.index(name)] if len(each) == len(names) else each[0])
        return ["?"]

    def _referred(self) -> Iterator[BlockDoc]:
        others = {name: kind for name, kind in self._blocks.items() if kind is not self.kind}  # never in a circle
        for name in re.findall(r"`(\w+)`", self._prose):
            if name in others:
                yield BlockDoc(others[name], others)

    def feedthrough(self, inputs: Iterable[str], outputs: Iterable[str]) -> dict[str, Statement | None]:
        """What is said of each output; None where nothing is.

        Args:
            inputs: ports that the block has as it is built.
            outputs: likewise.
        """
        present = frozenset(inputs)
        said: dict[str, Statement] = {}
        everywhere: Statement | None = None
        for found in _STATEMENT.finditer(self._prose):
            if found["all"]:
                everywhere = (everywhere or Statement()) | self._statement(found, present)
        for names, text in self._entries:
            for found in _STATEMENT.finditer(text):
                if not found["all"]:
                    said |= {name: said.get(name, Statement()) | self._statement(found, present) for name in names}
        return {name: said.get(name, everywhere) for name in outputs}

    def _statement(self, found: re.Match[str], present: frozenset[str]) -> Statement:
        if found["none"]:
            return Statement()
        everything, _, but = (found["inputs"] or "all inputs").partition(" but ")
        names = present if everything in ("all inputs", "both inputs") else _words(everything)
        unknown = (names | _words(but)) - {*self._named("input_ports"), *present}
        assert not unknown, f"feedthrough of {sorted(unknown)}, which are no inputs: {found[0]!r}"
        names = (names - _words(but)) & present
        return Statement(sometimes=names) if found["when"] else Statement(always=names)

    @cached_property
    def sampling(self) -> str:
        """The paragraph on sampling, in one line."""
        found = re.search(r"^Sampling: (.*?)(?:\n\n|\Z)", self._rest, re.DOTALL | re.MULTILINE)
        return " ".join(found[1].split()) if found else ""

    @property
    def periods(self) -> list[str]:
        """The arguments that are periods of updates."""
        return re.findall(r"every `(\w+)` \[s\]", self.sampling)

    @property
    def undelayed(self) -> list[tuple[str, str]]:
        """(output, input) of which the paragraph on sampling says that there is no delay."""
        return [(b, a) for a, b in re.findall(r"no delay from (\w+) to (\w+)", self.sampling)]


def _bare(name: str) -> str:
    return name.removesuffix(_OPTIONAL)


def _words(text: str) -> frozenset[str]:
    return frozenset(word for word in re.split(r", and |, | and ", text) if word)


def _of_name(group: str, names: list[str], name: str) -> list[str]:
    """The alternatives for one name of an entry whose brackets hold `group`."""
    parts = group.split(", ")
    if len(names) == len(parts):
        return parts[names.index(name)].split(" or ")
    return [",".join(choice) for choice in zip(*(part.split(" or ") for part in parts), strict=True)]


def _may_be(shape: str, size: int, known: Mapping[str, int]) -> bool:
    """Whether a port whose shape is written so has this size; one in numbers that are not known can have any."""
    if not (found := _TERM.fullmatch(shape)):
        return True
    factor, symbol, more = int(found[1] or 1), found[2], int(found[3] or 0)
    if symbol is None:
        return size == factor
    return size == factor * known[symbol] + more if symbol in known else (size - more) % factor == 0
