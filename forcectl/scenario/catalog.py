"""Lists of what a scenario can use: experiments, presets, controllers, references, robots, tools and blocks.

This module reads files only and does not import Drake, so that `forcectl list` is fast. One line in `SLOTS` makes a
configuration available as a tag.
"""

from __future__ import annotations

import ast
import os
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from forcectl import experiments
from forcectl.errors import BadInputError, show, unknown
from forcectl.framework.files.text_file import yaml_text
from forcectl.framework.imports import Imports
from forcectl.framework.yaml_tree import Tagged, parse, place
from forcectl.models import list_robots, list_tools

_INVARIANCE = "forcectl.force.invariance"
_BASELINES = "forcectl.force.baselines"
_NULL_SPACE = "forcectl.tasks.null_space_parts"
_CONSTRAINTS = "forcectl.tasks.constraints.parts"
# By slot of a scenario: tag -> import path of the configuration. The first tag of each slot is the default.
# Installed packages add tags by entry points of the group `forcectl.<slot>`.
SLOTS: dict[str, dict[str, str]] = {
    "controller": {
        "Integral": "forcectl.force.integral:IntegralConfig",
        "AdaptiveIntegral": "forcectl.force.adaptive_integral:AdaptiveIntegralConfig",
        "FourthDegreeInvariance": "forcectl.force.invariance.fourth_degree:FourthDegreeInvarianceConfig",
        "AdaptiveFourthDegreeInvariance": f"{_INVARIANCE}.fourth_degree:AdaptiveFourthDegreeInvarianceConfig",
        "AdaptiveInvariance": "forcectl.force.invariance.force_law:AdaptiveInvarianceConfig",
        "InvarianceControl": "forcectl.force.invariance.correction:InvarianceControlConfig",
        "AdaptiveInvarianceControl": "forcectl.force.invariance.correction:AdaptiveInvarianceControlConfig",
        "Invariance": "forcectl.force.invariance.force_law:InvarianceConfig",
        "PredictiveInvariance": "forcectl.force.invariance.predictive:PredictiveInvarianceConfig",
        "InvarianceRobot": "forcectl.force.invariance.robot:InvarianceRobotConfig",
        "Vrft": "forcectl.force.linear_law:VrftConfig",
        "Governed": "forcectl.force.governor.governor:GovernedConfig",
        "ScaledVrft": "forcectl.force.vrft.scaled:ScaledVrftConfig",
        "Admittance": "forcectl.force.admittance:AdmittanceConfig",
        "AdaptiveAdmittance": f"{_BASELINES}.impedance:AdaptiveAdmittanceConfig",
        "Impedance": f"{_BASELINES}.impedance:ImpedanceConfig",
        "Pid": f"{_BASELINES}.pid:PidConfig",
        "DisturbanceObserver": f"{_BASELINES}.disturbance_observer:DisturbanceObserverConfig",
        "Passive": f"{_BASELINES}.passive:PassiveConfig",
        "Approach": "forcectl.force.approach:ApproachConfig",
        "AdaptiveVrft": "forcectl.force.vrft.adaptive:AdaptiveVrftConfig",
        "RecursiveVrft": "forcectl.force.vrft.experiment:RecursiveVrftConfig",
        "Hybrid": "forcectl.force.hybrid.config:HybridConfig",
        "PerArm": "forcectl.force.per_arm:PerArmConfig",
        "JointMoves": "forcectl.motion.joint_path:JointMovesConfig",
        "JointExcitation": "forcectl.motion.joint_path:JointExcitationConfig",
        "ReactiveReaching": "forcectl.tasks.controllers.reaching:ReactiveReachingConfig",
        "TaskMachine": "forcectl.tasks.controllers.task_machine:TaskMachineConfig",
    },
    "reference": {
        "Step": "forcectl.motion.references:StepConfig",
        "Ramp": "forcectl.motion.references:RampConfig",
        "Sine": "forcectl.motion.references:SineConfig",
        "Sequence": "forcectl.motion.references:SequenceConfig",
        "File": "forcectl.motion.references:FileConfig",
    },
    "motion": {
        "AlongSurface": "forcectl.motion.tangential:TangentialMotionConfig",
        "VelocityAlongSurface": "forcectl.motion.surface_velocity:SurfaceVelocityConfig",
    },
    "estimator": {
        "ForceEstimator": "forcectl.estimation.force_estimator_config:ForceEstimatorConfig",
        "KalmanForceEstimator": "forcectl.estimation.force_estimator_config:KalmanForceEstimatorConfig",
    },
    "signal": {
        "Projection": "forcectl.diagrams.signals:ProjectionConfig",
        "From": "forcectl.diagrams.signals:FromConfig",
        "Exact": "forcectl.diagrams.signals:ExactConfig",
        "WrenchBetween": "forcectl.diagrams.signals:WrenchBetweenConfig",
    },
    "analysis": {
        "ForceEstimation": "forcectl.analysis.force_estimation:ForceAnalysis",
        "FrictionIdentification": "forcectl.analysis.friction_identification:FrictionAnalysis",
        "Alignment": "forcectl.analysis.alignment:AlignmentAnalysis",
        "Reaching": "forcectl.analysis.reaching:ReachAnalysis",
        "Insertion": "forcectl.analysis.insertion:InsertionAnalysis",
        "Assembly": "forcectl.analysis.assembly:AssemblyAnalysis",
        "Transitions": "forcectl.analysis.transitions:TransitionAnalysis",
        "KeptForce": "forcectl.analysis.kept_force:KeptForceAnalysis",
        "WrenchErrors": "forcectl.analysis.wrench_errors:WrenchErrorAnalysis",
        "SurfaceAlignment": "forcectl.analysis.contact.surface_alignment:SurfaceAlignmentAnalysis",
        "SideForce": "forcectl.analysis.contact.side_force:SideForceAnalysis",
        "SurfaceFollowing": "forcectl.analysis.contact.surface_following:SurfaceFollowingAnalysis",
        "TouchDown": "forcectl.analysis.contact.touch_down:TouchDownAnalysis",
    },
    "fidelity": {
        "Multibody": "forcectl.diagrams.fidelities.multibody:MultibodyFidelity",
        "Kinematic": "forcectl.diagrams.fidelities.light:KinematicFidelity",
        "OneDimensional": "forcectl.diagrams.fidelities.light:OneDimensionalFidelity",
    },
    "drive": {
        "PositionLoop": "forcectl.diagrams.drives.position_drive:PositionDriveConfig",
        "JointImpedance": "forcectl.diagrams.drives.position_drive:JointImpedanceDriveConfig",
        "JointInterface": "forcectl.diagrams.drives.joint_interface:JointInterfaceConfig",
        "Commanded": "forcectl.diagrams.drives.commanded_drive:CommandedDriveConfig",
    },
    "sensor": {
        "WristForce": "forcectl.diagrams.sensors:WristForceConfig",
        "JointReadings": "forcectl.diagrams.sensors:JointReadingsConfig",
        "ContactTruth": "forcectl.diagrams.sensors:ContactTruthConfig",
    },
    "environment": {
        "Surface": "forcectl.plant.contact.compliant_contact:EnvironmentConfig",
        "Patch": "forcectl.plant.contact.patch:PatchConfig",
        "Box": "forcectl.plant.contact.obstacle:ObstacleConfig",
        "Parts": "forcectl.plant.contact.parts:EnvironmentPartsConfig",
        "Part": "forcectl.plant.contact.part:PartConfig",
        "PegInBore": "forcectl.plant.contact.pairs.peg_contact:InsertionConfig",
        "CapOnMount": "forcectl.plant.contact.pairs.cap_contact:CapOnMountConfig",
    },
    "surface": {
        "Grooves": "forcectl.plant.contact.surface:GrooveConfig",
        "Roughness": "forcectl.plant.contact.surface:RoughnessConfig",
        "Waves": "forcectl.plant.contact.surface:WaveConfig",
        "Arc": "forcectl.plant.contact.turning_surface:ArcConfig",
        "ProfileFile": "forcectl.plant.contact.surface:ProfileFileConfig",
    },
    "load": {"Load": "forcectl.motion.loads:LoadConfig"},
    "excitation": {
        "TrapezoidalMoves": "forcectl.motion.excitation:TrapezoidalMovesConfig",
        "ExcitationFile": "forcectl.motion.excitation:ExcitationFileConfig",
    },
    "task": {
        "ArmTask": "forcectl.tasks.task_parts:ArmTaskConfig",
        "RelativeTask": "forcectl.tasks.task_parts:RelativeTaskConfig",
    },
    "constraint": {
        "Wall": f"{_CONSTRAINTS}:WallConfig",
        "Range": f"{_CONSTRAINTS}:RangeConfig",
        "SpeedLimit": f"{_CONSTRAINTS}:SpeedLimitConfig",
        "LinkDistance": f"{_CONSTRAINTS}:LinkDistanceConfig",
        "Robust": f"{_CONSTRAINTS}:RobustConfig",
        "ForceBand": f"{_CONSTRAINTS}:ForceBandConfig",
    },
    "null_space": {
        "JointSpeed": f"{_NULL_SPACE}:JointSpeedConfig",
        "SelfMotion": f"{_NULL_SPACE}:SelfMotionConfig",
        "Evasive": f"{_NULL_SPACE}:EvasiveConfig",
    },
    "potential": {
        "AwayFromJointLimits": f"{_NULL_SPACE}:JointLimitPotentialConfig",
        "AwayFromLinks": f"{_NULL_SPACE}:LinkPotentialConfig",
        "AwayFrom": f"{_NULL_SPACE}:ConstraintPotentialConfig",
        "TowardsSmallMass": f"{_NULL_SPACE}:SmallMassPotentialConfig",
    },
    "fault": {"ReadingFault": "forcectl.plant.sensors.joint_sensors:ReadingFaultConfig"},
}
# Methods that an object must have to fill a slot.
CONTRACTS: dict[str, tuple[str, ...]] = {
    "controller": ("add_to",),
    "reference": ("add_to", "largest_force"),
    "motion": ("add_to", "interval"),
    "estimator": ("add_to",),
    "signal": ("choose",),
    "analysis": ("metrics", "figures"),
    "fidelity": ("build", "check"),
    "drive": ("add_to",),
    "sensor": ("add_to",),
    "environment": (),
    "surface": ("heights",),
    "load": ("wrench",),
    "excitation": ("add_to", "end_time"),
    "task": ("task",),
    "constraint": ("constraint",),
    "null_space": ("criterion",),
    "potential": ("potentials",),
    "fault": ("fault",),
}
_GROUP = "forcectl."  # prefix of the groups of entry points, followed by the slot
DEFAULT_PRESET = "friction"
BLOCK_ROOMS = ("plant", "force", "tasks", "motion", "estimation")
SYSTEMS = ("LeafSystem", "Diagram", "LinearSystem", "AffineSystem", "MatrixGain")  # Drake's base classes of blocks


@dataclass(frozen=True)
class ScenarioFile:
    """A scenario as written.

    Attributes:
        name: name of the scenario.
        origin: label of the file in messages.
        tree: content of the file.
        folder: folder that relative paths start from.
        imports: modules that it may import in addition to those in its folder, see `forcectl.framework.imports`.
        modules: folder whose modules it may import; None: its own folder.
    """

    name: str
    origin: str
    tree: Tagged
    folder: Path
    imports: tuple[str, ...] = ()
    modules: Path | None = None

    @property
    def allowed(self) -> Imports:
        """Modules that it may import; for a changed shipped scenario those in the working directory."""
        own = Path.cwd() if self.folder == experiments_folder() else self.folder
        return Imports(self.modules or own, self.imports)

    def where(self, key: str, note: str = "") -> str:
        """Origin of the value at a dotted key for messages: file, line and note; see `place`."""
        found = place(self.origin, self.tree.lines, key)
        return f"{found}: {note}" if note else found


def experiments_folder() -> Path:
    """The folder of the shipped experiments."""
    return Path(str(experiments.__file__)).parent


def list_experiments() -> list[str]:
    """Names of the shipped experiments, sorted."""
    return sorted(file.stem for file in experiments_folder().glob("*.yaml"))


def tags_of(slot: str) -> dict[str, str]:
    """Tags of a slot, the shipped ones and those of installed packages: tag -> import path."""
    return SLOTS[slot] | {tag: path for tag, path in announced(slot).items() if tag not in SLOTS[slot]}


@cache
def announced(slot: str) -> dict[str, str]:
    """Tags of a slot from entry points of installed packages, sorted: tag -> import path. Cached per process."""
    from importlib.metadata import entry_points

    points = sorted(entry_points(group=f"{_GROUP}{slot}"))
    return {point.name: point.value for point in points if not _fault(slot, point.name)}


def groups() -> list[str]:
    """Groups of entry points by which a package can add tags to slots."""
    return [f"{_GROUP}{slot}" for slot in SLOTS]


def passed_over() -> list[str]:
    """Messages about entry points of installed packages that are ignored, with the reason. Nothing is imported."""
    from importlib.metadata import entry_points

    points = entry_points()
    lines = []
    for group in sorted(group for group in points.groups if group.startswith(_GROUP)):
        for point in sorted(points.select(group=group)):
            if fault := _fault(group.removeprefix(_GROUP), point.name):
                lines.append(f"passed over: {group}: {point.name} = {point.value}: {fault}")
    return lines


def _fault(slot: str, tag: str) -> str:
    """Why a tag from an entry point is refused; "" where it is fine."""
    from importlib.metadata import entry_points

    if slot not in SLOTS:
        return str(unknown("group", f"{_GROUP}{slot}", groups()))
    if tag in SLOTS[slot]:
        return f"!{tag} is forcectl's own: must have another name"
    if not re.fullmatch(r"[\w.-]+", tag):
        return "a tag must be letters, digits, and _ . -"
    paths = sorted({point.value for point in entry_points(group=f"{_GROUP}{slot}", name=tag)})
    return f"announced as {' and '.join(paths)}: must be one, or named by `!Import`" if len(paths) > 1 else ""


def list_presets() -> list[str]:
    """Names of the plant presets, sorted."""
    return sorted(file.stem for file in (experiments_folder() / "presets").glob("*.yaml"))


def list_blocks() -> dict[str, str]:
    """Every file with a Drake system, as `room/name`, with the first line of its documentation."""
    root = Path(__file__).parent.parent
    sources = [file for room in ("framework", *BLOCK_ROOMS) for file in sorted((root / room).rglob("[!_]*.py"))]
    files = {file: ast.parse(file.read_text(encoding="utf-8")) for file in sources}
    classes = [(file, node) for file, tree in files.items() for node in tree.body if isinstance(node, ast.ClassDef)]
    systems, known = set(SYSTEMS), 0
    while known != len(systems):  # until no derived class is added, whatever the order of the files
        known = len(systems)
        systems |= {node.name for _, node in classes if systems & {ast.unparse(base) for base in node.bases}}
    found = {}
    for file in dict.fromkeys(file for file, node in classes if node.name in systems):
        name = file.relative_to(root).with_suffix("").as_posix()
        if not name.startswith("framework/"):
            found[name] = (ast.get_docstring(files[file]) or "").split("\n", 1)[0].replace("::", ".")
    return found


def first_line(path: str) -> str:
    """First line of the documentation of a class, or else of its module, read without importing it.

    Args:
        path: import path as in `SLOTS`; for a class that is not shipped the path itself is returned.
    """
    module, _, name = path.partition(":")
    file = Path(__file__).parents[2] / f"{module.replace('.', '/')}.py"
    if not file.is_file():
        return path
    tree = ast.parse(file.read_text(encoding="utf-8"))
    text = next((ast.get_docstring(n) for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name), None)
    for words in filter(None, (text, ast.get_docstring(tree))):
        if own := re.sub(r"^Scenario part `[^`]+`[.:;]? *", "", words.split("\n", 1)[0]):
            return own.replace("::", ".")
    return path


def find_scenario(name_or_path: str | Path) -> ScenarioFile:
    """The scenario of that name among the shipped ones, or in the file at that path.

    Raises:
        BadInputError: no such name or file, or the file is not a YAML mapping.
    """
    name = str(name_or_path)
    if name in list_experiments():
        return read_scenario(experiments_folder() / f"{name}.yaml", name)
    path = Path(os.path.expanduser(name))
    if os.path.isfile(path):
        return read_scenario(path, path.stem)
    if (folder := os.path.isdir(path)) or path.suffix in (".yaml", ".yml") or "/" in name:
        kind = "is a folder" if folder else "does not exist"
        inside = f", such as {show(str(path / 'scenario.yaml'))}," if os.path.isfile(path / "scenario.yaml") else ""
        raise BadInputError(
            f"scenario file {show(name)} {kind}: must be a YAML file{inside} or one of: {', '.join(list_experiments())}"
        )
    raise unknown("scenario", name, list_experiments())


def find_preset(name: str, drive: str = "") -> ScenarioFile:
    """The plant preset of that name, one of `list_presets`; the version for this drive where there is one."""
    folder = experiments_folder() / "presets"
    own = folder / drive / f"{name}.yaml"
    return read_scenario(own if drive and own.is_file() else folder / f"{name}.yaml", name)


def read_scenario(path: Path, name: str) -> ScenarioFile:
    """Read one scenario file.

    Raises:
        BadInputError: the file cannot be read or is not a YAML mapping.
    """
    try:
        text = yaml_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise BadInputError(f"cannot read scenario file {str(path)!r}: {reason}") from None
    return ScenarioFile(name, path.name, scenario_tree(parse(text, path.name), path.name), path.parent)


def scenario_tree(tree: Any, origin: str) -> Tagged:
    """The root of a scenario, without keys that begin with an underscore (anchors, templates), as in Drake."""
    if not isinstance(tree, Tagged) or tree.tag is not None:
        kind = "a tagged mapping" if isinstance(tree, Tagged) else f"a {type(tree).__name__}"
        wanted = "must be a mapping of scenario keys, such as station, controller, duration"
        raise BadInputError(f"{origin} is {'empty' if tree is None else kind}: {wanted}")
    root = Tagged({k: v for k, v in tree.items() if not str(k).startswith("_")})
    root.lines = tree.lines
    return root


def list_models() -> dict[str, list[str]]:
    """Shipped robots and tools, by the scenario key that names them."""
    return {"station.robot": list_robots(), "station.tool": list_tools()}
