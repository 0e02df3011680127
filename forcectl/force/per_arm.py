"""Scenario part `!PerArm`: a separate force law for each arm that presses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Demultiplexer

from forcectl.conventions import Components, unit_of
from forcectl.errors import about, invalid
from forcectl.force.law import FORCES, require_force_law
from forcectl.framework.block import PythonDiagram, of_ports
from forcectl.framework.fields import Config, slot
from forcectl.framework.wiring import Enclosed, input_names, optional_inputs, output_names, stacked
from forcectl.plant.plant_model import PlantModel

_INPUTS = (*FORCES, "motor_displacement", "path_displacement", "sliding")


@dataclass(kw_only=True)
class PerArmConfig(Config):
    """Scenario part `!PerArm`: force laws by the name of the arm that presses."""

    laws: dict[str, Any] = slot("controller", dict, meaning="force law of each arm that presses, by the arm's name")

    def force_laws(self, model: PlantModel) -> list[tuple[Any, float]]:
        """The laws of the arms that press, each with the share 1; see `forcectl.force.slot`."""
        return [(law, 1.0) for arm, law in self.laws.items() if arm in model.arms]

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> PerArm:
        """Add the laws.

        Raises:
            BadInputError: there is not exactly one law for each arm that presses.
        """
        if sorted(self.laws) != sorted(model.arms):
            raise invalid("laws", sorted(self.laws), f"one for each arm that presses: {', '.join(model.arms)}")
        return builder.AddNamedSystem("force_laws", PerArm(self.laws, model))


class PerArm(PythonDiagram):
    """Force laws of several arms side by side.

    ```
    name: PerArm
    input_ports: [desired_force, measured_force, motor_displacement (optional), path_displacement (optional),
    sliding (optional), (further inputs of the laws)]
    output_ports: [displacement_command, (further outputs of the laws)]
    ```

    desired_force, measured_force: shape (k,) [N]. motor_displacement, path_displacement, sliding: shape (k,) [m, m, 1];
    the ports exist where a law has them.
    displacement_command: shape (k,) [m]. Feedthrough of desired_force and measured_force at the tick. Feedthrough of
    motor_displacement when a law predicts.
    Further outputs of a law have the name of its arm as a prefix, such as left_environment_compliance. All outputs are
    feedthrough of desired_force, measured_force and motor_displacement when those of the laws are.

    Sampling: every `period` [s] of the laws; no delay beyond that of the laws.

    Args:
        laws: configurations of force laws, by arm.
        model: of the plant, with k loops.

    Raises:
        BadInputError: one of them is no force law.
    """

    def __init__(self, laws: dict[str, Any], model: PlantModel):
        super().__init__()
        builder = DiagramBuilder()
        k = model.size
        added: list[System] = []
        for i, arm in enumerate(model.arms):
            inner = DiagramBuilder()
            with about(laws[arm]):
                law = laws[arm].add_to(inner, model.loop(i))
                require_force_law(law, FORCES)
            added.append(builder.AddNamedSystem(arm, Enclosed(inner, law)))
        for name in _INPUTS:
            numbered = [(i, law) for i, law in enumerate(added) if law.HasInputPort(name)]
            if numbered:
                each = builder.AddNamedSystem(name, Demultiplexer([1] * k))
                builder.ExportInput(each.get_input_port(), name)
                for i, law in numbered:
                    builder.Connect(each.get_output_port(i), law.GetInputPort(name))
        self.optional_inputs: list[str] = []
        for name in dict.fromkeys(name for law in added for name in input_names(law) if name not in _INPUTS):
            users = [law for law in added if law.HasInputPort(name)]
            whole = builder.ExportInput(users[0].GetInputPort(name), name)
            for law in users[1:]:
                builder.ConnectInput(whole, law.GetInputPort(name))
            if all(name in optional_inputs(law) for law in users):
                self.optional_inputs.append(name)
        commands = [law.GetOutputPort("displacement_command") for law in added]
        builder.ExportOutput(stacked(builder, "displacement_commands", commands), "displacement_command")
        self.port_units: dict[str, str] = {}
        self.port_components: dict[str, str | Components] = {}
        for arm, law in zip(model.arms, added, strict=True):
            units, components = (of_ports(law, f"port_{what}") for what in ("units", "components"))
            for name in output_names(law):
                if name != "displacement_command":
                    builder.ExportOutput(law.GetOutputPort(name), f"{arm}_{name}")
                    self.port_units[f"{arm}_{name}"] = unit_of(name, units)
                    if name in components:
                        self.port_components[f"{arm}_{name}"] = components[name]
        builder.BuildInto(self)
