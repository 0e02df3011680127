"""VRFT gains that follow the compliance of the environment, for surfaces of several materials (Sec. 4.5).

    K_I = -w_c C_E,    K_P = -w_c T (C_R_hat + C_E),    K_D/K_P as it is                       (equations 3.2; 4.1, 4.2)

is what VRFT finds on any material: T is the lag of the loop, the same on all of them. So only C_E has to be estimated.
w_c and the gains that VRFT has found on one material tell its C_E and T. New gains make the command bend, not jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.arrays import Array
from forcectl.estimation.excited_compliance import ExcitedCompliance
from forcectl.force.law import FORCES
from forcectl.force.linear_law import GAINS, LinearForceLaw, VrftConfig
from forcectl.force.sensor_lag import sensor_model
from forcectl.framework.fields import key
from forcectl.framework.wiring import Around, affine, export_all_outputs, split, through
from forcectl.plant.plant_model import PlantModel


class ScaledVrft(Around):
    """A force law with gains in proportion to the compliance that is estimated meanwhile.

    ```
    name: ScaledVrft
    input_ports: [desired_force, measured_force, motor_displacement]
    output_ports: [displacement_command, controller_output, environment_compliance, learning, proportional_gain,
    integral_gain, derivative_gain]
    ```

    desired_force, measured_force: shape (n,) [N].
    motor_displacement: shape (n,), actual motor-side dx along n [m], unfiltered: the block filters it like the force.
    displacement_command: shape (n,) [m]. controller_output: shape (n,), u_hat [m].
    environment_compliance: shape (n,), C_E_hat [m/N]. State. learning: shape (n,), 1 while samples count [1]. State.
    proportional_gain, integral_gain, derivative_gain: shape (n,) [m/N, m/(N s), m s/N]. State.
    All outputs are feedthrough of desired_force and measured_force at the tick.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, gains are one tick old.

    Args:
        law: with gains from ports.
        estimator: of the compliance.
        displacement_filter: of the displacement, that of the force.
        slopes: of K_P, K_I and K_D over C_E.
        offsets: their values at C_E = 0; each of shape (3, n).
    """

    def __init__(
        self,
        law: LinearForceLaw,
        estimator: ExcitedCompliance,
        displacement_filter: System,
        slopes: Array,
        offsets: Array,
    ):
        super().__init__(law)
        size = law.size
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        add("law", law)
        add("estimator", estimator)
        add("displacement_filter", displacement_filter)
        slope = np.vstack([np.diag(row) for row in slopes])
        estimate = estimator.GetOutputPort("environment_compliance")
        scaled = through(builder, "gains_of_compliance", affine(slope, offsets.ravel()), estimate)
        gains = split(builder, "gains", [size] * 3, scaled)
        for name in FORCES:
            outer = builder.ExportInput(law.GetInputPort(name), name)
            builder.ConnectInput(outer, estimator.GetInputPort(name))
        builder.ExportInput(displacement_filter.get_input_port(), "motor_displacement")
        connect(displacement_filter.get_output_port(), estimator.GetInputPort("displacement"))
        for block in (law, estimator):
            export_all_outputs(builder, block)
        for name, gain in zip(GAINS, gains, strict=True):
            connect(gain, law.GetInputPort(name))
            builder.ExportOutput(gain, name)
        builder.BuildInto(self)


@dataclass(kw_only=True)
class ScaledVrftConfig(VrftConfig):
    """Scenario part `!ScaledVrft`: a law tuned by VRFT whose gains follow the compliance that is estimated on line.

    It starts with the gains of `!Vrft`; the rest as in `ExcitedCompliance`.
    """

    drift_bandwidth: float = key(
        3.0, "w_h: slower changes of height and compliance of the robot drop out", unit="rad/s", bounds="positive"
    )
    surface_deviation: float = key(
        1e-5, "what the surface adds within 1/w_h; more makes learning slower", unit="m", bounds="positive"
    )
    memory: float = key(3.0, "memory T of the estimate", unit="s", bounds="positive")
    minimum_excitation: float = key(
        0.2, "response of the reference model below which nothing is learnt", unit="N", bounds="not negative"
    )
    minimum_force: float = key(2.0, "force below which nothing is learnt", unit="N", bounds="not negative")
    gain_range: float = key(10.0, "C_E stays within this factor of where it starts", bounds="at least 1")
    gain_rate: float = key(3.0, "largest relative change of C_E", unit="1/s", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_tunable("tell the compliance and the lag", "scaled")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> ScaledVrft:
        """Add the law with its estimator."""
        robot, w = self.robot_compliance_error * model.robot_compliance, self.reference_bandwidth
        first = -self.integral_gain / w
        # Slopes with C_E for the K_P and K_D that are given where C_E is the first.
        lag = self.proportional_gain / (robot + first)
        damping = self.derivative_gain / (robot + first)
        estimator = ExcitedCompliance(
            model.size,
            initial_compliance=first,
            bandwidth=w,
            drift_bandwidth=self.drift_bandwidth,
            robot_compliance=robot,
            surface_deviation=self.surface_deviation,
            memory=self.memory,
            minimum_excitation=self.minimum_excitation,
            minimum_force=self.minimum_force,
            range=self.gain_range,
            rate=self.gain_rate,
            period=model.period,
        )
        law, displacement_filter = self.law(model, gains_from_ports=True), sensor_model(model, model.size)
        slopes = np.array([lag, np.full(model.size, -w), damping])
        offsets = np.array([lag * robot, np.zeros(model.size), damping * robot])
        return builder.AddNamedSystem("force_law", ScaledVrft(law, estimator, displacement_filter, slopes, offsets))
