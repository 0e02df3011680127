"""The truth of contacts on a station with two arms, for contacts of points and of surfaces of pressure."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import DefaultProximityProperties, SceneGraphConfig
from pydrake.systems.analysis import Simulator

from forcectl.diagrams import ContactTruthConfig, JointReadingsConfig, describe
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.station import build_station
from forcectl.errors import BadInputError
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from tests.examples.stations import free, pressing

TICK = 0.004
TOOLS = {arm: f"{arm}_yumi_gripper" for arm in ("left", "right")}
HYDROELASTIC = DefaultProximityProperties(compliance_type="compliant", hydroelastic_modulus=1e6, resolution_hint=0.01)


def station(**pairs: ContactTruthConfig) -> MultibodyStation:
    config = free(self_collision=True, time_step=0.001)
    return MultibodyStation(describe(replace(config, sensors={"joints": JointReadingsConfig(), **pairs})), 0)


def crossed(arms: MultibodyStation):
    """Run the grippers into each other; returns the root context."""
    simulator = Simulator(arms)
    context = simulator.get_mutable_context()
    command = arms.GetInputPort("joint_position_command")
    start = arms.GetOutputPort("link_position").Eval(context)
    towards = np.zeros(14)
    towards[[0, 7]] = -1.0, 1.0
    for k in range(round(0.6 / TICK)):
        command.FixValue(context, start + towards * min(1.0, k * TICK / 0.5))
        simulator.AdvanceTo((k + 1) * TICK)
    return context


def drakes_sum(arms: MultibodyStation, context, model: str, point: np.ndarray):
    """Of the contacts of a model instance with others, by Drake's bookkeeping of geometries; and how many there are."""
    plant = arms.plant
    results = plant.get_contact_results_output_port().Eval(plant.GetMyContextFromRoot(context))
    inspector = arms.scene_graph.model_inspector()
    own, total = plant.GetModelInstanceByName(model), np.zeros(6)
    found = []
    for i in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(i)
        pair = [plant.get_body(index).model_instance() for index in (info.bodyA_index(), info.bodyB_index())]
        found.append((pair, info.contact_point(), np.zeros(3), -info.contact_force()))
    for i in range(results.num_hydroelastic_contacts()):
        info = results.hydroelastic_contact_info(i)
        surface, on_a = info.contact_surface(), info.F_Ac_W()
        frames = [inspector.GetFrameId(geometry) for geometry in (surface.id_M(), surface.id_N())]
        pair = [plant.GetBodyFromFrameId(frame).model_instance() for frame in frames]
        found.append((pair, surface.centroid(), on_a.rotational(), on_a.translational()))
    for pair, where, torque, force in found:
        if own in pair and pair[0] != pair[1]:
            sign = 1.0 if pair[0] == own else -1.0
            total += sign * np.concatenate([torque + np.cross(where - point, force), force])
    return total, results.num_point_pair_contacts(), results.num_hydroelastic_contacts()


@pytest.mark.parametrize("defaults", [None, HYDROELASTIC], ids=["points", "surfaces"])
def test_arms_that_press_on_each_other(defaults):
    """All truths are the sum of Drake's own contact results."""
    pair = ContactTruthConfig(on=[TOOLS["left"]], by=["yumi", TOOLS["right"]], frame=f"{TOOLS['left']}::tcp")
    back = ContactTruthConfig(on=[TOOLS["right"]], by=[TOOLS["left"], "yumi"])
    arms = station(pair=pair, back=back)
    if defaults is not None:
        arms.scene_graph.set_config(SceneGraphConfig(default_proximity_properties=defaults))
    assert arms.port_units == {"back_body_contact_wrench": "Nm,N"}
    context = crossed(arms)
    read = {name: arms.GetOutputPort(name).Eval(context) for name in ("tip_wrench", "arm_contact_force")}
    plant = arms.plant
    state = plant.GetMyContextFromRoot(context)
    for i, tool in enumerate(TOOLS.values()):
        X_WT = plant.GetFrameByName("tcp", plant.GetModelInstanceByName(tool)).CalcPoseInWorld(state)
        drake, points, surfaces = drakes_sum(arms, context, tool, X_WT.translation())
        assert (points > 0, surfaces > 0) == ((True, False) if defaults is None else (False, True))
        assert np.linalg.norm(drake[3:]) > 1.0
        assert read["arm_contact_force"][i] >= np.linalg.norm(drake[3:]) - 1e-9
        np.testing.assert_allclose(read["tip_wrench"][6 * i :][:6], drake, atol=1e-9)
        if i == 0:
            in_tool = (drake.reshape(2, 3) @ X_WT.rotation().matrix()).ravel()
            np.testing.assert_allclose(arms.GetOutputPort("body_contact_wrench").Eval(context), in_tool, atol=1e-9)
    in_world, _, _ = drakes_sum(arms, context, TOOLS["right"], np.zeros(3))
    np.testing.assert_allclose(arms.GetOutputPort("back_body_contact_wrench").Eval(context), in_world, atol=1e-9)


def test_nothing_touches_at_the_start():
    arms = station(pair=ContactTruthConfig(on=["yumi"], by=[TOOLS["left"], TOOLS["right"]]))
    context = arms.CreateDefaultContext()
    for name in ("body_contact_wrench", "tip_wrench", "arm_contact_force"):
        assert not arms.GetOutputPort(name).Eval(context).any()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"on": []}, "on = []: must be at least one body"),
        ({"on": ["left_hand"]}, "unknown on 'left_hand'"),
        ({"on": ["base"]}, "on = 'base': must be one of left_yumi_gripper::base, right_yumi_gripper::base"),
        ({"on": ["left_link_7"], "by": ["yumi"]}, "by = ['yumi']: must be other bodies than those of on"),
        ({"on": ["left_link_7"], "frame": "nowhere"}, "unknown frame 'nowhere'"),
    ],
)
def test_bodies_and_frames_that_are_not_there_are_refused(keys, message):
    with pytest.raises(BadInputError) as caught:
        station(pair=ContactTruthConfig(**keys))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_box_is_no_body_even_where_a_body_has_its_name():
    box = ObstacleConfig(size=[0.1, 0.1, 0.1], position=[0.0, 0.0, -1.0])
    for name in ("table", "left_link_7"):
        config = free(self_collision=True)
        config = replace(
            config,
            environment=EnvironmentPartsConfig(parts={name: box}),
            sensors={**config.sensors, "pair": ContactTruthConfig(on=["right_yumi_gripper"], by=[name])},
        )
        with pytest.raises(BadInputError, match=f"the box '{name}' is of the body 'world', as all boxes are"):
            build_station(describe(config), 0)


def test_a_station_without_bodies_is_refused():
    sensors = {"pair": ContactTruthConfig(on=["tool"])}
    with pytest.raises(BadInputError, match="need the fidelity Multibody"):
        build_station(describe(pressing(fidelity="Kinematic", sensors=sensors)))
