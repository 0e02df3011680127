"""Station configurations for tests, written short."""

from collections.abc import Mapping
from typing import Any

from forcectl.diagrams.drives.joint_interface import JointFrictionConfig, JointInterfaceConfig, JointServoConfig
from forcectl.diagrams.drives.position_drive import PositionDriveConfig
from forcectl.diagrams.model import Setting, plant_model
from forcectl.diagrams.sensors import JointReadingsConfig
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import Workcell
from forcectl.motion.joint_dither import JointDitherConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from forcectl.scenario.catalog import find_preset


def pressing(**options: Any) -> StationConfig:
    """A station whose tool presses on a surface.

    Args:
        options: keys of the station; `servo` and `position_loop` are those of its drive, `force_sensor` is its sensor.
    """
    drive = {name: options.pop(name) for name in ("servo", "position_loop") if name in options}
    if drive:
        options["drive"] = PositionDriveConfig(**drive)
    if "force_sensor" in options:
        options["sensors"] = {"force": options.pop("force_sensor")}
    return StationConfig(**options)


def free(**options: Any) -> StationConfig:
    """A robot behind its joint interface in free space or among boxes, with what the preset `ideal` says of it.

    Args:
        options: keys of the station; `servo`, `friction` and `dither` are those of its drive, `sensors` are its joint
            readings, each as a mapping or a configuration, and `obstacles` is a list of boxes.
    """
    ideal = find_preset("ideal", "JointInterface").tree["station"]
    readings = options.pop("sensors", {})
    if isinstance(readings, Mapping):
        readings = JointReadingsConfig(**{**ideal["sensors"]["joints"], **readings})
    kinds = {"servo": JointServoConfig, "friction": JointFrictionConfig, "dither": JointDitherConfig}
    drive = JointInterfaceConfig(**{name: _made(kind, options.pop(name, {})) for name, kind in kinds.items()})
    boxes = {f"box_{i + 1}": box for i, box in enumerate(options.pop("obstacles", []))}
    known = {"robot": "yumi", "tool": "yumi_gripper", "fidelity": "Multibody", "drive": drive}
    parts = {"sensors": {"joints": readings}, "environment": EnvironmentPartsConfig(parts=boxes)}
    return StationConfig(**{**ideal, **known, **parts, **options})


def _made(kind: type, given: Any) -> Any:
    return kind(**given) if isinstance(given, Mapping) else given


def setting(workcell: Workcell) -> Setting:
    """Of a run whose model agrees with the plant."""
    return Setting(workcell, plant_model(workcell), plant_model(workcell))
