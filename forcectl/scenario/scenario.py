"""Scenarios: what is simulated, in which variants, and what is expected of it.

A scenario's values come from, later wins: the defaults of the dataclasses, the plant preset, the scenario file, the
variant, overrides (`--set` on the command line).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from forcectl.analysis.slot import run_figures, run_metrics
from forcectl.diagrams.loop import Loop, LoopParts, build_loop
from forcectl.diagrams.model import ModelConfig, Setting
from forcectl.diagrams.station import StationConfig
from forcectl.errors import BadInputError, RunFailedError, invalid, one_line, show, unknown
from forcectl.force.integral import IntegralConfig
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.yaml_tree import Tagged, Tree, difference, is_object, merge, nest, plain
from forcectl.motion.references import StepConfig
from forcectl.motion.tangential import TangentialMotionConfig
from forcectl.scenario import catalog
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.error_keys import full_key, located
from forcectl.scenario.expectations import Expectation
from forcectl.scenario.schema import ScenarioReader
from forcectl.scenario.trees import default_tags, path_of, to_tree, tree_of_fields

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORCE_LIMIT = 2.0  # a contact force above this many sensor ranges is a diverging run
LARGEST_CONTACT_FORCE = 2000.0  # [N] above it a run without a force sensor diverges
LONGEST_DURATION = 86_400.0  # [s]
ONLY_VARIANT = "default"  # name of the one variant of a scenario without variants
# Keys of earlier versions, and what to write instead.
_GONE = {
    "loop": "delete it: there is one kind of loop",
    "estimator": "write estimators: {NAME: !Tag {...}}",
    "analysis": "write analyses: {NAME: !Tag {...}}",
    "loads": "write station.loads",
    "station.position_loop": "write station.drive.position_loop",
    "station.servo": "write station.drive.servo",
    "station.interface": "write station.drive",
    "station.force_sensor": "write station.sensors.force",
    "station.friction": "write station.drive.friction",
    "station.obstacles": "write station.environment: !Box {...}, or !Parts {parts: {NAME: !Box {...}}}",
}


@dataclass(kw_only=True)
class Scenario(Config):
    """One simulation, complete: a scenario file after presets, one variant and overrides."""

    title: str = key("", "heading of tables and figures")
    source: str = key("", "figure or table of the thesis")
    description: str = key("", "what is to be seen")
    preset: str = key(catalog.DEFAULT_PRESET, "name of a file in experiments/presets")
    station: StationConfig = key(StationConfig, "robot, drives, environment and sensors")
    model: ModelConfig = key(ModelConfig, "how the model of the plant differs from it")
    estimators: dict[str, Any] = slot("estimator", dict, meaning="by name")
    controller: Any = slot("controller", IntegralConfig, meaning="force law, or controller of joints")
    reference: Any = slot("reference", StepConfig, meaning="of the force")
    motion: Any = slot("motion", TangentialMotionConfig, meaning="motion in the unconstrained directions")
    signals: dict[str, Any] = slot("signal", dict, meaning="choices and projections, by the name of the signal")
    analyses: dict[str, Any] = slot("analysis", dict, meaning="further metrics and figures, by name")
    duration: float = key(5.0, "simulated time", unit="s", bounds=f"positive, at most {LONGEST_DURATION:g}")
    after_end: float | None = key(
        None,
        "for which a run goes on after its state machine ended; null: up to the duration",
        unit="s",
        bounds="not negative",
    )
    seed: int = key(0, "of every random number in the run", bounds="from 0 to 9223372036854775807")
    reference_model: float | None = key(None, "of M(s); null: the controller's own", unit="rad/s", bounds="positive")
    model_error_window: float = key(4.1, "time T_w of the metric model_error_sd_N", unit="s", bounds="positive")
    variants: dict[str, Any] = key({}, "values that replace the scenario's, by the name of the variant")
    fidelities: list[str] = key(
        [], "that `reproduce` runs; empty: the station's own", choices=lambda: catalog.tags_of("fidelity")
    )
    expect: list[Expectation] = key([], "what is expected of the metrics")

    @property
    def fidelity(self) -> str:
        """Tag of the station's fidelity."""
        tree = to_tree(self.station.fidelity, "fidelity")
        return tree.tag if tree.tag != catalog.IMPORT else str(tree["path"])

    @property
    def parts(self) -> LoopParts:
        """What the loop is made of."""
        return LoopParts(**{part.name: getattr(self, part.name) for part in fields(LoopParts)})

    def build(self) -> Loop:
        """The loop as a diagram."""
        loop = build_loop(self.parts)
        if self.reference_model and "desired_force" not in loop.signals:
            raise invalid("reference_model", self.reference_model, "left out where nothing takes a desired force")
        return loop

    def setting(self) -> Setting:
        """What analyses are given beside the log."""
        return self.parts.setting()

    def limits(self) -> dict[str, float]:
        """Largest absolute values of a healthy run, by signal."""
        ranges = [FORCE_LIMIT * each.range for each in self.station.sensors.values() if hasattr(each, "range")]
        largest = min(ranges, default=LARGEST_CONTACT_FORCE)
        return {"contact_force": largest, "arm_contact_force": LARGEST_CONTACT_FORCE}

    def model_bandwidth(self, of_controller: float | None) -> float | None:
        """Bandwidth of the reference model [rad/s], else that of the controller; None without one."""
        return self.reference_model or of_controller or None

    def metrics(self, log: xr.Dataset, setting: Setting, realtime_factor: float | None) -> dict[str, float | None]:
        """All metrics of a run; `realtime_factor` is simulated time divided by computing time [1]."""
        window, motion = self.model_error_window, self.motion.interval()
        own = run_metrics(log, setting, window=window, motion=motion, realtime_factor=realtime_factor)
        for name in self.analyses:
            own |= (found := self._asked(name, "metrics", log, setting))
            for metric, value in found.items():
                if not isinstance(value, Real | None):
                    raise RunFailedError(f"analyses.{name}: metric {metric} = {show(value)}: must be a number or None")
        return own

    def figures(self, log: xr.Dataset, title: str) -> dict[str, Figure]:
        """Figures of a run under a title, by file name; the log is over time, or over (variant, time)."""
        figures = run_figures(log, title)
        setting = self.setting() if self.analyses else None
        for name in self.analyses:
            figures |= self._asked(name, "figures", log, setting, title)
        return figures

    def _asked(self, name: str, method: str, *arguments: Any) -> dict[str, Any]:
        """What a method of an analysis answers; RunFailedError if one of the user's raises or gives no mapping."""
        try:
            found = getattr(self.analyses[name], method)(*arguments)
        except Exception as error:  # whatever the user's analysis does
            raise RunFailedError(f"analyses.{name}: {method} raised {one_line(error)}") from error
        if not isinstance(found, Mapping):
            raise RunFailedError(f"analyses.{name}: {method} must return a mapping, not {type(found).__name__}")
        return dict(found)


def load_scenario(
    scenario: str | Path | Mapping[str, Any], variant: str | None = None, overrides: Mapping[str, Any] | None = None
) -> Scenario:
    """One scenario, complete.

    Args:
        scenario: name of a shipped experiment, path of a YAML file, or the same content as a mapping.
        variant: name of the variant; may be left out when there is at most one.
        overrides: dotted key -> value, on top of everything; a value may be a config object.

    Raises:
        BadInputError: anything in it that cannot be used.
    """
    file = as_file(scenario)
    names = select_variants(file, variant)
    if len(names) > 1:
        raise BadInputError(f"{file.origin} has several variants, name one of: {', '.join(names)}")
    return resolve(file, names[0], overrides)


def as_file(scenario: str | Path | Mapping[str, Any] | Scenario | ScenarioFile) -> ScenarioFile:
    """Whatever names or holds a scenario, as the file it would be."""
    if isinstance(scenario, ScenarioFile):
        return scenario
    if isinstance(scenario, Scenario):
        scenario = {f.name: getattr(scenario, f.name) for f in fields(scenario)}
    if isinstance(scenario, Mapping):
        return ScenarioFile("scenario", "scenario", catalog.scenario_tree(plain(scenario), "scenario"), Path.cwd())
    if isinstance(scenario, str | Path):
        return catalog.find_scenario(scenario)
    raise invalid("scenario", scenario, "a name, a path, a mapping or a Scenario")


def select_variants(file: ScenarioFile, variant: str | None = None) -> list[str]:
    """The variants to run: the named one, else all.

    Raises:
        BadInputError: no variant of that name.
    """
    variants = file.tree.get("variants") or Tagged({ONLY_VARIANT: Tagged()})
    if not isinstance(variants, Tagged) or not all(isinstance(name, str) for name in variants):
        wanted = "a mapping of names to values (quote names)"
        raise invalid("variants", variants, wanted).at("variants", file.where("variants"))
    if variant is not None and variant not in variants:
        raise unknown(f"variant of {file.origin}", variant, variants)
    return list(variants) if variant is None else [variant]


def resolve(file: ScenarioFile, variant: str = ONLY_VARIANT, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of one variant, with preset and overrides applied.

    Raises:
        BadInputError: names file or option, dotted key, value and what is allowed.
    """
    layers = _Layers(file, variant, overrides or {})
    tree = layers.merged()
    for gone, instead in _GONE.items():
        part, _, name = gone.rpartition(".")
        around = tree.get(part) if part else tree
        if isinstance(around, Tagged) and name in around:
            raise BadInputError(f"is no key any more: {instead}").at(gone, layers.where(gone))
    _locate_files(tree, file.folder)
    scenario: Scenario = ScenarioReader(layers.where).dataclass(Scenario, tree)
    names = select_variants(file)
    for i, expectation in enumerate(scenario.expect):
        for term, name in expectation.variants(names).items():
            if name not in names:
                key = f"expect.{i}.{term}"
                raise unknown("variant", name, names).at(key, layers.where(key))
    return scenario


class _Layers:
    """The trees a scenario is made of, weakest first, each with the name that messages use."""

    def __init__(self, file: ScenarioFile, variant: str, overrides: Mapping[str, Any]):
        self._file = file
        variants = file.tree.get("variants")
        changes = variants.get(variant) if isinstance(variants, Tagged) else None
        if changes is not None and not isinstance(changes, Tagged):
            key = f"variants.{variant}"
            raise invalid(key, changes, "a mapping of scenario keys").at(key, file.where(key))
        forced, varied = nest(overrides), nest(changes or {})
        # A slot without a tag means its default, and stays that when a later layer changes only some of its keys.
        self._layers: list[tuple[Callable[[str], str], Tagged]] = [
            (lambda key: file.origin, default_tags(Scenario)),
            (file.where, file.tree),
            (lambda key: file.where(f"variants.{variant}.{key}", f"variant {variant!r}"), varied),
            (lambda key: "override", forced),
        ]
        name = self.merged().get("preset", catalog.DEFAULT_PRESET)
        if name not in catalog.list_presets():
            raise unknown("preset", name, catalog.list_presets()).at("preset", self.where("preset"))
        preset = catalog.find_preset(str(name), self._drive())
        preset.tree.pop("description", None)
        self._layers.insert(1, (lambda key: preset.where(key, f"preset {name!r}"), preset.tree))

    def _drive(self) -> str:
        """Tag of the drive; empty where there is none."""
        station = self.merged().get("station")
        drive = station.get("drive") if isinstance(station, Tagged) else getattr(station, "drive", None)
        if isinstance(drive, Tagged) and drive.given is None:
            return drive.tag or ""
        if isinstance(drive, str):
            return drive.removeprefix("!")
        path = path_of(type(getattr(drive, "given", drive)))
        return next((tag for tag, known in catalog.tags_of("drive").items() if known == path), "")

    def merged(self) -> Tagged:
        result = Tagged()
        for _, tree in self._layers:
            result = merge(result, tree)
        return result

    def where(self, key: str) -> str:
        """Where the value at a dotted key is from: the strongest layer that holds it, or holds the part around it."""
        parts = key.split(".")
        for length in range(len(parts), 0, -1):
            for where, tree in reversed(self._layers[1:]):  # a default stands where the part around it does
                if _holds(tree, parts[:length]):
                    return where(key)
        return self._file.where(key)


def _holds(tree: Tree, parts: list[str]) -> bool:
    for part in parts:
        if isinstance(tree, list) and part.isdecimal() and int(part) < len(tree):
            tree = tree[int(part)]
        elif isinstance(tree, Tagged) and part in tree:
            tree = tree[part]
        else:
            return is_object(tree) or (isinstance(tree, Tagged) and tree.given is not None)
    return True


def _locate_files(tree: Tree, folder: Path) -> None:
    # A file beside the scenario is found from anywhere.
    if isinstance(tree, Tagged):
        for name in ("path", "model"):
            path = tree.get(name)
            if isinstance(path, str) and path and (folder / path).is_file():
                tree[name] = str(folder / path)
        for part in tree.values():
            _locate_files(part, folder)


def build(scenario: Scenario, where: Callable[[str], str] = lambda key: "") -> Loop:
    """The loop of a scenario as a diagram.

    Args:
        scenario: complete.
        where: says for a dotted key where its value came from, see `origins`.

    Raises:
        BadInputError: values that are fine one by one but do not fit together, or a part of the user's that raises.
    """
    try:
        return scenario.build()
    except BadInputError as error:
        raise located(scenario, error, where) from error.__cause__
    # What no check of ours foresaw: Drake refuses with a RuntimeError, its failed preconditions arrive as SystemExit,
    # a delay line of years does not fit into memory, and a part of the user's may raise anything.
    except (Exception, SystemExit, MemoryError) as error:
        key = full_key(scenario, error)
        kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
        reason = " ".join(str(error).split())[:300]
        origin = where(key) or f"scenario {scenario.title!r}"
        raise BadInputError(f"cannot be built: {kind}{reason}").at(key, origin) from error


def origins(
    file: ScenarioFile, variant: str = ONLY_VARIANT, overrides: Mapping[str, Any] | None = None
) -> Callable[[str], str]:
    """What says for a dotted key of the scenario that `resolve` makes of the same which file and line it is from."""
    return _Layers(file, variant, overrides or {}).where


def resolved_tree(scenarios: Mapping[str, Scenario]) -> Tagged:
    """One tree that holds all variants in full: the first one, and what the others change.

    Presets and defaults are written out, so that the tree means the same when they change later.
    """
    names = list(scenarios)
    trees = {name: tree_of_fields(scenario) for name, scenario in scenarios.items()}
    for tree in trees.values():
        tree.update(variants=Tagged(), preset=catalog.DEFAULT_PRESET)
    base = trees[names[0]]
    lines = zip(scenarios[names[0]].expect, base["expect"], strict=True)
    base["expect"] = [_without_nulls(part) for line, part in lines if {*line.variants(names).values()} <= {*names}]
    for tree in trees.values():
        tree["expect"] = base["expect"]
    if names != [ONLY_VARIANT]:
        base["variants"] = Tagged({name: difference(base, tree) for name, tree in trees.items()})
    return base


def _without_nulls(expectation: Tree) -> Tagged:
    return Tagged({key: value for key, value in expectation.items() if value is not None and value != []})
