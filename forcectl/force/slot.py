"""The slot `controller`: ports of the systems that can fill it.

ForceLaw (for k force loops at once)::

    in   desired_force, measured_force: shape (k,) [N]
         motor_displacement, path_displacement: shape (k,) [m], optional
         sliding: shape (k,), 1 while the tool moves along its path [1], optional
    out  displacement_command: shape (k,) [m]; any further outputs are diagnostics
         displacement_velocity_command: shape (k,) [m/s], its velocity, optional

Controller of joints::

    in   any signals of `forcectl.conventions` except true values of the simulation
    out  joint_position_command: shape (n,) [rad]
         joint_velocity_command: shape (n,) [rad/s], joint_torque_feedforward: shape (n,) [Nm], optional
         any further outputs are diagnostics

A configuration of such a controller that also has `add_approached(builder, model)` can be the law of `!Approach`. That
method adds the controller with further ports::

    in   desired_force, measured_force: shape (1,) [N], zero outside of contact
         approach_displacement: shape (1,), x_a of the guarded move along the normal, to be added to the command [m]
    out  approach_displacement: shape (1,), the part of it in the command, within walls and joint limits [m]

The kinematic inversion makes a controller of joints from a force law. Everything runs every `model.period` from t = 0.
Let outputs be feedthrough at the tick and held, as `SampledBlock` does: the robot then uses the command of a tick in
that tick. An output that is a state reaches the robot one tick later.

A configuration of a force law may have `sampled_response(model)`, the law as a linear system in one force loop: then
`forcectl check` reports the stability margins, see `forcectl.force.chain`. With `must_be_stable` it is refused where
the sampled loop is unstable, and must have the attributes `inertia` and `damping`. A law inside another configuration
is found if that has `force_laws(model)`, which returns pairs of a law and its share of the contact's stiffness, from 0
to 1. Each pair is a loop of its own; laws that act on one normal at the same time are one law, see
`forcectl.force.combined`.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from pydrake.systems.framework import DiagramBuilder, System

from forcectl.plant.plant_model import PlantModel


@runtime_checkable
class ControllerConfig(Protocol):
    """Configuration of a force law or a controller of joints, forcectl's or a user's own."""

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """Add the blocks to a builder, and return the one with the ports above."""
        ...
