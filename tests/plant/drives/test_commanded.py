"""Motors that are where and as fast as they were commanded."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams.drives.commanded_drive import CommandedDriveConfig
from forcectl.errors import BadInputError
from forcectl.plant.drives.commanded import CommandedMotion
from forcectl.testing import run_diagram

TS = 0.004


def test_a_command_shows_one_tick_later_with_its_speed():
    inputs = {"joint_position_command": lambda t: [t, 2.0], "joint_velocity_command": lambda t: [7.0, t]}
    log = run_diagram(CommandedMotion(2, start=[0.5, 2.0], period=TS), 10 * TS, period=TS, inputs=inputs)
    np.testing.assert_allclose(log["motor_position"][:, 0], [0.5, *log.time[:-1]])
    np.testing.assert_allclose(log["motor_velocity"], [[0.0, 0.0], *([7.0, t] for t in log.time[:-1])])


def test_without_a_speed_it_is_that_of_the_positions():
    block = CommandedMotion(1, period=TS)
    context = block.CreateDefaultContext()
    block.GetInputPort("joint_position_command").FixValue(context, [0.02])
    state = block.EvalUniquePeriodicDiscreteUpdate(context)
    np.testing.assert_allclose(state.get_vector(1).value(), [0.02 / TS])


def test_motors_with_inertia_do_not_move_like_that():
    changed = {"station.drive": CommandedDriveConfig(), "station.fidelity": "Multibody"}
    with pytest.raises(BadInputError, match=r"station.drive = !Commanded: must have a fidelity without dynamics"):
        fc.run("fig_2_7", variant="K_I = 1.5 1/s", overrides=changed)
