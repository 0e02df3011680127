"""Force control that re-tunes itself while it regulates: EWRLS-VRFT, for surfaces of several materials (Sec. 4.5).

The gains are adapted only while the force changes, because data at rest do not determine K_P, and never at a force so
low that contact may be lost. They stay within a range about the initial gains. When they change, the slope of the
command changes, and the command does not jump.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder

from forcectl.estimation.recursive_vrft import GAINS, RecursiveVrft
from forcectl.force.linear_law import LinearForceLaw, VrftConfig
from forcectl.force.vrft.motor_side import MotorSideRecord
from forcectl.framework.fields import key
from forcectl.framework.wiring import Around, export_all_outputs
from forcectl.plant.plant_model import PlantModel


def add_tuned_law(
    builder: DiagramBuilder, law: LinearForceLaw, tuner: RecursiveVrft, motor_side: MotorSideRecord | None = None
) -> None:
    """Add a law as `law` and the tuner of its gains as `tuner`, connect them, and export the ports of both.

    Args:
        builder: to add to.
        law: with input ports for its gains.
        tuner: of these gains.
        motor_side: source of the tuner's data; None: the command of the law and the measured force.
    """
    builder.AddNamedSystem("law", law)
    builder.AddNamedSystem("tuner", tuner)
    builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
    measured = builder.ExportInput(law.GetInputPort("measured_force"), "measured_force")
    if motor_side is None:
        builder.Connect(law.GetOutputPort("controller_output"), tuner.GetInputPort("controller_output"))
        builder.ConnectInput(measured, tuner.GetInputPort("measured_force"))
    else:
        builder.AddNamedSystem("motor_side", motor_side)
        builder.ConnectInput(measured, motor_side.GetInputPort("measured_force"))
        builder.ExportInput(motor_side.GetInputPort("motor_displacement"), "motor_displacement")
        builder.Connect(motor_side.GetOutputPort("input"), tuner.GetInputPort("controller_output"))
        builder.Connect(motor_side.GetOutputPort("output"), tuner.GetInputPort("measured_force"))
    for name in GAINS:
        builder.Connect(tuner.GetOutputPort(name), law.GetInputPort(name))
    for block in (law, tuner):
        export_all_outputs(builder, block)


class AdaptiveVrft(Around):
    """A force law whose gains are tuned by recursive VRFT while it regulates.

    ```
    name: AdaptiveVrft
    input_ports: [desired_force, measured_force]
    output_ports: [displacement_command, controller_output, proportional_gain, integral_gain, derivative_gain]
    ```

    desired_force, measured_force: shape (n,) [N]. displacement_command: shape (n,) [m].
    controller_output: shape (n,), u_hat [m].
    proportional_gain, integral_gain, derivative_gain: shape (n,) [m/N, m/(N s), m s/N]. State.
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command; gains are one tick old.

    Args:
        law: with input ports for its gains.
        tuner: made with `always=True`.
    """

    def __init__(self, law: LinearForceLaw, tuner: RecursiveVrft):
        super().__init__(law)
        builder = DiagramBuilder()
        add_tuned_law(builder, law, tuner)
        builder.BuildInto(self)


@dataclass(kw_only=True)
class AdaptiveVrftConfig(VrftConfig, in_batches=True):
    """Scenario part `!AdaptiveVrft`: a law tuned by VRFT whose gains are re-tuned while it regulates.

    It starts with the gains of `!Vrft`.
    """

    forgetting: float = key(
        0.995, "forgetting factor per sample of the tuning; 1: nothing is forgotten", bounds="from 0.9 to 1", each=True
    )
    initial_covariance: float = key(
        1e-9,
        "initial covariance P_0 of the gains, also its upper bound: how far they may change at first",
        bounds="positive",
        each=True,
    )
    minimum_force: float = key(
        8.0, "measured force below which the gains are not adapted", unit="N", bounds="not negative", each=True
    )
    minimum_rate: float = key(
        1.0,
        "rate of the measured force below which gains are not adapted",
        unit="N/s",
        bounds="not negative",
        each=True,
    )
    gain_range: float = key(
        10.0, "largest factor between K_P or K_I and its initial value, either way", bounds="at least 1", each=True
    )
    data_resolution: float = key(
        0.0039,
        "resolution to which the measured force is rounded for the tuning; 0: no rounding",
        unit="N",
        bounds="not negative",
        each=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_tunable("set the permitted range of the gains", "tuned")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> AdaptiveVrft:
        """Add the law with its tuner."""
        tuner = RecursiveVrft(
            model.size,
            bandwidth=self.reference_bandwidth,
            forgetting=self.forgetting,
            resolution=self.data_resolution,
            minimum_force=self.minimum_force,
            minimum_rate=self.minimum_rate,
            gain_range=self.gain_range,
            initial_gains=(self.proportional_gain, self.integral_gain, self.derivative_gain),
            initial_covariance=self.initial_covariance,
            prefilter=False,
            always=True,
            period=model.period,
        )
        return builder.AddNamedSystem("force_law", AdaptiveVrft(self.law(model, gains_from_ports=True), tuner))
