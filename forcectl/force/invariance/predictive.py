"""Force control on moving, stiff contact: an open-loop law, corrected by estimates of surface height and drive error.

A law such as [57] commands u = -C_T_hat F_bar(t), open loop. Here the estimated height of the surface is added, and the
error that friction leaves in the drive is subtracted, both with the modelled filters of the loop::

    x    = dx_m - h dx_uc              displacement of the motor side minus that of the motion along the path
    s_f  = C_T_hat F_m + S x           height of the surface above that path, through the force sensor
    s    = s_a + T s_b                 s_a, s_b: observer of s_f and of its rate;  T = T_S + T_h
    e'   = w_e d(x - h (u + s))        integral of the drive's error, which friction causes
    dx_bar = u + s - e

h is the joint-reference filter with the command delay, S the filter of the force sensor with its delay, T_S and T_h
their lags on a ramp, 2 z/w + delay: a surface that rises steadily is met without error. The observer has two equal
poles exp(-w_s Ts).

d is a dead zone of C_T_hat F_d while dx_uc is at rest, because an integral of the error never comes to rest with a
drive in static friction. While dx_uc changes there is no dead zone.

With the right compliance s does not depend on the command. With a wrong one, r = C_T_hat/C_T, the part 1 - r of the
command is taken for surface height. The steady-state force is F_bar all the same, because x ends at u + s:
C_T_hat F = s - x = -u.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.primitives import Multiplexer

from forcectl.arrays import Array
from forcectl.force.invariance.force_law import InvarianceConfig
from forcectl.force.sensor_lag import sensor_model
from forcectl.framework.batch import BatchParameter, BatchValue, check_order
from forcectl.framework.fields import key
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.framework.wiring import Around, export_all_outputs, split
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.plant.plant_model import PlantModel

_RESTS = 1e-12  # [m] largest change of the path's displacement along n in a tick in which the path is at rest


class PredictiveCorrection(SampledBatch):
    """Surface height and drive error of n independent force loops, added to a law's command.

    ```
    name: PredictiveCorrection
    input_ports: [measured_force, motor_displacement, path_displacement, planned_displacement, nominal_command,
    filtered_displacements]
    output_ports: [displacement_command, planned_command, surface_offset, drive_offset]
    parameters: [compliance, surface_bandwidth, drive_bandwidth, search_speed, lead, minimum_force, offset_limit,
    lower_limit, upper_limit, drive_compliance, drive_dead_zone]
    ```

    measured_force: shape (n,), F_m [N]. motor_displacement, path_displacement: shape (n,), dx_m and h dx_uc [m].
    filtered_displacements: shape (2n,), both after the filter of the force sensor [m, m].
    planned_displacement: shape (n,), h (u + s) [m]. nominal_command: shape (n,), u [m].
    displacement_command: shape (n,), dx_bar = u + s - e [m], held over [t_k, t_k+1).
    planned_command: shape (n,), u + s [m]. surface_offset, drive_offset: shape (n,), s and e [m].
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): compliance C_T_hat [m/N] > 0; surface_bandwidth w_s and drive_bandwidth w_e [1/s]
    >= 0; search_speed [m/s] >= 0; lead T [s] >= 0; minimum_force [N] >= 0 above which there is contact; offset_limit
    [m] >= 0 of s and e each; lower_limit and upper_limit [m] of the command; drive_compliance [m/N] >= 0, the part of
    C_T_hat between command and motors; drive_dead_zone F_d [N] >= 0, within which e is not changed by a drive error
    while path_displacement is constant.

    Without contact the surface can only be below the tool: s falls at the estimated rate, if that is downwards, and by
    at most search_speed faster, until there is contact.

    While an input is not finite, s and e are held; the command follows u, or is held when u is not finite.

    Sampling: every `period` [s]; no delay from nominal_command to displacement_command, see `SampledBlock`.
    """

    port_units = {"filtered_displacements": "m,m", "planned_command": "m", "drive_offset": "m"}

    def __init__(
        self,
        size: int,
        *,
        compliance: ArrayLike,
        surface_bandwidth: ArrayLike = 4.0,
        drive_bandwidth: ArrayLike = 1.0,
        search_speed: ArrayLike = 0.005,
        lead: ArrayLike = 0.0,
        minimum_force: ArrayLike = 0.2,
        offset_limit: ArrayLike = 0.01,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        drive_compliance: ArrayLike = 0.0,
        drive_dead_zone: ArrayLike = 0.0,
        period: float = 0.002,
    ):
        parameters = {
            "compliance": BatchParameter(compliance, "positive and finite", "m/N"),
            "surface_bandwidth": BatchParameter(surface_bandwidth, "not negative", "1/s"),
            "drive_bandwidth": BatchParameter(drive_bandwidth, "not negative", "1/s"),
            "search_speed": BatchParameter(search_speed, "not negative", "m/s"),
            "lead": BatchParameter(lead, "not negative", "s"),
            "minimum_force": BatchParameter(minimum_force, "not negative", "N"),
            "offset_limit": BatchParameter(offset_limit, "not negative", "m"),
            "lower_limit": BatchParameter(lower_limit, "a number", "m"),
            "upper_limit": BatchParameter(upper_limit, "a number", "m"),
            "drive_compliance": BatchParameter(drive_compliance, "not negative", "m/N"),
            "drive_dead_zone": BatchParameter(drive_dead_zone, "not negative", "N"),
        }
        super().__init__(size, parameters)
        self.sample_delay = {("nominal_command", "displacement_command"): 0.0}
        names = ("measured_force", "motor_displacement", "path_displacement", "planned_displacement", "nominal_command")
        inputs = [self.DeclareVectorInputPort(name, size) for name in names]
        inputs.append(self.DeclareVectorInputPort("filtered_displacements", 2 * size))
        shown = ("displacement_command", "planned_command", "surface_offset", "drive_offset")
        self.declare_memory(dict.fromkeys((*shown, "height", "rate", "nominal", "path"), 0.0), inputs, period)
        self.show(*shown)

    def check_together(self, values: Mapping[str, Array]) -> None:
        """The limits are in order."""
        check_order("lower_limit", "upper_limit", values)

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """The gains of the observer and of the drive's integral instead of the bandwidths, and the search per tick."""
        compliance, surface, drive, search, *rest = values
        pole = np.exp(-surface * self._period)
        gains = 1.0 - pole * pole, (1.0 - pole) ** 2 / self._period, drive * self._period, search * self._period
        return compliance, *(self.batch_value(np.atleast_1d(gain)) for gain in gains), *rest

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the correction."""
        maximum, minimum, where = self.math.maximum, self.math.minimum, self.math.where
        values = self.values(context)
        compliance, gain, rate_gain, drive_gain, search, lead, contact, most, *limits = values
        lower, upper, drive, zone = limits
        rate, force, nominal = memory["rate"], inputs["measured_force"], inputs["nominal_command"]
        motor, path = inputs["motor_displacement"], inputs["path_displacement"]
        filtered_motor, filtered_path = inputs["filtered_displacements"]

        ahead = memory["height"] + self._period * rate
        error = (compliance - drive) * force + filtered_motor - filtered_path - ahead
        drive_error = motor - drive * force - path - inputs["planned_displacement"]
        good = (abs(error) < inf) & (abs(drive_error) < inf) & (abs(nominal) < inf)
        error, drive_error = where(good, error, 0.0), where(good, drive_error, 0.0)

        touching = force > contact
        change = where(touching, gain * error, minimum(maximum(gain * error, -search), 0.0))
        after = minimum(maximum(ahead + change, -most), most)
        # At its limit the height stays, so its rate is zero there.
        updated = where(touching, rate + rate_gain * error, minimum(rate, 0.0))
        rate = where(good, where(abs(after) < most, updated, 0.0), rate)
        height = where(good, after, memory["height"])
        surface = where(good, minimum(maximum(height + lead * rate, -most), most), memory["surface_offset"])
        zone = where(abs(path - memory["path"]) > _RESTS, 0.0, zone * compliance)
        within_zone = minimum(maximum(drive_error, -zone), zone)
        offset = minimum(maximum(memory["drive_offset"] + drive_gain * (drive_error - within_zone), -most), most)
        nominal = where(abs(nominal) < inf, nominal, memory["nominal"])
        plan = nominal + surface
        return {
            "displacement_command": minimum(maximum(plan - offset, lower), upper),
            "planned_command": plan,
            "surface_offset": surface,
            "drive_offset": offset,
            "height": height,
            "rate": rate,
            "nominal": nominal,
            "path": where(abs(path) < inf, path, memory["path"]),
        }


class PredictiveForceLaw(Around):
    """A force law whose command is corrected for surface height and drive error, with the modelled filters of the loop.

    ```
    name: PredictiveForceLaw
    input_ports: [desired_force, measured_force, motor_displacement, path_displacement]
    output_ports: [displacement_command, surface_offset, drive_offset, invariance_function (optional),
    status (optional)]
    ```

    desired_force, measured_force: shape (n,) [N]. motor_displacement: shape (n,), actual motor-side dx along n [m].
    path_displacement: shape (n,), dx_uc: displacement along n of the reference in the unconstrained directions [m].
    displacement_command: shape (n,) [m]. surface_offset, drive_offset: shape (n,), s and e [m].
    invariance_function, status: shape (n,) [m, 1]; of laws that have them. Feedthrough of desired_force and
    measured_force at the tick.
    All outputs are feedthrough of desired_force, measured_force and motor_displacement at the tick.

    Sampling: every `period` [s]; no delay beyond that of the law.

    Args:
        law: with the ports of the force law's slot.
        correction: of the same size n.
        filters: h on dx_uc, h on u + s, and S on dx_m and h dx_uc, the last of size 2n.
    """

    def __init__(
        self, law: System, correction: PredictiveCorrection, filters: tuple[PositionLoop, PositionLoop, System]
    ):
        super().__init__(law)
        builder, n = DiagramBuilder(), correction.size
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        add("law", law)
        add("correction", correction)
        path_loop, planned_loop, sensor = filters
        add("path_loop", path_loop)
        add("planned_loop", planned_loop)
        add("displacement_filter", sensor)
        path, _ = split(builder, "path", [n, n], path_loop.get_output_port())
        planned, _ = split(builder, "planned", [n, n], planned_loop.get_output_port())
        both = add("displacements", Multiplexer([n, n]))
        export(law.GetInputPort("desired_force"), "desired_force")
        measured = export(law.GetInputPort("measured_force"), "measured_force")
        builder.ConnectInput(measured, correction.GetInputPort("measured_force"))
        motor = export(correction.GetInputPort("motor_displacement"), "motor_displacement")
        builder.ConnectInput(motor, both.get_input_port(0))
        export(path_loop.get_input_port(), "path_displacement")
        connect(path, both.get_input_port(1))
        connect(path, correction.GetInputPort("path_displacement"))
        connect(both.get_output_port(), sensor.get_input_port())
        connect(sensor.get_output_port(), correction.GetInputPort("filtered_displacements"))
        connect(correction.GetOutputPort("planned_command"), planned_loop.get_input_port())
        connect(planned, correction.GetInputPort("planned_displacement"))
        connect(law.GetOutputPort("displacement_command"), correction.GetInputPort("nominal_command"))
        for name in ("displacement_command", "surface_offset", "drive_offset"):
            builder.ExportOutput(correction.GetOutputPort(name), name)
        export_all_outputs(builder, law, but=["displacement_command"])
        builder.BuildInto(self)


@dataclass(kw_only=True)
class PredictiveInvarianceConfig(InvarianceConfig):
    """Scenario part `!PredictiveInvariance`: an open-loop law [57], corrected for surface height and drive error."""

    surface_bandwidth: float = key(
        4.0, "bandwidth w_s of the observer of the surface height; 0: no observer", unit="1/s", bounds="not negative"
    )
    drive_bandwidth: float = key(
        1.0, "bandwidth w_e of the correction of the drive's error; 0: no correction", unit="1/s", bounds="not negative"
    )
    drive_dead_zone: float = key(
        0.3,
        "force F_d whose displacement C_T_hat F_d is the drive error left uncorrected while the path is at rest",
        unit="N",
        bounds="not negative",
    )
    search_speed: float = key(
        0.005,
        "largest speed towards the surface without contact, beside its estimated rate",
        unit="m/s",
        bounds="from 0 to 1",
    )
    offset_limit: float = key(
        0.01,
        "largest correction of the command for surface height, and for drive error",
        unit="m",
        bounds="from 0 to 1",
    )
    minimum_force: float = key(0.2, "measured force above which there is contact", unit="N", bounds="not negative")
    filter_bandwidth: float = key(
        75.4, "bandwidth w of the modelled joint-reference filter h", unit="rad/s", bounds="from 0.1 to 100000"
    )
    filter_damping_ratio: float = key(
        1.0, "damping ratio z of the modelled joint-reference filter h", unit="1", bounds="from 0.01 to 10"
    )
    filter_delay: float = key(
        0.002, "command delay in the modelled joint-reference filter h, whole ticks", unit="s", bounds="from 0 to 0.1"
    )

    def position_loop(self, model: PlantModel) -> PositionLoop:
        """The model of the joint-reference filter and its delay."""
        return PositionLoop(
            model.size,
            bandwidth=self.filter_bandwidth,
            damping_ratio=self.filter_damping_ratio,
            period=model.period,
            delay=self.filter_delay,
            unit="m",
        )

    def lead(self, model: PlantModel) -> float:
        """T = T_S + T_h [s]: the lag of sensor and drive on a ramp."""
        return model.sensor_lag + 2 * self.filter_damping_ratio / self.filter_bandwidth + self.filter_delay

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> PredictiveForceLaw:
        """Add the law; it and its correction assume `compliance_error` times the true total compliance."""
        compliance = self.compliance_error * model.total_compliance
        correction = PredictiveCorrection(
            model.size,
            compliance=compliance,
            surface_bandwidth=self.surface_bandwidth,
            drive_bandwidth=self.drive_bandwidth,
            search_speed=self.search_speed,
            lead=self.lead(model),
            minimum_force=self.minimum_force,
            offset_limit=self.offset_limit,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            drive_compliance=model.drive_compliance,
            drive_dead_zone=self.drive_dead_zone,
            period=model.period,
        )
        filters = self.position_loop(model), self.position_loop(model), sensor_model(model, 2 * model.size)
        law = PredictiveForceLaw(self.law(model, compliance), correction, filters)
        return builder.AddNamedSystem("force_law", law)
