"""A station like those of the manipulation world: an arm in a MultibodyPlant with geometry, held by inverse dynamics.

Nothing of it is ours. The ports imitate those of an arm's driver: `arm.position` in, `arm.position_measured` out.
"""

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.controllers import InverseDynamicsController
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, StateInterpolatorWithDiscreteDerivative

LINK = """
<link name="link{0}">
  <inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.05 0.05"/></geometry></collision>
</link>
<joint name="joint{0}" type="revolute"><parent link="{1}"/><child link="link{0}"/><origin xyz="{2} 0 0"/>
  <axis xyz="0 1 0"/><limit effort="100" velocity="10" lower="-3" upper="3"/></joint>
<transmission name="drive{0}"><type>transmission_interface/SimpleTransmission</type>
  <joint name="joint{0}"/><actuator name="motor{0}"/></transmission>
"""
URDF = f'<robot name="arm">{LINK.format(1, "world", 0)}{LINK.format(2, "link1", 0.4)}</robot>'.replace(
    '<robot name="arm">', '<robot name="arm"><link name="world"/>'
)


def station(time_step=0.002, kp=100.0):
    """The station as one diagram, in another one with nothing else."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step)
    Parser(plant).AddModelsFromString(URDF, "urdf")
    plant.Finalize()
    plant.set_name("plant")
    model = MultibodyPlant(0.0)
    Parser(model).AddModelsFromString(URDF, "urdf")
    model.Finalize()
    gains = [np.full(2, each) for each in (kp, 1.0, 2 * kp**0.5)]
    controller = builder.AddNamedSystem("controller", InverseDynamicsController(model, *gains, False))
    desired = builder.AddNamedSystem("desired", StateInterpolatorWithDiscreteDerivative(2, time_step, True))
    measured = builder.AddNamedSystem("measured", Demultiplexer([2, 2]))
    builder.Connect(desired.get_output_port(), controller.get_input_port_desired_state())
    builder.Connect(plant.get_state_output_port(), controller.get_input_port_estimated_state())
    builder.Connect(controller.get_output_port_control(), plant.get_actuation_input_port())
    builder.Connect(plant.get_state_output_port(), measured.get_input_port())
    builder.ExportInput(desired.get_input_port(), "arm.position")
    builder.ExportOutput(measured.get_output_port(0), "arm.position_measured")
    inner = builder.Build()
    inner.set_name("station")
    outer = DiagramBuilder()
    outer.AddSystem(inner)
    outer.ExportInput(inner.get_input_port(), "arm.position")
    outer.ExportOutput(inner.get_output_port(), "arm.position_measured")
    return outer.Build()
