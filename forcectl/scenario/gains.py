"""Gains that an experiment identifies before the run: the key `gains_from` of a force law.

The experiment runs on the station of the scenario with that law, and with its model, estimators, signals, guard and
seed. Controller, reference, motion and duration are the experiment's own. Its controller lists the gains that it
identifies (`finds_gains`) and scales them to the bandwidth of the law (`gain_scale`); the law has a key for each gain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from forcectl.errors import BadInputError, one_line, show
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import IMPORT, Tagged, Tree, dump
from forcectl.scenario.checks.values import parts_within
from forcectl.scenario.trees import tree_of_fields

if TYPE_CHECKING:
    from forcectl.scenario.scenario import Scenario

Experiment = Callable[[str, str | None], "Scenario"]  # name and variant -> the scenario
_OF_THE_RUN = ("station", "model", "estimators", "signals", "guard", "seed")  # keys that the experiment gets


@dataclass(frozen=True)
class Identification:
    """An experiment that identifies gains of a law before the run.

    Attributes:
        key: dotted key of the law.
        experiment: name or path of the experiment, with its variant where one is named.
        scenario: scenario of the experiment, on the station of the run.
        names: names of the identified gains.
        scale: factor that adapts the gains to the bandwidth of the law.
    """

    key: str
    experiment: str
    scenario: Scenario
    names: tuple[str, ...]
    scale: float


@dataclass(frozen=True)
class FoundGains:
    """Gains that an experiment has identified for a law.

    Attributes:
        key: dotted key of the law.
        experiment: name or path of the experiment, with its variant where one is named.
        values: gains by name, in the units of the law's keys.
    """

    key: str
    experiment: str
    values: dict[str, float]

    def as_row(self) -> dict[str, Any]:
        """The record of `manifest.json`."""
        return {"gains_from": self.experiment, **self.values}


def identifications(scenario: Scenario, experiment: Experiment) -> list[Identification]:
    """The identifications that a scenario needs; none where all laws have their gains.

    Args:
        scenario: the complete scenario.
        experiment: gives a scenario by name and variant.

    Raises:
        BadInputError: an unknown experiment, one that identifies no gains, experiments that refer to each other in a
            circle, or gains that the law cannot use.
    """
    return [_identification(scenario, key, law, experiment) for key, law in _asking(scenario)]


def with_gains(scenario: Scenario, gains: Iterable[FoundGains]) -> Scenario:
    """A copy of a scenario whose laws have the identified gains.

    Raises:
        BadInputError: a value that the law does not allow.
    """
    for found in gains:
        try:
            changes = {**found.values, "gains_from": None, "gains_variant": None}
            scenario = _replaced(scenario, found.key.split("."), changes)
        except BadInputError as error:
            raise error.at(join(found.key, error.key), f"gains of {found.experiment}") from error
    return scenario


def text_of(scenario: Scenario) -> str:
    """Everything that the log of a scenario depends on, as text; "" where an object from Python cannot be written."""
    tree = tree_of_fields(replace(scenario, variants={}, expect=[], fidelities=[], title="", source="", description=""))
    return dump(tree) if _is_written(tree) else ""


def gains_lines(scenario: Scenario) -> list[str]:
    """Messages about gains that an experiment identifies before the run."""
    return [
        f"gains of {key}: {_label(law)} finds them on this station before each run" for key, law in _asking(scenario)
    ]


def found_lines(gains: Mapping[str, Iterable[FoundGains]]) -> list[str]:
    """Messages about the identified gains of each variant."""
    return [
        f"gains of {variant!r}: {one.key} from {one.experiment}: "
        + ", ".join(f"{name} {value:.4g}" for name, value in one.values.items())
        for variant, found in gains.items()
        for one in found
    ]


def asks_for_gains(scenario: Scenario) -> bool:
    """Whether gains must be identified before the scenario is simulated."""
    return any(True for _ in _asking(scenario))


def _asking(scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """The laws of a scenario with `gains_from`, by dotted key."""
    for key, law in parts_within(scenario.controller, "controller"):
        if getattr(law, "gains_from", None) is not None:
            yield key, law


def _identification(scenario: Scenario, key: str, law: Any, experiment: Experiment) -> Identification:
    """The identification for the law at a dotted key."""
    found = _experiment_of(law, f"{key}.gains_from", experiment, [])
    scale = _scale(found.controller, law)
    own = replace(found, **{part: getattr(scenario, part) for part in _OF_THE_RUN})
    return Identification(key, _label(law), own, tuple(found.controller.finds_gains), scale)


def _experiment_of(law: Any, key: str, experiment: Experiment, chain: Sequence[str]) -> Scenario:
    """The experiment that a law names; `chain` holds the experiments that referred to it."""
    name, chain = str(law.gains_from), [*chain, _label(law)]
    if len({*chain}) < len(chain):
        raise BadInputError(f" = {show(name)}: must not lead back to itself: {' -> '.join(chain)}", key=key)
    try:
        found = experiment(name, getattr(law, "gains_variant", None))
        for _, other in _asking(found):
            _experiment_of(other, key, experiment, chain)
        names = getattr(found.controller, "finds_gains", ())
        if not names or not isinstance(names, tuple | list):
            raise BadInputError("finds no gains: must be an experiment whose controller does, such as !RecursiveVrft")
        if missing := [gain for gain in names if not hasattr(law, gain)]:
            raise BadInputError(f"finds {', '.join(missing)}: the law has no key for it")
        _scale(found.controller, law)
    except BadInputError as error:
        raise error if error.key == key else BadInputError(f" = {show(name)}: {error}", key=key) from error
    return found


def _scale(controller: Any, law: Any) -> float:
    """Factor that adapts gains from a controller to the bandwidth of a law; both may be classes of the user."""
    try:
        scale = float(controller.gain_scale(law.reference_model_bandwidth()))
    except (BadInputError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise BadInputError(f"gain_scale(bandwidth) of its controller must give a number: {one_line(error)}") from error
    if not math.isfinite(scale):
        raise BadInputError(f"gain_scale(bandwidth) of its controller must give a finite number, not {scale}")
    return scale


def _is_written(tree: Tree) -> bool:
    if isinstance(tree, Tagged):
        return not (tree.tag == IMPORT and "repr" in tree) and all(map(_is_written, tree.values()))
    return all(map(_is_written, tree)) if isinstance(tree, list) else True


def _label(law: Any) -> str:
    variant = getattr(law, "gains_variant", None)
    return str(law.gains_from) if variant is None else f"{law.gains_from} ({variant})"


def _replaced(part: Any, path: Sequence[str], changes: Mapping[str, Any]) -> Any:
    """A copy of a part with changed values in the part at `path`."""
    if not path:
        return replace(part, **changes)
    name, rest = path[0], path[1:]
    if isinstance(part, Mapping):
        return {**part, name: _replaced(part[name], rest, changes)}
    if isinstance(part, list | tuple):
        return [_replaced(each, rest, changes) if str(i) == name else each for i, each in enumerate(part)]
    return replace(part, **{name: _replaced(getattr(part, name), rest, changes)})
