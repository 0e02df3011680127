"""The YuMi's collision shapes: what they contain, which pairs are checked, and that they tell free from not free."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.geometry import Box, Capsule, GeometryId, QueryObject, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from forcectl.models import models_folder
from forcectl.robot.parts import RobotParts, add_robot

GOLDEN = yaml.safe_load((Path(__file__).parents[1] / "data" / "yumi_golden.yaml").read_text())
AXES = (1, 2, 7, 3, 4, 5, 6)
URDF = models_folder() / "yumi" / "yumi.urdf"
HOME = {side: GOLDEN["home"][side]["q_deg"] for side in ("left", "right")}


class Scene:
    """Robot and grippers with their geometry."""

    def __init__(self, robot: str = "yumi", tool: str | None = "yumi_gripper"):
        builder = DiagramBuilder()
        self.plant: MultibodyPlant
        self.scene_graph: SceneGraph
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
        self.parts: RobotParts = add_robot(self.plant, robot, tool)
        self.plant.Finalize()
        self.diagram: Diagram = builder.Build()
        self.context: Context = self.diagram.CreateDefaultContext()
        self.names = {g: self._name(g) for g in self.scene_graph.model_inspector().GetAllGeometryIds()}

    def _name(self, geometry: GeometryId) -> str:
        body = self.plant.GetBodyFromFrameId(self.scene_graph.model_inspector().GetFrameId(geometry))
        model = self.plant.GetModelInstanceName(body.model_instance())
        return body.name() if model == "yumi" else f"{model}/{body.name()}"

    def pairs(self) -> list[tuple[GeometryId, GeometryId]]:
        return list(self.scene_graph.model_inspector().GetCollisionCandidates())

    def checked(self) -> set[frozenset[str]]:
        return {frozenset((self.names[a], self.names[b])) for a, b in self.pairs()}

    def query(self, q_deg: list[float]) -> QueryObject:
        context = self.plant.GetMyMutableContextFromRoot(self.context)
        self.plant.SetPositions(context, np.radians(q_deg))
        return self.plant.get_geometry_query_input_port().Eval(context)

    def distances(self, q_deg: list[float]) -> dict[frozenset[str], float]:
        """Least signed distance [m] of each pair of bodies that is checked."""
        query, least = self.query(q_deg), {}
        for a, b in self.pairs():
            distance = query.ComputeSignedDistancePairClosestPoints(a, b).distance
            bodies = frozenset((self.names[a], self.names[b]))
            least[bodies] = min(distance, least.get(bodies, np.inf))
        return least


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


def test_links_are_inside_the_capsules_fitted_to_the_real_ones(scene):
    inspector = scene.scene_graph.model_inspector()
    for side in ("left", "right"):
        for i in AXES:
            (geometry,) = scene.plant.GetCollisionGeometriesForBody(scene.plant.GetBodyByName(f"{side}_link_{i}"))
            shape, X, golden = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry), None
            golden = GOLDEN["capsules"][f"link_{i}"]
            assert isinstance(shape, Capsule)
            assert shape.radius() == pytest.approx(golden["radius"])
            ends = [X @ np.array([0, 0, sign * shape.length() / 2]) for sign in (1, -1)]
            np.testing.assert_allclose(ends, [golden["b"], golden["a"]], atol=1e-8)


def test_torso_shapes_stay_inside_the_torso_and_reach_its_faces(scene):
    """The three boxes fitted to the real torso are outer dimensions; ours are rounder, but as high, wide and deep."""
    inspector = scene.scene_graph.model_inspector()
    boxes = {name: np.array([b["centre"], b["size"]]) for name, b in GOLDEN["torso_boxes"].items()}
    reach = {name: np.full((2, 3), np.nan) for name in boxes}
    for geometry in scene.plant.GetCollisionGeometriesForBody(scene.plant.GetBodyByName("robot_base")):
        name, shape = inspector.GetName(geometry).removeprefix("yumi::").split("_")[0], inspector.GetShape(geometry)
        centre = inspector.GetPoseInFrame(geometry).translation()
        if isinstance(shape, Box):
            half = shape.size() / 2
        else:
            assert isinstance(shape, Capsule)
            half = np.array([shape.length() / 2, 0, 0]) + shape.radius()
        reach[name][0] = np.fmin(reach[name][0], centre - half)
        reach[name][1] = np.fmax(reach[name][1], centre + half)
    for name, (centre, size) in boxes.items():
        low, high = centre - size / 2, centre + size / 2
        assert (reach[name][0] >= low - 1e-3).all(), name
        assert (reach[name][1] <= high + 1e-3).all(), name
        # The front of the head is a part of the shoulders, which the capsules of the arms' first links contain.
        assert (reach[name][0] <= low + 1e-3).all(), name
        assert (reach[name][1] >= high - [0.045, 1e-3, 1e-3]).all(), name


def outside(points: np.ndarray, collision: ElementTree.Element) -> np.ndarray:
    """How far points stand out of a URDF collision shape [m]; negative inside."""
    origin, geometry = collision.find("origin"), collision.find("geometry")
    numbers = [[float(x) for x in origin.get(key, "0 0 0").split()] for key in ("rpy", "xyz")]
    inside = (RigidTransform(RollPitchYaw(*numbers[0]), numbers[1]).inverse() @ points.T).T
    if (box := geometry.find("box")) is not None:
        half = np.array([float(x) for x in box.get("size").split()]) / 2
        return np.linalg.norm(np.maximum(np.abs(inside) - half, 0), axis=1)
    capsule = geometry.find("{http://drake.mit.edu}capsule")
    half, radius = float(capsule.get("length")) / 2, float(capsule.get("radius"))
    axis = np.zeros_like(inside)
    axis[:, 2] = np.clip(inside[:, 2], -half, half)
    return np.linalg.norm(inside - axis, axis=1) - radius


def test_what_is_drawn_is_inside_the_collision_shapes():
    """To 7 mm: the drawing is ours, the shapes contain the real links."""
    for link in ElementTree.parse(URDF).getroot().findall("link"):
        for mesh in link.findall("visual/geometry/mesh"):
            text = (URDF.parent / mesh.get("filename")).read_text()
            rows = [line.split()[1:] for line in text.splitlines() if line.startswith("v ")]
            stands_out = np.min([outside(np.array(rows, float), c) for c in link.findall("collision")], axis=0)
            assert stands_out.max() < 0.007, (link.get("name"), mesh.get("filename"))


def test_the_home_position_is_free(scene):
    least = scene.distances([*HOME["left"], *HOME["right"]])
    assert min(least.values()) > 0.012, min(least, key=least.get)


@pytest.mark.parametrize(
    ("left", "right", "bodies"),
    [
        # both arms reaching to the front, then each turned across the middle
        ([0, -40, 0, 20, 0, 40, 0], [0, -40, 0, 20, 0, 40, 0], None),
        ([-80, -40, 0, 20, 0, 40, 0], [80, -40, 0, 20, 0, 40, 0], ("left", "right")),
        # the left arm folded back into the torso
        ([10, -140, 160, -10, 50, 20, -50], HOME["right"], ("left", "robot_base")),
    ],
)
def test_contact_is_seen_between_the_right_bodies(scene, left, right, bodies):
    touching = [pair for pair, distance in scene.distances([*left, *right]).items() if distance < 0]
    if bodies is None:
        assert touching == []
    else:
        sides = [
            {next(s for s in ("left", "right", "robot_base") if name.startswith(s)) for name in p} for p in touching
        ]
        assert set(bodies) in sides


def test_pairs_that_touch_by_construction_are_not_checked(scene):
    checked = scene.checked()
    for side in ("left", "right"):
        tool = f"{side}_yumi_gripper"
        never = [("link_2", "link_3"), ("link_3", "link_5"), ("link_4", "link_6")]
        never += list(zip([f"link_{i}" for i in AXES[:-1]], [f"link_{i}" for i in AXES[1:]], strict=True))
        for a, b in never:
            assert frozenset((f"{side}_{a}", f"{side}_{b}")) not in checked
        for link in ("link_4", "link_5", "link_6"):
            assert frozenset((f"{side}_{link}", f"{tool}/base")) not in checked
        assert frozenset(("robot_base", f"{side}_link_1")) not in checked
    limits, rng = GOLDEN["limits"], np.random.default_rng(0)
    touching = scene.checked()
    for _ in range(20):  # whatever the posture
        q = rng.uniform([*limits["lower_deg"]] * 2, [*limits["upper_deg"]] * 2)
        touching &= {pair for pair, distance in scene.distances(q.tolist()).items() if distance < 0}
    assert touching == set()


def test_every_pair_of_the_two_arms_is_checked_but_the_shoulders(scene):
    checked = scene.checked()
    tools = {side: [f"{side}_yumi_gripper/{body}" for body in ("base", "finger_1", "finger_2")] for side in HOME}
    arms = {side: [f"{side}_link_{i}" for i in AXES] + tools[side] for side in HOME}
    missing = {(a, b) for a in arms["left"] for b in arms["right"] if frozenset((a, b)) not in checked}
    assert missing == {("left_link_1", "right_link_1")}
    far = {(a, "robot_base") for side in HOME for a in arms[side][1:] if frozenset((a, "robot_base")) not in checked}
    assert far == set()


def test_a_single_arm_is_checked_against_the_other_one_at_rest():
    scene = Scene("yumi/left")
    assert any({a.split("_")[0], b.split("_")[0]} == {"left", "right"} for a, b in map(sorted, scene.checked()))
    assert min(scene.distances(HOME["left"]).values()) > 0.012
