"""Estimator of a scenario: the momentum observer (5.6)* and a wrench estimate per arm, (5.8) or a Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Multiplexer, TrajectorySource

from forcectl.conventions import unit_of
from forcectl.errors import BadInputError
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.wrench import WrenchEstimator
from forcectl.estimation.wrench_between_filter import WrenchBetweenFilter
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import export_outputs

READINGS = ("joint_position", "joint_velocity", "motor_torque")
_COMPONENTS = {"wrench_deviation": "6a", "joint_bias": "n", "moving": "n", "wrench_between": "6"}


class ForceEstimator(PythonDiagram):
    """External joint torques and the wrench at each TCP.

    ```
    name: ForceEstimator
    input_ports: [joint_position, joint_velocity, motor_torque, tare (optional)]
    output_ports: [estimated_torque, estimated_wrench (optional), estimated_local_wrench (optional), near_singular
    (optional), wrench_deviation (optional), joint_bias (optional), moving (optional), torque_elsewhere (optional),
    wrench_between (optional), residual, torque_balance, balance_ok]
    ```

    joint_position, joint_velocity, motor_torque: shape (n,), readings of the tick [rad, rad/s, Nm].
    estimated_torque: shape (n,), external joint torques beyond the friction threshold, else zero [Nm].
    estimated_wrench: shape (6a,), of the environment on the robot at each TCP in the world, [torque; force] [Nm, N].
    estimated_local_wrench: shape (6a,), the same in the axes of other frames [Nm, N]; with `local` the port exists
    instead of estimated_wrench.
    tare: shape (1,) [1], may be left unconnected; the port exists where no `tare` is given. See the wrench estimates.
    residual: shape (n,), r [Nm]. torque_balance: shape (n,), of the tick, see `MomentumObserver` [Nm].
    balance_ok: shape (n,) [1].
    near_singular: shape (a,), 1 where a direction is damped [1]; of a `WrenchEstimator`.
    wrench_deviation: shape (6a,), in the axes of each TCP [Nm, N]; joint_bias: shape (n,) [Nm]; moving: shape (n,) [1];
    torque_elsewhere: shape (a,) [Nm]; of a `WrenchFilter`, joints arm by arm.
    wrench_between: shape (6,), of one arm on another at the TCP of that [Nm, N]; of a `WrenchBetweenFilter`.
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s]; no delay. With filtered speeds the estimate has their lag.

    Args:
        observer: of the n joints.
        wrenches: by arm, at least one, all of the same n joints, of one class and with the period of the observer.
        tare: source of the input `tare` of the wrench estimates; None: `tare` is an input of the diagram.
        between: filter of two of the arms, of the same n joints and with the period of the observer; None: none.
        local: whether the wrenches are expressed in other frames than the world.
    """

    def __init__(
        self,
        observer: MomentumObserver,
        wrenches: Mapping[str, WrenchEstimator] | Mapping[str, WrenchFilter],
        tare: TrajectorySource | None = None,
        between: WrenchBetweenFilter | None = None,
        *,
        local: bool = False,
    ):
        super().__init__()
        if not wrenches:
            raise BadInputError("wrenches: must have at least one arm; a MomentumObserver alone has the joint torques")
        name_of_wrench = "estimated_local_wrench" if local else "estimated_wrench"
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        add("observer", observer)
        for name in READINGS:
            builder.ExportInput(observer.GetInputPort(name), name)
        if tare is not None:
            add("tare", tare)
        self.optional_inputs = ("tare",) if tare is None else ()
        untared = []
        every: dict[str, Any] = {f"wrench_{arm}": wrench for arm, wrench in wrenches.items()}
        if between is not None:
            every["wrench_between"] = between
        for name_of_part, wrench in every.items():
            add(name_of_part, wrench)
            for port in map(wrench.get_input_port, range(wrench.num_input_ports())):
                name = port.get_name()
                if name in READINGS:
                    builder.ConnectInput(name, port)
                elif name != "tare":
                    connect(observer.GetOutputPort(name), port)
                elif tare is not None:
                    connect(tare.get_output_port(), port)
                else:
                    untared.append(port)
        if untared:
            builder.ExportInput(untared[0], "tare")
            for port in untared[1:]:
                builder.ConnectInput("tare", port)
        outputs = {"estimated_torque": observer.GetOutputPort("external_torque")}
        self.port_units: dict[str, str] = {}
        self.port_components = dict(_COMPONENTS)
        if len(wrenches) > 1:
            self.port_components |= dict.fromkeys(("near_singular", "torque_elsewhere"), "a")
        first = next(iter(wrenches.values()))
        for port in map(first.get_output_port, range(first.num_output_ports())):
            parts = [wrench.GetOutputPort(port.get_name()) for wrench in wrenches.values()]
            name = name_of_wrench if port.get_name() == "wrench" else port.get_name()
            together = add(name, Multiplexer([part.size() for part in parts]))
            for i, part in enumerate(parts):
                connect(part, together.get_input_port(i))
            outputs[name] = together.get_output_port()
            self.port_units[name] = unit_of(port.get_name(), first.port_units)
        if between is not None:
            outputs["wrench_between"] = between.GetOutputPort("wrench")
            self.port_units["wrench_between"] = unit_of("wrench")
        outputs |= {name: observer.GetOutputPort(name) for name in ("residual", "torque_balance", "balance_ok")}
        export_outputs(builder, outputs)
        builder.BuildInto(self)
