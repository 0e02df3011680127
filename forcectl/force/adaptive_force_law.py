"""Adaptive force control: any law with a `compliance` input, fed by the EWRLS estimate of the contact's compliance.

A law that computes its command from the compliance alone also needs the height of a surface that the tool slides over,
see `forcectl.estimation.surface_offset`.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import Adder

from forcectl.errors import BadInputError
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.estimation.surface_offset import SurfaceOffset
from forcectl.force.law import ForceLaw, LawConfig
from forcectl.force.sensor_lag import sensor_model
from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import Around, export_all_outputs
from forcectl.plant.plant_model import PlantModel


class AdaptiveForceLaw(Around):
    """A force law whose compliance comes from the EWRLS estimator.

    ```
    name: AdaptiveForceLaw
    input_ports: [desired_force, measured_force, motor_displacement, path_displacement (optional), sliding (optional)]
    output_ports: [displacement_command, invariance_function (optional), status (optional), surface_offset (optional),
    environment_compliance]
    ```

    desired_force, measured_force: shape (n,) [N].
    motor_displacement: shape (n,), actual motor-side dx along n [m], unfiltered: the block filters it like the force.
    path_displacement, sliding: shape (n,), see `SurfaceOffset`, unfiltered [m, 1]; both ports exist with an `offset`.
    displacement_command: shape (n,) [m]. Feedthrough of desired_force and measured_force at the tick. Feedthrough of
    sliding, motor_displacement and path_displacement when there is an `offset`.
    invariance_function, status: shape (n,) [m, 1]; of laws that have them. Feedthrough of desired_force and
    measured_force at the tick.
    surface_offset: shape (n,), s [m]; with an `offset`. Feedthrough of measured_force and sliding at the tick.
    Feedthrough of motor_displacement and path_displacement when the sensor has no delay.
    environment_compliance: shape (n,), C_E_hat [m/N]. State.

    Sampling: every `period` [s]; no delay beyond that of the law, whose compliance is one tick old.

    Args:
        law: a `ForceLaw` or diagram of one, with the ports of the force law's slot and the input `compliance`.
        estimator: of the compliance.
        displacement_filter: of the motor displacement, equal to the filter of the force sensor.
        offset: estimator of the surface's height, and a filter for the displacement of the path; None: constant height.

    Raises:
        BadInputError: the law has no such input.
    """

    def __init__(
        self,
        law: ForceLaw | Diagram,
        estimator: EnvironmentComplianceEstimator,
        displacement_filter: System,
        offset: tuple[SurfaceOffset, System] | None = None,
    ):
        super().__init__(law)
        if not law.HasInputPort("compliance"):
            raise BadInputError(f"{type(law).__name__} has no input port 'compliance': an adaptive law must have one")
        builder = DiagramBuilder()
        builder.AddNamedSystem("law", law)
        builder.AddNamedSystem("estimator", estimator)
        builder.AddNamedSystem("displacement_filter", displacement_filter)
        builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
        measured = builder.ExportInput(law.GetInputPort("measured_force"), "measured_force")
        builder.ConnectInput(measured, estimator.GetInputPort("measured_force"))
        builder.ExportInput(displacement_filter.get_input_port(), "motor_displacement")
        builder.Connect(estimator.GetOutputPort("compliance"), law.GetInputPort("compliance"))
        if offset is None:
            builder.Connect(displacement_filter.get_output_port(), estimator.GetInputPort("displacement"))
            export_all_outputs(builder, law)
        else:
            surface, path_filter = offset
            builder.AddNamedSystem("surface_offset", surface)
            builder.AddNamedSystem("path_filter", path_filter)
            command = builder.AddNamedSystem("command", Adder(2, surface.size))
            builder.ConnectInput(measured, surface.GetInputPort("measured_force"))
            builder.ExportInput(path_filter.get_input_port(), "path_displacement")
            builder.ExportInput(surface.GetInputPort("sliding"), "sliding")
            builder.Connect(displacement_filter.get_output_port(), surface.GetInputPort("displacement"))
            builder.Connect(path_filter.get_output_port(), surface.GetInputPort("path_displacement"))
            builder.Connect(estimator.GetOutputPort("compliance"), surface.GetInputPort("compliance"))
            explained = surface.GetOutputPort("explained_displacement")
            builder.Connect(explained, estimator.GetInputPort("displacement"))
            builder.Connect(law.GetOutputPort("displacement_command"), command.get_input_port(0))
            builder.Connect(surface.GetOutputPort("surface_offset"), command.get_input_port(1))
            builder.ExportOutput(command.get_output_port(), "displacement_command")
            export_all_outputs(builder, law, but=["displacement_command"])
            builder.ExportOutput(surface.GetOutputPort("surface_offset"), "surface_offset")
        builder.ExportOutput(estimator.GetOutputPort("environment_compliance"), "environment_compliance")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class Adaptation(Config):
    """The EWRLS estimator of the environment compliance, and its initial values."""

    compliance_error: float = key(
        0.8,
        "initial estimate of the environment compliance relative to the true one, C_E_hat / C_E; 1/1.2: stiffness 20 % "
        "too high",
        bounds="from 0.001 to 1000",
        each=True,
    )
    forgetting: float = key(
        0.995, "forgetting factor mu of the compliance estimator; 1: none", bounds="from 0.1 to 1", each=True
    )
    initial_covariance: float = key(
        1e-6,
        "initial covariance P_0 of the estimated compliance",
        unit="1/N^2",
        bounds="above 0 and at most 1000000",
        each=True,
    )
    minimum_force: float = key(
        0.2,
        "measured force below which the estimate of the compliance is not updated",
        unit="N",
        bounds="not negative",
        each=True,
    )

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

    def offset(self, model: PlantModel) -> tuple[SurfaceOffset, System] | None:
        """The argument `offset` of `AdaptiveForceLaw`; None: the law does not need it."""
        return None

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> AdaptiveForceLaw:
        """Add the law with its estimator."""
        filter_ = sensor_model(model, model.size)
        law = AdaptiveForceLaw(self.law(model, None), self.estimator(model), filter_, self.offset(model))
        return builder.AddNamedSystem("force_law", law)


@dataclass(kw_only=True)
class AdaptivePlanConfig(AdaptiveLawConfig):
    """Base of the configurations of adaptive laws that compute their command from the compliance."""

    surface: str = key(
        "height",
        "quantity assumed to change while the tool slides: height of the surface, or its compliance alone as in (3.56)",
        choices=("height", "compliance"),
    )

    def offset(self, model: PlantModel) -> tuple[SurfaceOffset, System] | None:
        """The offset, unless only the compliance is assumed to change."""
        if self.surface == "compliance":
            return None
        block = SurfaceOffset(
            model.size, drive_compliance=model.drive_compliance, lag=model.sensor_lag, period=model.period
        )
        return block, sensor_model(model, model.size)
