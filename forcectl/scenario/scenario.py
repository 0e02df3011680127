"""Scenarios: what is simulated, in which variants, and what is expected of it.

The values of a scenario come from these layers, of which a later one wins: defaults of the dataclasses, plant preset,
scenario file, variant, overrides (`--set` on the command line).
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from forcectl.analysis.findings.config import FindingsConfig
from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.analysis.slot import check_figures, check_findings, check_metrics, read_only, run_figures, run_metrics
from forcectl.diagrams.loop import Loop, LoopParts, build_loop
from forcectl.diagrams.model import ModelConfig, Setting
from forcectl.diagrams.station import StationConfig
from forcectl.errors import BadInputError, RunFailedError, invalid, place_in_code, raised
from forcectl.force.guard.config import GuardConfig
from forcectl.force.integral import IntegralConfig
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.imports import Imports, allowed_names
from forcectl.framework.yaml_tree import IMPORT, Tagged, difference, dump, plain
from forcectl.motion.references import StepConfig
from forcectl.motion.tangential import TangentialMotionConfig
from forcectl.scenario import catalog
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.checks.judged import check_judged
from forcectl.scenario.checks.times import LONGEST_DURATION
from forcectl.scenario.checks.together import check_built, check_together
from forcectl.scenario.checks.unread import unread
from forcectl.scenario.checks.values import preset_tree
from forcectl.scenario.code import check_imports
from forcectl.scenario.error_keys import full_key, located
from forcectl.scenario.expectations import Expectation, JudgedMetric, judged_metrics
from forcectl.scenario.gains import identifications
from forcectl.scenario.layers import ONLY_VARIANT, Layers, check_order, leave_out, locate_files, select_variants
from forcectl.scenario.probes import probes_of
from forcectl.scenario.schema import ScenarioReader
from forcectl.scenario.trees import to_tree, tree_of_fields
from forcectl.scenario.user_settings import user_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORCE_LIMIT = 2.0  # a contact force above this many sensor ranges is a diverging run
LARGEST_CONTACT_FORCE = 2000.0  # [N] above it a run without a force sensor diverges
_AS_WRITTEN = {"seed", "station.fidelity"}  # overrides after which its checks and expectations still apply


@dataclass(kw_only=True, repr=False)
class Scenario(Config):
    """One complete simulation: a scenario file with its preset, one variant and all overrides applied."""

    title: str = key("", "title of the scenario, the heading of tables and figures")
    source: str = key("", "figure or table of the thesis that the scenario reproduces")
    description: str = key("", "text that says what the scenario shows")
    preset: str = key(catalog.DEFAULT_PRESET, "preset of the plant: name of a file in experiments/presets")
    station: StationConfig = key(StationConfig, "robot, drives, environment and sensors")
    model: ModelConfig = key(ModelConfig, "differences between the plant and the model that controllers use")
    estimators: dict[str, Any] = slot("estimator", dict, meaning="force and torque estimators, by name")
    controller: Any = slot("controller", IntegralConfig, meaning="force law, or a controller of joint motion")
    guard: GuardConfig | None = key(GuardConfig, "safety guard around the controller; null: no guard")
    reference: Any = slot("reference", StepConfig, meaning="desired force over time")
    motion: Any = slot("motion", TangentialMotionConfig, meaning="motion in the unconstrained directions")
    signals: dict[str, Any] = slot("signal", dict, meaning="sources of signals of the loop, by the name of the signal")
    analyses: dict[str, Any] = slot("analysis", dict, meaning="further metrics and figures of a run, by name")
    findings: FindingsConfig = key(FindingsConfig, "thresholds of what is reported after a run")
    log: list[str] = key([], "further output ports to log, by path, such as station/force_sensor.measured_force")
    duration: float = key(5.0, "simulated time", unit="s", bounds=f"positive, at most {LONGEST_DURATION:g}")
    after_end: float | None = key(
        None,
        "time that a run continues after the end of its state machine; null: up to the duration",
        unit="s",
        bounds="not negative",
    )
    seed: int = key(0, "seed of all random numbers of a run", bounds="from 0 to 9223372036854775807")
    reference_model: float | None = key(
        None, "bandwidth of the reference model M(s); null: the controller's", unit="rad/s", bounds="positive"
    )
    model_error_window: float = key(
        4.1, "time window T_w of the metric model_error_sd_N", unit="s", bounds="above 0 and at most 1000"
    )
    variants: dict[str, Any] = key({}, "values that a variant changes, by the name of the variant")
    fidelities: list[str] = key(
        [], "fidelities that `reproduce` runs; empty: only the station's", choices=lambda: catalog.tags_of("fidelity")
    )
    expect: list[Expectation] = key([], "required values of the metrics")

    imports = Imports()  # modules that it, and the scenarios it names, may import; no key
    judged = tuple[JudgedMetric, ...]()  # metrics for which `expect` has a line
    as_written = False  # whether it is free of overrides, those of `_AS_WRITTEN` aside

    def __repr__(self) -> str:
        controller = to_tree(self.controller, "controller")
        return f"<scenario {self.title!r}: {self.fidelity}, !{controller.tag}, {self.duration:g} s>"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(dump(tree_of_fields(self)))}</pre>"

    @property
    def fidelity(self) -> str:
        """Tag of the station's fidelity."""
        tree = to_tree(self.station.fidelity, "fidelity")
        return tree.tag if tree.tag != IMPORT else str(tree["path"])

    @property
    def parts(self) -> LoopParts:
        """The configurations of the loop's parts."""
        return LoopParts(**{part.name: getattr(self, part.name) for part in fields(LoopParts)})

    def build(self) -> Loop:
        """The loop, with its Drake diagram."""
        loop = build_loop(self.parts)
        if self.reference_model and "desired_force" not in loop.signals:
            raise invalid("reference_model", self.reference_model, "left out where nothing takes a desired force")
        check_built(self, loop)
        check_judged(self, loop)
        probes = probes_of(loop.diagram, self.log, loop.workcell) if self.log else ()
        return replace(loop, probes=(*loop.probes, *probes))

    def experiment(self, name: str, variant: str | None) -> Scenario:
        """The experiment that a law names in `gains_from`; one that this experiment names in turn is not followed."""
        file = as_file(name)
        return _resolved(file, select_variants(file, variant)[0], imports=self.imports)[0]

    def setting(self) -> Setting:
        """What analyses get in addition to the log."""
        return self.parts.setting()

    def limits(self) -> dict[str, float]:
        """Largest absolute values, by signal, beyond which a run is stopped as diverging."""
        ranges = [FORCE_LIMIT * each.range for each in self.station.sensors.values() if hasattr(each, "range")]
        largest = min(ranges, default=LARGEST_CONTACT_FORCE)
        return {"contact_force": largest, "arm_contact_force": LARGEST_CONTACT_FORCE}

    def model_bandwidth(self, of_controller: float | None) -> float | None:
        """Bandwidth of the reference model [rad/s], by default that of the controller; None where neither has one."""
        return self.reference_model or of_controller or None

    def metrics(self, log: xr.Dataset, setting: Setting) -> dict[str, float | None]:
        """All metrics of a run."""
        own = run_metrics(log, setting, window=self.model_error_window, motion=self.motion.interval())
        for name in self.analyses:
            own |= check_metrics(self.asked(name, "metrics", log, setting), own, name)
        return own

    def found(self, log: xr.Dataset, setting: Setting) -> list[RunFinding]:
        """The findings of a run that are not ignored, the worst first; those of equal severity by their times."""
        findings = self.findings.found(log, setting, self.motion.interval())
        findings += [finding("key_unread", line) for line in unread(self, {*map(str, log)})]
        for name, analysis in self.analyses.items():
            if hasattr(analysis, "findings"):
                findings += check_findings(self.asked(name, "findings", log, setting, kind=list), name)
        kept = [one for one in findings if one.kind not in self.findings.ignore]
        return sorted(kept, key=lambda one: (-one.severity, math.inf if one.time is None else one.time))

    def figures(
        self, log: xr.Dataset, title: str, findings: Mapping[str, Sequence[RunFinding]] | None = None
    ) -> dict[str, Figure]:
        """Figures of a run by file name.

        Args:
            log: over time, or over (variant, time).
            title: heading.
            findings: findings of every variant, which are marked in the figures.
        """
        allowed = [one for line in self.expect if (one := line.allowed(self.fidelity)) is not None]
        figures = run_figures(log, title, findings or {}, allowed, self.motion.interval())
        setting = self.setting() if self.analyses else None
        for name in self.analyses:
            figures |= check_figures(self.asked(name, "figures", log, setting, title), figures, name)
        return figures

    def asked(self, name: str, method: str, log: xr.Dataset, *arguments: Any, kind: Any = Mapping) -> Any:
        """The result of a method of an analysis; RunFailedError where it raises or returns another type than `kind`."""
        try:
            found = getattr(self.analyses[name], method)(read_only(log), *arguments)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a user's analysis may raise anything
            raise RunFailedError(f"analyses.{name}: {method} raised {raised(error)}") from error
        if not isinstance(found, kind):
            wanted = f"a {kind.__name__.lower()}"
            raise RunFailedError(f"analyses.{name}: {method} must return {wanted}, not {type(found).__name__}")
        return found


Named = str | Path | Mapping[str, Any] | Scenario | ScenarioFile  # what names or holds a scenario
ONE_SCENARIO = (str, Path, Mapping, Scenario, ScenarioFile)  # the same, for isinstance


def load_scenario(
    scenario: Named,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
) -> Scenario:
    """Load one complete scenario, which has no other variants.

    Args:
        scenario: name of a shipped experiment, path of a YAML file, the same content as a mapping, or a `Scenario`.
        variant: name of the variant, which it keeps; None: the first. Lines of `expect` about others are left out.
        overrides: dotted key -> value, stronger than all other layers; a value may be a config object.
        seed: shorthand for an override of `seed`.
        fidelity: shorthand for an override of `station.fidelity`.
        allow_imports: modules that it may import in addition to those in its folder, see docs/security.md.

    Raises:
        BadInputError: something in it cannot be used.
    """
    file = as_file(scenario, allow_imports)
    name, names = select_variants(file, variant)[0], select_variants(file)
    loaded = resolve(file, name, with_shortcuts(overrides, seed, fidelity))
    loaded.variants = {} if name == ONLY_VARIANT else {name: {}}
    loaded.expect = [line for line in loaded.expect if line.is_of([name], names)]
    return loaded


def _loaded(
    file: ScenarioFile, variant: str | None, changes: Mapping[str, Any]
) -> tuple[Scenario, Callable[[str], str]]:
    """One scenario, and a function that gives the origin of each of its keys."""
    name = select_variants(file, variant)[0]
    return resolve(file, name, changes), origins(file, name, changes)


def with_shortcuts(overrides: Mapping[str, Any] | None, seed: int | None, fidelity: str | None) -> dict[str, Any]:
    """Overrides, together with the values that have an argument of their own.

    Raises:
        BadInputError: overrides are no mapping, or contradict these arguments.
    """
    if not isinstance(overrides, Mapping | None):
        raise invalid("overrides", overrides, "a mapping of dotted keys to values")
    shortcuts = {"seed": seed, "station.fidelity": fidelity}
    given = {key: value for key, value in shortcuts.items() if value is not None}
    check_order(overrides or {}, given)
    return dict(overrides or {}) | given


def as_file(scenario: Named, allow_imports: Sequence[str] = (), modules: Path | None = None) -> ScenarioFile:
    """Anything that names or holds a scenario as a `ScenarioFile`; without a folder it is in the working directory.

    Args:
        scenario: see `load_scenario`.
        allow_imports: modules that it may import in addition to those in the user's settings.
        modules: folder whose modules it may import; None: its own folder. Ignored for a shipped scenario.

    Raises:
        BadInputError: there is no such scenario, or no such module.
    """
    file = _file(scenario)
    if modules is not None and file.folder != catalog.experiments_folder():
        file = replace(file, modules=modules)
    allowed = allowed_names(allow_imports, "allow_imports")
    file.allowed.check_found(allowed, "allow_imports")
    names = (*allowed, *user_settings().allow_imports)
    return replace(file, imports=tuple(dict.fromkeys((*file.imports, *names))))


def _file(scenario: Named) -> ScenarioFile:
    if isinstance(scenario, ScenarioFile):
        return scenario
    imports = Imports()
    if isinstance(scenario, Scenario):
        imports, scenario = scenario.imports, {f.name: getattr(scenario, f.name) for f in fields(scenario)}
    if isinstance(scenario, Mapping):
        tree = catalog.scenario_tree(plain(scenario), "scenario")
        return ScenarioFile("scenario", "scenario", tree, imports.folder or Path.cwd(), imports.names)
    if isinstance(scenario, str | Path):
        return catalog.find_scenario(scenario)
    raise invalid("scenario", scenario, "a name, a path, a mapping or a Scenario")


def resolve(file: ScenarioFile, variant: str = ONLY_VARIANT, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of one variant, with preset and overrides applied.

    Raises:
        BadInputError: with file or option, dotted key, value and what is allowed.
    """
    scenario, where = _resolved(file, variant, overrides)
    try:
        identifications(scenario, scenario.experiment)
    except BadInputError as error:
        raise error.at(error.key, where(error.key)) from error.__cause__
    return scenario


def _resolved(
    file: ScenarioFile, variant: str, overrides: Mapping[str, Any] | None = None, imports: Imports | None = None
) -> tuple[Scenario, Callable[[str], str]]:
    """What `resolve` makes, but with experiments in `gains_from` unchecked, and a function for the origin of each key.

    Args:
        file: the scenario's.
        variant: name of one of its variants.
        overrides: by dotted key.
        imports: what it may import; None: what its folder allows.
    """
    imports = imports or file.allowed
    layers = Layers(file, variant, overrides or {}, Scenario)
    tree = layers.merged()
    layers.check_gone(tree)
    check_imports(file, imports, file.where)
    check_imports(replace(file, tree=tree), imports, layers.where, overrides)
    locate_files(tree, file.folder)
    scenario: Scenario = ScenarioReader(layers.where, imports).dataclass(Scenario, tree)
    scenario.imports = imports
    try:
        check_together(scenario, overrides or {})
        judged = judged_metrics(scenario.expect, variant, select_variants(file), scenario.fidelity)
    except BadInputError as error:
        raise error.at(error.key, layers.where(error.key)) from None
    scenario.as_written, scenario.judged = {*(overrides or {})} <= _AS_WRITTEN, judged
    return scenario, layers.where


def build(
    scenario: Named,
    where: Callable[[str], str] | None = None,
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
) -> Loop:
    """The loop of a scenario: its attribute `diagram` is the Drake diagram, with `controller` and `station` inside.

    Args:
        scenario: name of a shipped experiment, path of a YAML file, its content as a mapping, or a `Scenario`.
        where: gives the origin of the value at a dotted key of a `Scenario`, see `origins`.
        variant, overrides, seed, fidelity, allow_imports: see `load_scenario`.

    Raises:
        BadInputError: something in it cannot be used, values do not fit together although each is allowed, or a part
            of the user's raises.
    """
    changes = with_shortcuts(overrides, seed, fidelity)
    if not isinstance(scenario, Scenario) or variant is not None or changes:
        scenario, where = _loaded(as_file(scenario, allow_imports), variant, changes)
    where = where or (lambda key: "")
    try:
        return scenario.build()
    except BadInputError as error:
        raise located(scenario, error, where) from error.__cause__
    # Errors that no check anticipates: Drake raises RuntimeError, and SystemExit for failed preconditions; a delay line
    # of years does not fit into memory; a part of the user's may raise anything.
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        key = full_key(scenario, error)
        kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
        reason = " ".join(str(error).split())[:300]
        origin = where(key) or f"scenario {scenario.title!r}"
        from forcectl.doctor.loops import loop_behind  # a slow import

        fault = loop_behind(error) or BadInputError(f"cannot be built: {kind}{reason}{place_in_code(error)}")
        raise fault.at(key, origin) from error


def origins(
    file: ScenarioFile, variant: str = ONLY_VARIANT, overrides: Mapping[str, Any] | None = None
) -> Callable[[str], str]:
    """A function that gives file and line of a dotted key, for the scenario that `resolve` makes of these arguments."""
    return Layers(file, variant, overrides or {}, Scenario).where


def resolved_tree(scenarios: Mapping[str, Scenario]) -> Tagged:
    """One tree with all variants: the first one in full, and what the others change.

    Presets and defaults are written out, so that later changes of them do not affect the tree. A part of the preset
    that a scenario does not have is written as null.
    """
    names = list(scenarios)
    trees = {name: tree_of_fields(scenario) for name, scenario in scenarios.items()}
    for name, tree in trees.items():
        tree.update(variants=Tagged())
        leave_out(tree, preset_tree(scenarios[name]))
    base = trees[names[0]]
    lines = zip(scenarios[names[0]].expect, base["expect"], strict=True)
    kept = [part for line, part in lines if line.is_of(names, names)]
    base["expect"] = [Tagged({key: v for key, v in part.items() if v is not None and v != []}) for part in kept]
    for tree in trees.values():
        tree["expect"] = base["expect"]
    if names != [ONLY_VARIANT]:
        base["variants"] = Tagged({name: difference(base, tree) for name, tree in trees.items()})
    return base
