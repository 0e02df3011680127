"""The keys of a sweep, the values of each as a list or a distribution, and the points that are drawn from them.

Distributions have the tags and keys of `pydrake.common.schema` (`!Deterministic`, `!Gaussian`, `!Uniform`,
`!UniformDiscrete`), and `!LogUniform {min, max}` for ranges over decades. From Python they may be Drake's objects.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common import schema
from scipy import stats
from scipy.stats import qmc

from forcectl.arrays import Array, Indices
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.expression import Expression
from forcectl.framework.yaml_tree import Tagged, Tree, dump, is_object, plain
from forcectl.scenario.trees import part_tree
from forcectl.sweeps.sweep_config import SweepConfig

# Tag -> its keys.
DISTRIBUTIONS: dict[str, tuple[str, ...]] = {
    "Deterministic": ("value",),
    "Gaussian": ("mean", "stddev"),
    "Uniform": ("min", "max"),
    "UniformDiscrete": ("values",),
    "LogUniform": ("min", "max"),
}
_OF_DRAKE = (schema.Deterministic, schema.Gaussian, schema.Uniform, schema.UniformDiscrete)
MOST_TRIALS = 10_000_000
_CHUNK = 4096  # points that are drawn at once where conditions refuse some
_GIVE_UP = 20  # draws per wanted point, after which drawing stops
_WITHIN = 1e-12  # distance from 0 and 1, whose quantiles may be infinite


@dataclass(frozen=True)
class Axis:
    """A key of a sweep.

    Attributes:
        key: dotted key of the scenario.
        values: that the key takes; empty for a distribution.
        labels: of the values, as tables show them.
        distribution: tag of the distribution; "" for a list.
        numbers: parameters of the distribution, by name.
    """

    key: str
    values: list[Any] = field(default_factory=list)
    labels: list[Any] = field(default_factory=list)
    distribution: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)

    def draw(self, uniform: Array) -> Array:
        """Coordinates: values of a distribution, positions in a list.

        Args:
            uniform: shape (n,), between 0 and 1.
        """
        if self.distribution:
            return _quantile(self.distribution, self.numbers, np.clip(uniform, _WITHIN, 1 - _WITHIN))
        return np.minimum(np.floor(uniform * len(self.values)), len(self.values) - 1)

    def value(self, coordinate: float) -> Any:
        """The value of a coordinate, as set in the scenario."""
        return coordinate if self.distribution else self.values[round(coordinate)]

    def label(self, coordinate: float) -> Any:
        """The value of a coordinate, as a table shows it: a number, true or false, or text."""
        return coordinate if self.distribution else self.labels[round(coordinate)]


def axis_of(key: str, tree: Tree) -> Axis:
    """The axis that a key of a sweep file, or of `fc.sweep`, describes.

    Args:
        key: of the scenario, with dots.
        tree: a list of values, a mapping tagged as a distribution, or a distribution of Drake's.

    Raises:
        BadInputError: neither a list nor a distribution, or one without values.
    """
    where = f"keys.{key}"
    if isinstance(tree, _OF_DRAKE):
        names = DISTRIBUTIONS[type(tree).__name__]
        tree = Tagged({name: plain(getattr(tree, name)) for name in names}, type(tree).__name__)
    if isinstance(tree, Tagged) and tree.tag is not None:
        return _distribution(key, tree, where)
    if not isinstance(tree, list):
        tags = ", ".join(f"!{tag}" for tag in DISTRIBUTIONS)
        raise invalid(where, tree, f"a list of values, or a distribution: {tags}")
    return _listed(key, tree, where)


def _listed(key: str, values: list[Any], where: str) -> Axis:
    if not values:
        raise invalid(where, values, "a list of at least one value")
    labels = [label_of(value) for value in values]
    seen = set()
    for label in labels:
        kind = type(label) if isinstance(label, bool | str) else float  # 1 and 1.0 are one value, 1 and true are two
        if (kind, label) in seen:
            raise BadInputError(f" holds {label!r} twice: values of a list must differ", key=where)
        seen.add((kind, label))
    return Axis(key, list(values), labels=labels)


def label_of(value: Any) -> Any:
    """A value as a table shows it: numbers, true and false as they are, everything else as text."""
    if isinstance(value, bool | int | float | str):
        return value
    return _in_line(part_tree(value))


def _in_line(tree: Tree) -> str:
    """A tree as YAML on one line."""
    if isinstance(tree, Tagged):
        keys = ", ".join(f"{key}: {_in_line(part)}" for key, part in tree.items())
        return " ".join(part for part in (f"!{tree.tag}" if tree.tag else "", f"{{{keys}}}" if keys else "") if part)
    if isinstance(tree, list):
        return f"[{', '.join(map(_in_line, tree))}]"
    return dump(tree).removesuffix("\n").removesuffix("\n...")


def _distribution(key: str, tree: Tagged, where: str) -> Axis:
    tag = str(tree.tag)
    if tag not in DISTRIBUTIONS:
        raise unknown("distribution", f"!{tag}", [f"!{name}" for name in DISTRIBUTIONS]).at(where)
    names = DISTRIBUTIONS[tag]
    for name in tree:
        if name not in names:
            raise unknown("key", name, names).at(f"{where}.{name}")
    for name in names:
        if name not in tree:
            raise BadInputError(f" is missing: !{tag} has the keys {', '.join(names)}", key=f"{where}.{name}")
    if tag == "UniformDiscrete":
        if not isinstance(tree["values"], list):
            raise invalid(f"{where}.values", tree["values"], "a list of values")
        return _listed(key, tree["values"], f"{where}.values")
    numbers = {name: _number(f"{where}.{name}", tree[name]) for name in names}
    if numbers.get("stddev", 1.0) <= 0:
        raise invalid(f"{where}.stddev", numbers["stddev"], "positive")
    if "min" in numbers and not numbers["min"] < numbers["max"]:
        raise invalid(f"{where}.max", numbers["max"], f"above min = {numbers['min']:g}")
    if tag == "LogUniform" and numbers["min"] <= 0:
        raise invalid(f"{where}.min", numbers["min"], "positive")
    return Axis(key, distribution=tag, numbers=numbers)


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise invalid(where, value, "a finite number")
    return float(value)


def _quantile(tag: str, numbers: Mapping[str, float], uniform: Array) -> Array:
    if tag == "Deterministic":
        return np.full(uniform.shape, numbers["value"])
    if tag == "Gaussian":
        return np.asarray(numbers["mean"] + numbers["stddev"] * stats.norm.ppf(uniform))
    low, high = numbers["min"], numbers["max"]
    return low * (high / low) ** uniform if tag == "LogUniform" else low + (high - low) * uniform


def is_plain(value: Any) -> bool:
    """Whether a value can be written into a file: it holds no object from Python."""
    if is_object(value):
        return False
    if isinstance(value, Mapping):
        return getattr(value, "given", None) is None and all(map(is_plain, value.values()))
    return all(map(is_plain, value)) if isinstance(value, list | tuple) else True


def draw(config: SweepConfig, axes: list[Axis], conditions: list[Expression]) -> tuple[Array, int]:
    """The points of a sweep, and how many were left out because of the conditions.

    Args:
        config: with the design.
        axes: the varied keys.
        conditions: on their values; random and Sobol points are drawn until enough of them meet the conditions.

    Raises:
        BadInputError: no point meets the conditions, or a key does not suit the design.
    """
    if config.design == "grid":
        for axis in axes:
            if axis.distribution:
                raise BadInputError(
                    " is a distribution: must be a list of values in a grid, or name another design",
                    key=f"keys.{axis.key}",
                )
        if (size := math.prod(len(axis.values) for axis in axes)) > MOST_TRIALS:
            raise BadInputError(f"the grid has {size} points: must be at most {MOST_TRIALS}", key="keys")
        points = np.array(list(itertools.product(*(range(len(axis.values)) for axis in axes))), dtype=float)
        kept = points[_meeting(points, axes, conditions)]
        if not len(kept):
            raise invalid("constraints", config.constraints, "met by at least one point")
        return kept, len(points) - len(kept)
    wanted, size = config.trials or 1, len(axes)
    if config.design == "saltelli":
        return _saltelli(config, axes, conditions), 0
    found, drawn = np.empty((0, size)), 0
    for uniform in _uniform(config, size, bool(conditions)):
        points = np.column_stack([axis.draw(column) for axis, column in zip(axes, uniform.T, strict=True)])
        meeting = _meeting(points, axes, conditions)[: wanted - len(found)]
        found = np.concatenate([found, points[meeting]])
        drawn += int(meeting[-1]) + 1 if len(found) == wanted else len(points)
        if len(found) == wanted or drawn > _GIVE_UP * max(wanted, _CHUNK):
            break
    if not len(found) or (len(found) < wanted and config.design != "latin_hypercube"):
        met = f"{len(found)} of {drawn} points meet them"
        raise invalid("constraints", config.constraints, f"met by {wanted} points, but {met}")
    return found, drawn - len(found)


def _uniform(config: SweepConfig, size: int, conditions: bool) -> Iterator[Array]:
    """Points in the unit cube, in chunks."""
    generator, wanted = np.random.default_rng(config.seed), config.trials or 1
    if config.design == "latin_hypercube":
        yield qmc.LatinHypercube(size, seed=generator).random(wanted)
        return
    sobol = qmc.Sobol(size, seed=generator) if config.design == "sobol" else None
    while True:
        count = max(wanted, _CHUNK) if conditions else wanted
        # Sobol points are drawn in powers of two; surplus ones at the end are left out.
        yield generator.random((count, size)) if sobol is None else sobol.random_base2((count - 1).bit_length())


def _meeting(points: Array, axes: list[Axis], conditions: list[Expression]) -> Indices:
    """Which points meet the conditions."""
    if not conditions:
        return np.arange(len(points))

    def meets(point: list[float]) -> bool:
        values = {axis.key: axis.label(x) for axis, x in zip(axes, point, strict=True)}
        return all(condition(values) for condition in conditions)

    return np.flatnonzero([meets(point) for point in points.tolist()])


def _saltelli(config: SweepConfig, axes: list[Axis], conditions: list[Expression]) -> Array:
    """Points A, B and, for each key, A with that column of B: the input of `scipy.stats.sobol_indices`."""
    count, size = config.trials or 1, len(axes)
    if conditions:
        raise invalid("constraints", config.constraints, "left out: the design saltelli needs every point")
    if count & (count - 1):
        raise invalid("trials", count, "a power of two for the design saltelli")
    if config.seeds is not None or config.repeat is not None:
        raise invalid("seeds", config.seeds, "left out: the design saltelli has one trial a point")
    both = qmc.Sobol(2 * size, seed=np.random.default_rng(config.seed)).random(count)
    a, b = both[:, :size], both[:, size:]
    mixed = [np.where(np.arange(size) == i, b, a) for i in range(size)]
    uniform = np.concatenate([a, b, *mixed])
    return np.column_stack([axis.draw(column) for axis, column in zip(axes, uniform.T, strict=True)])
