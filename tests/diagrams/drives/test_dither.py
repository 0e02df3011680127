"""The dither of a joint interface and the compensation of its friction, with the whole drive and elastic joints."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.diagrams.drives.joint_interface import JointInterfaceConfig, JointServoConfig
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.errors import BadInputError
from forcectl.motion.joint_dither import JointDitherConfig
from tests.examples.joint_interface_runs import TICK, describe, run

DITHER = JointDitherConfig(amplitude=1e-3)


def interface(**options):
    return describe(elastic_joints=True, drive=JointInterfaceConfig(**options))


def moving_share(speed, limit=0.004):
    """Share of the time from 0.3 s on in which each joint is faster than the limit."""
    return (np.abs(speed[round(0.3 / TICK) :]) > limit).mean(axis=0)


def tool_way(workcell, positions):
    """Largest distance of the tip from its mean place [m]."""
    robot, context = workcell.robot, workcell.robot.create_context()
    places = []
    for q in positions[round(0.3 / TICK) :]:
        robot.set_positions(context, q)
        places.append(robot.tip_position(context))
    return np.linalg.norm(places - np.mean(places, axis=0), axis=1).max()


def test_with_a_dither_no_joint_stays_in_static_friction_and_the_tool_hardly_moves():
    compensated = JointServoConfig(friction_compensation=0.9)
    workcell = interface(dither=DITHER, servo=compensated)
    log = run(workcell, 0.8)
    assert moving_share(log["joint_velocity"]).min() > 0.75
    assert tool_way(workcell, log["link_position"]) < 4e-4
    still = run(interface(), 0.8)
    assert moving_share(still["joint_velocity"]).max() == 0.0


def test_the_station_outputs_what_the_servo_loops_get_while_there_is_a_dither():
    station = MultibodyStation(interface(dither=DITHER), 0)
    context = station.CreateDefaultContext()
    start = station.GetInputPort("joint_position_command")
    start.FixValue(context, np.full(start.size(), 0.1))
    outputs = {name: station.GetOutputPort(name) for name in ("dithered_position", "dithered_velocity")}
    assert all(port.size() == start.size() for port in outputs.values())
    simulator = Simulator(station, context)
    simulator.AdvanceTo(0.5)
    off = outputs["dithered_position"].Eval(context) - 0.1
    assert (np.abs(off) < 4.1e-3).all()
    assert (np.hypot(off, outputs["dithered_velocity"].Eval(context) / (12 * np.pi)) > 0.9e-3).all()
    assert not MultibodyStation(interface(), 0).HasOutputPort("dithered_position")


def test_compensated_joints_reverse_without_a_stop():
    """Without it a joint stands at each reversal until the servo has changed the torque by twice the friction."""
    shares = []
    for compensation in (0.0, 0.9):
        workcell = interface(dither=DITHER, servo=JointServoConfig(friction_compensation=compensation))
        shares.append(moving_share(run(workcell, 0.8)["joint_velocity"]))
    assert (shares[1] > shares[0]).all()
    assert shares[1].min() > shares[0].min() + 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"amplitude": 0.01}, "amplitude = 0.01: must be at most"),
        ({"amplitude": 1e-3, "frequency": 100.0}, "frequency = 100.0: must be at most 62.5 Hz"),
    ],
)
def test_a_dither_that_cannot_be_is_refused_with_its_key(options, message):
    with pytest.raises(BadInputError, match=message):
        run(interface(dither=JointDitherConfig(**options)), 0.004)
