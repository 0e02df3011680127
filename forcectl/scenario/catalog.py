"""What is there to choose from: experiments, presets, controllers, references, robots, tools and blocks.

Reads files only and imports no Drake, so that `forcectl list` answers at once. A new controller or reference becomes a
scenario tag by one line in `CONTROLLERS` or `REFERENCES`.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forcectl import experiments
from forcectl.errors import BadInputError, unknown
from forcectl.models import list_robots, list_tools
from forcectl.scenario.yaml_tree import Tagged, parse

# Scenario tag -> import path of the dataclass behind it. The first of each table is the default.
CONTROLLERS = {
    "Integral": "forcectl.force.integral:IntegralConfig",
    "AdaptiveIntegral": "forcectl.force.adaptive_integral:AdaptiveIntegralConfig",
    "FourthDegreeInvariance": "forcectl.force.invariance.fourth_degree:FourthDegreeInvarianceConfig",
    "AdaptiveFourthDegreeInvariance": "forcectl.force.invariance.fourth_degree:AdaptiveFourthDegreeInvarianceConfig",
    "AdaptiveInvariance": "forcectl.force.invariance.force_law:AdaptiveInvarianceConfig",
    "InvarianceControl": "forcectl.force.invariance.correction:InvarianceControlConfig",
    "AdaptiveInvarianceControl": "forcectl.force.invariance.correction:AdaptiveInvarianceControlConfig",
    "Invariance": "forcectl.force.invariance.force_law:InvarianceConfig",
    "PredictiveInvariance": "forcectl.force.invariance.predictive:PredictiveInvarianceConfig",
    "InvarianceRobot": "forcectl.force.invariance.robot:InvarianceRobotConfig",
    "Vrft": "forcectl.force.linear_law:VrftConfig",
    "Governed": "forcectl.force.governor.governor:GovernedConfig",
    "ScaledVrft": "forcectl.force.vrft.scaled:ScaledVrftConfig",
    "AdaptiveVrft": "forcectl.force.vrft.adaptive:AdaptiveVrftConfig",
    "RecursiveVrft": "forcectl.force.vrft.experiment:RecursiveVrftConfig",
    "Import": "forcectl.scenario.imported:ImportConfig",
}
REFERENCES = {
    "Step": "forcectl.motion.references:StepConfig",
    "Ramp": "forcectl.motion.references:RampConfig",
    "Sine": "forcectl.motion.references:SineConfig",
    "Sequence": "forcectl.motion.references:SequenceConfig",
    "File": "forcectl.motion.references:FileConfig",
}
# Of the motion loop (Part II); see `forcectl.tasks.slot`.
MOTION_CONTROLLERS = {
    "JointMoves": "forcectl.motion.joint_path:JointMovesConfig",
    "JointExcitation": "forcectl.motion.joint_path:JointExcitationConfig",
    "ReactiveReaching": "forcectl.tasks.reaching:ReactiveReachingConfig",
    "Import": "forcectl.scenario.imported:ImportConfig",
}
ESTIMATORS = {
    "NoEstimator": "forcectl.tasks.slot:NoEstimatorConfig",
    "ForceEstimator": "forcectl.estimation.force_estimator:ForceEstimatorConfig",
    "Import": "forcectl.scenario.imported:ImportConfig",
}
ANALYSES = {
    "NoAnalysis": "forcectl.analysis.slot:NoAnalysis",
    "ForceEstimation": "forcectl.analysis.force_estimation:ForceAnalysis",
    "FrictionIdentification": "forcectl.analysis.friction_identification:FrictionAnalysis",
    "Reaching": "forcectl.analysis.reaching:ReachAnalysis",
}
# Loop of a scenario -> its slots -> their tags.
SLOTS = {
    "force": {"controller": CONTROLLERS, "reference": REFERENCES},
    "motion": {"controller": MOTION_CONTROLLERS, "estimator": ESTIMATORS, "analysis": ANALYSES},
}
MOTION_STATION = "Research"  # the one kind of station there is in motion loops
FIDELITIES = ("OneDimensional", "Kinematic", "Multibody")
INTERFACES = ("JointPosition", "JointImpedance")
DEFAULT_PRESET = "friction"
BLOCK_ROOMS = ("plant", "force", "tasks", "motion", "estimation")
SYSTEMS = ("LeafSystem", "Diagram", "LinearSystem", "AffineSystem", "MatrixGain")  # of Drake, that blocks derive from


@dataclass(frozen=True)
class ScenarioFile:
    """A scenario as written: name, label for messages, tree, and the folder that relative paths start from."""

    name: str
    origin: str
    tree: Tagged
    folder: Path


def experiments_folder() -> Path:
    """The folder of the shipped experiments."""
    return Path(str(experiments.__file__)).parent


def list_experiments(loop: str | None = None) -> list[str]:
    """Names of the shipped experiments, sorted; of one kind of loop (a key of `SLOTS`) when it is given."""
    names = sorted(file.stem for file in experiments_folder().glob("*.yaml"))
    return [name for name in names if loop is None or loop_of(find_scenario(name)) == loop]


def loop_of(file: ScenarioFile) -> str:
    """Which kind of loop a scenario as written is about."""
    return str(file.tree.get("loop", next(iter(SLOTS))))


def list_presets() -> list[str]:
    """Names of the plant presets, sorted."""
    return sorted(file.stem for file in (experiments_folder() / "presets").glob("*.yaml"))


def list_blocks() -> dict[str, str]:
    """Every file with a Drake system, as `room/name`, with the first line of its documentation."""
    root = Path(__file__).parent.parent
    sources = [file for room in ("framework", *BLOCK_ROOMS) for file in _sources(root / room)]
    files = {file: ast.parse(file.read_text(encoding="utf-8")) for file in sources}
    classes = [(file, node) for file, tree in files.items() for node in tree.body if isinstance(node, ast.ClassDef)]
    systems = set(SYSTEMS)
    known = 0
    while known != len(systems):  # bases before the classes made of them, whatever the order of the files
        known = len(systems)
        systems |= {node.name for _, node in classes if systems & {ast.unparse(base) for base in node.bases}}
    found = {}
    for file in dict.fromkeys(file for file, node in classes if node.name in systems):
        name = file.relative_to(root).with_suffix("").as_posix()
        if not name.startswith("framework/"):
            found[name] = (ast.get_docstring(files[file]) or "").split("\n", 1)[0]
    return found


def _sources(folder: Path) -> list[Path]:
    return sorted(folder.rglob("[!_]*.py"))


def find_scenario(name_or_path: str | Path) -> ScenarioFile:
    """The scenario of that name among the shipped ones, or in the file at that path.

    Raises:
        BadInputError: no such name or file, or the file is not a YAML mapping.
    """
    name = str(name_or_path)
    if name in list_experiments():
        return read_scenario(experiments_folder() / f"{name}.yaml", name)
    path = Path(name).expanduser()
    if path.is_file():
        return read_scenario(path, path.stem)
    if path.suffix in (".yaml", ".yml") or "/" in name:
        kind = "is a folder" if path.is_dir() else "does not exist"
        raise BadInputError(
            f"scenario file {name!r} {kind}: must be a YAML file or one of: {', '.join(list_experiments())}"
        )
    raise unknown("scenario", name, list_experiments())


def find_preset(name: object) -> ScenarioFile:
    """The plant preset of that name.

    Raises:
        BadInputError: no such preset.
    """
    if name not in list_presets():
        raise unknown("preset", str(name), list_presets())
    return read_scenario(experiments_folder() / "presets" / f"{name}.yaml", str(name))


def read_scenario(path: Path, name: str) -> ScenarioFile:
    """Read one scenario file.

    Raises:
        BadInputError: the file cannot be read or is not a YAML mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise BadInputError(f"cannot read scenario file {str(path)!r}: {reason}") from None
    return ScenarioFile(name, path.name, scenario_tree(parse(text, path.name), path.name), path.parent)


def scenario_tree(tree: Any, origin: str) -> Tagged:
    """The root of a scenario; keys that begin with an underscore (anchors, templates) are dropped, as in Drake."""
    if not isinstance(tree, Tagged) or tree.tag is not None:
        kind = (
            "empty" if tree is None else "a tagged mapping" if isinstance(tree, Tagged) else f"a {type(tree).__name__}"
        )
        raise BadInputError(
            f"{origin} is {kind}: must be a mapping of scenario keys, such as station, controller, duration"
        )
    return Tagged({k: v for k, v in tree.items() if not str(k).startswith("_")})


def list_models() -> dict[str, list[str]]:
    """Shipped robots and tools, by the scenario key that names them."""
    return {"station.robot": list_robots(), "station.tool": list_tools()}
