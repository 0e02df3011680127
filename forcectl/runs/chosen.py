"""The variants of a scenario to be run, drawn or checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import Diagram

from forcectl.diagrams.loop import Loop
from forcectl.errors import BadInputError
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import Tagged, Tree, dump, nest
from forcectl.runs.directory import made_of
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import (
    Named,
    Scenario,
    as_file,
    build,
    origins,
    resolve,
    resolved_tree,
    with_shortcuts,
)
from forcectl.scenario.trees import part_tree


@dataclass(frozen=True)
class Chosen:
    """Some variants of a scenario.

    Attributes:
        file: the scenario.
        changes: overrides of all of them, dotted key -> value.
        scenarios: by the name of the variant, at least one.
    """

    file: ScenarioFile
    changes: dict[str, Any]
    scenarios: dict[str, Scenario]

    @property
    def first(self) -> Scenario:
        """The scenario of the first variant."""
        return next(iter(self.scenarios.values()))

    @property
    def title(self) -> str:
        """The title of the scenario, or else its name."""
        return self.first.title or self.file.name

    @property
    def text(self) -> str:
        """The scenario file that holds these variants in full."""
        return dump(resolved_tree(self.scenarios))

    def made_of(self, variant: str) -> dict[str, Any]:
        """What the results of a variant depend on, see `forcectl.runs.directory.made_of`."""
        return made_of(dump(resolved_tree({variant: self.scenarios[variant]})))

    def where(self, variant: str) -> Callable[[str], str]:
        """A function that returns file and line of a dotted key of a variant."""
        return origins(self.file, variant, self.changes)

    def build(self, variant: str) -> Loop:
        """The loop of a variant.

        Raises:
            BadInputError: it cannot be built.
        """
        return build(self.scenarios[variant], self.where(variant))

    def diagram(self) -> Diagram:
        """The diagram of the first variant; the others are built, too, to find their errors.

        Raises:
            BadInputError: a variant cannot be built.
        """
        return self.looked_through()[0].diagram

    def looked_through(self) -> tuple[Loop, dict[str, set[str]]]:
        """The loop of the first variant, as for `diagram`; the names of the signals of the loops of all variants."""
        loops = ((variant, self.build(variant)) for variant in self.scenarios)
        variant, first = next(loops)
        signals = {variant: set(first.signals)} | {other: set(loop.signals) for other, loop in loops}
        return first, signals

    def check_changes(self) -> None:
        """Refuse changes that would make variants the same under different names.

        Raises:
            BadInputError: several variants are chosen, and one of them sets a changed key, a part of it, or a key
                that contains it.
        """
        if len(self.scenarios) < 2:
            return
        set_by = {name: _keys(nest(self.file.tree["variants"].get(name) or {})) for name in self.scenarios}
        for key in _keys(nest({key: part_tree(value) for key, value in self.changes.items()})):
            clashing = [name for name, keys in set_by.items() if any(overlap(key, other) for other in keys)]
            if clashing:
                raise BadInputError(
                    f"override of {key} for several variants: must be a key that none of them sets, but it is set by "
                    f"{', '.join(map(repr, clashing))}: run one of them with --variant, or override another key"
                )


def choose(
    scenario: Named,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
    *,
    whole: bool = True,
) -> Chosen:
    """A variant of a scenario, or all of them.

    Args:
        scenario, overrides, seed, fidelity, allow_imports: see `load_scenario`.
        variant: its name; None: all.
        whole: False: only the first one of all.

    Raises:
        BadInputError: the scenario cannot be used.
    """
    file, changes = as_file(scenario, allow_imports), with_shortcuts(overrides, seed, fidelity)
    names = select_variants(file, variant)
    return Chosen(file, changes, {name: resolve(file, name, changes) for name in (names if whole else names[:1])})


def overlap(one: str, other: str) -> bool:
    """Whether one of two dotted keys is the other, or a part of it."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")


def _keys(tree: Tree, key: str = "") -> list[str]:
    """Dotted keys that a tree replaces when it is merged: a tag or a list replaces the whole part."""
    if isinstance(tree, Tagged) and tree.tag is None:
        return [found for name, part in tree.items() for found in _keys(part, join(key, name))]
    return [key]
