"""Adaptive force control: any law with a `compliance` input, fed by the EWRLS estimate of the contact."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.law import ForceLaw, LawConfig
from forcectl.force.sensor_lag import sensor_model
from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import export_all_outputs
from forcectl.plant.plant_model import PlantModel


class AdaptiveForceLaw(Diagram):
    """A force law whose compliance comes from the EWRLS estimator.

    ```
    name: AdaptiveForceLaw
    input_ports: [desired_force, measured_force, motor_displacement]
    output_ports: [displacement_command, invariance_function (optional), status (optional), environment_compliance]
    ```

    desired_force, measured_force: shape (n,) [N].
    motor_displacement: shape (n,), actual motor-side dx along n [m], unfiltered: the block filters it like the force.
    displacement_command: shape (n,) [m]. invariance_function, status: shape (n,) [m, 1]; of laws that have them.
    environment_compliance: shape (n,), C_E_hat [m/N]. State.
    All outputs are feedthrough of desired_force and measured_force at the tick.

    Sampling: every `period` [s]; no delay beyond that of the law, whose compliance is one tick old.

    Args:
        law: a `ForceLaw` or diagram of one, with the ports of the force law's slot and the input `compliance`.
        estimator: of the compliance.
        displacement_filter: of the displacement, that of the force.

    Raises:
        BadInputError: the law has no such input.
    """

    def __init__(self, law: ForceLaw | Diagram, estimator: EnvironmentComplianceEstimator, displacement_filter: System):
        super().__init__()
        if not law.HasInputPort("compliance"):
            raise BadInputError(f"{type(law).__name__} has no input port 'compliance': an adaptive law must have one")
        self.sample_delay = dict(getattr(law, "sample_delay", {}))
        builder = DiagramBuilder()
        builder.AddNamedSystem("law", law)
        builder.AddNamedSystem("estimator", estimator)
        builder.AddNamedSystem("displacement_filter", displacement_filter)
        builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
        measured = builder.ExportInput(law.GetInputPort("measured_force"), "measured_force")
        builder.ConnectInput(measured, estimator.GetInputPort("measured_force"))
        builder.ExportInput(displacement_filter.get_input_port(), "motor_displacement")
        builder.Connect(displacement_filter.get_output_port(), estimator.GetInputPort("displacement"))
        builder.Connect(estimator.GetOutputPort("compliance"), law.GetInputPort("compliance"))
        export_all_outputs(builder, law)
        builder.ExportOutput(estimator.GetOutputPort("environment_compliance"), "environment_compliance")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class Adaptation(Config):
    """The estimator and what it starts from."""

    compliance_error: float = key(
        0.8, "initial C_E_hat / C_E; 1/1.2 = stiffness 20 % too high", bounds="positive", each=True
    )
    forgetting: float = key(0.995, "forgetting factor mu", bounds="above 0 and at most 1", each=True)
    initial_covariance: float = key(1e-6, "initial covariance P_0", unit="1/N^2", bounds="positive", each=True)
    minimum_force: float = key(0.2, "force below which nothing is learnt", unit="N", bounds="not negative", each=True)

    def estimator(self, model: PlantModel) -> EnvironmentComplianceEstimator:
        """The estimator, starting from `compliance_error` times the true environment compliance."""
        return EnvironmentComplianceEstimator(
            model.size,
            initial_compliance=self.compliance_error * model.environment_compliance,
            initial_covariance=self.initial_covariance,
            forgetting=self.forgetting,
            robot_compliance=model.robot_compliance - model.drive_compliance,
            drive_compliance=model.drive_compliance,
            minimum_force=self.minimum_force,
            period=model.period,
        )


@dataclass(kw_only=True)
class AdaptiveLawConfig(Adaptation, LawConfig):
    """Base of the configurations of adaptive laws."""

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> AdaptiveForceLaw:
        """Add the law with its estimator."""
        law = AdaptiveForceLaw(self.law(model, None), self.estimator(model), sensor_model(model, model.size))
        return builder.AddNamedSystem("force_law", law)
