"""VRFT gains that follow the compliance of the environment, for surfaces of several materials (Sec. 4.5).

    K_I = -w_c C_E,    K_P = -w_c T (C_R_hat + C_E),    K_D/K_P as it is                       (equations 3.2; 4.1, 4.2)

are the gains that VRFT finds on any material; T is the lag of the loop, the same on all of them. So only C_E has to be
estimated. C_E of one material and T follow from w_c and the gains that VRFT has found on that material. When the gains
change, the slope of the command changes, and the command does not jump.
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
    """A force law whose gains follow the compliance of the environment, which is estimated while it regulates.

    ```
    name: ScaledVrft
    input_ports: [desired_force, measured_force, motor_displacement]
    output_ports: [displacement_command, controller_output, environment_compliance, learning, proportional_gain,
    integral_gain, derivative_gain]
    ```

    desired_force, measured_force: shape (n,) [N].
    motor_displacement: shape (n,), actual motor-side dx along n [m], unfiltered: the block filters it like the force.
    displacement_command: shape (n,) [m]. controller_output: shape (n,), u_hat [m].
    environment_compliance: shape (n,), C_E_hat [m/N]. State. learning: shape (n,), 1 while samples are used [1]. State.
    proportional_gain, integral_gain, derivative_gain: shape (n,) [m/N, m/(N s), m s/N]. State.
    All outputs are feedthrough of desired_force and measured_force at the tick.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, gains are one tick old.

    Args:
        law: with input ports for its gains.
        estimator: of the environment's compliance.
        displacement_filter: filter of the displacement, the same as that of the force.
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

    It starts with the gains of `!Vrft`. The keys of the estimate are parameters of `ExcitedCompliance`.
    """

    drift_bandwidth: float = key(
        3.0,
        "cut-off w_h of the high-pass that removes slow changes of surface height and robot compliance",
        unit="rad/s",
        bounds="positive",
    )
    surface_deviation: float = key(
        1e-5,
        "standard deviation of the displacement by the surface within 1/w_h; larger: slower adaptation",
        unit="m",
        bounds="positive",
    )
    memory: float = key(
        3.0,
        "time constant T with which the covariance of the compliance estimate returns to its initial value",
        unit="s",
        bounds="positive",
    )
    minimum_excitation: float = key(
        0.2,
        "high-pass filtered response of the reference model below which the compliance is not adapted",
        unit="N",
        bounds="not negative",
    )
    minimum_force: float = key(
        2.0, "measured force below which the compliance is not adapted", unit="N", bounds="not negative"
    )
    gain_range: float = key(
        10.0, "largest factor between the estimated C_E and its initial value, either way", bounds="at least 1"
    )
    gain_rate: float = key(3.0, "largest relative rate of change of the estimated C_E", unit="1/s", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_tunable("give the compliance and the lag", "scaled")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> ScaledVrft:
        """Add the law with its estimator."""
        robot, w = self.robot_compliance_error * model.robot_compliance, self.reference_bandwidth
        first = -self.integral_gain / w
        # Slopes over C_E with which the given K_P and K_D result at the initial C_E.
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
