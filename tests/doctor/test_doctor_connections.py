"""Connections of a plant that the doctor asks for: desired states, geometry, open inputs."""

import pytest
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource

from forcectl.doctor import examine, examine_builder


def slider(plant, *, gains=False, geometry=False):
    body = plant.AddRigidBody("slider", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    joint = plant.AddJoint(PrismaticJoint("x", plant.world_frame(), body.body_frame(), [1, 0, 0]))
    actuator = plant.AddJointActuator("x_act", joint)
    if gains:
        actuator.set_controller_gains(PdControllerGains(p=100.0, d=1.0))
    if geometry:
        plant.RegisterCollisionGeometry(body, RigidTransform(), Sphere(0.1), "ball", CoulombFriction(1.0, 1.0))
    plant.Finalize()


def test_a_plant_with_its_many_ports_is_two_lines():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    slider(plant, geometry=True)
    report = examine(builder.Build())
    assert report.ok
    assert not report.warnings
    assert {f.code for f in report.findings} <= {"plant-inputs", "plant-outputs"}
    assert len([f for f in report.findings if f.path == "plant"]) == 2


def test_gains_with_an_open_desired_state_do_nothing_and_are_told():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    slider(plant, gains=True)
    (finding,) = examine(builder.Build()).warnings
    assert finding.code == "gains-without-desired-state"
    assert finding.path == "plant.DefaultModelInstance_desired_state"
    assert "x_act" in finding.message


def test_gains_with_a_desired_state_are_fine():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    slider(plant, gains=True)
    wanted = builder.AddNamedSystem("wanted", ConstantVectorSource([0.1, 0.0]))
    instance = plant.GetModelInstanceByName("DefaultModelInstance")
    builder.Connect(wanted.get_output_port(), plant.get_desired_state_input_port(instance))
    assert examine(builder.Build()).warnings == ()


def test_geometry_without_a_scene_graph_is_an_error():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    slider(plant, geometry=True)
    builder.Disconnect(scene_graph.get_query_output_port(), plant.get_geometry_query_input_port())
    report = examine_builder(builder)
    assert [(f.code, f.path) for f in report.errors] == [("unconnected-input", "plant.geometry_query")]


def test_a_plant_alone_can_be_examined():
    plant = MultibodyPlant(0.001)
    slider(plant)
    assert examine(plant).ok


class Optional(Adder):
    optional_inputs = ("u1",)


def test_an_input_that_the_block_calls_optional_is_only_noted():
    builder = DiagramBuilder()
    block = builder.AddNamedSystem("block", Optional(2, 1))
    builder.ExportOutput(block.get_output_port(), "y")
    report = examine(builder.Build())
    assert [f.path for f in report.with_code("unconnected-input")] == ["block.u0"]
    assert [f.path for f in report.with_code("optional-input")] == ["block.u1"]


@pytest.mark.parametrize("size", [1, 7])
def test_the_size_of_an_open_input_is_told(size):
    builder = DiagramBuilder()
    block = builder.AddNamedSystem("block", Adder(1, size))
    builder.ExportOutput(block.get_output_port(), "y")
    (finding,) = examine(builder.Build()).errors
    assert f"(size {size})" in finding.message
