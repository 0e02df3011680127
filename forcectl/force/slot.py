"""The slot of a controller: what fills it.

ForceLaw (for k force loops at once)::

    in   desired_force, measured_force: shape (k,) [N]
         motor_displacement, path_displacement: shape (k,) [m], optional
         sliding: shape (k,), 1 while the tool moves along its path [1], optional
    out  displacement_command: shape (k,) [m]; any further outputs are diagnostics
         displacement_velocity_command: shape (k,) [m/s], its speed, optional

Controller of joints::

    in   any signals of `forcectl.conventions` that are no truth
    out  joint_position_command: shape (n,) [rad]
         joint_velocity_command: shape (n,) [rad/s], joint_torque_feedforward: shape (n,) [Nm], optional
         any further outputs are diagnostics

A configuration of such a controller that also has `add_approached(builder, model)` can stand behind `!Approach`: that
adds the controller with further ports::

    in   desired_force, measured_force: shape (1,) [N], zero outside of contact
         approach_displacement: shape (1,), x_a of the guarded move along the normal, to be added to the command [m]
    out  approach_displacement: shape (1,), what of it the command holds, within walls and joint limits [m]

A force law is made a controller of joints by the kinematic inversion. Everything runs every `model.period` from t = 0.
Let outputs be feedthrough at the tick and held, as `SampledBlock` does: the robot then takes the command of a tick in
that tick; what is a state of the filler it takes one tick later.

Of a configuration of a force law with `sampled_response(model)`, the law as a linear system in one force loop,
`forcectl check` tells the stability margins, see `forcectl.force.chain`; with `must_be_stable` it is refused where the
sampled loop is unstable, and has the attributes `inertia` and `damping`. It is also found within others that say what
is in them: their `force_laws(model)` returns pairs of a law and its share of the contact's stiffness, from 0 to 1.
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
