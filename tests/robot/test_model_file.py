"""Model files as Drake parses them: nothing is fetched, what is wrong is one line with the file, changes are seen."""

import pytest
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from forcectl.errors import BadInputError
from forcectl.robot.model_file import ModelFile, parse_models
from tests.examples.public_robots import write_stl

MESH = "<mesh><uri>package://drake_models/veggies/pepper.obj</uri></mesh>"
INCLUDED = "<include><uri>package://drake_models/veggies/pepper.sdf</uri></include>"


def write_sdf(folder, inside):
    file = folder / "own.sdf"
    file.write_text(f'<sdf version="1.9" xmlns:drake="drake.mit.edu"><model name="own">{inside}</model></sdf>')
    return file


@pytest.mark.parametrize(
    "inside", [INCLUDED, f'<link name="a"><visual name="v"><geometry>{MESH}</geometry></visual></link>']
)
def test_nothing_is_fetched_from_a_network(tmp_path, monkeypatch, inside):
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:9")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    file, plant, geometry = write_sdf(tmp_path, inside), MultibodyPlant(time_step=0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(geometry)
    with pytest.raises(BadInputError, match=r"own\.sdf: .*drake_models") as caught:
        parse_models(plant, {"own": ModelFile.read(file)}, [])
    assert "download" not in str(caught.value)
    assert not (tmp_path / "cache").exists()


ARM = """
<link name="base"/>
<link name="hand"><pose>0 0 0.1 0 0 0</pose>
<inertial><pose>0.1 0 0 0 0 0</pose><mass>2</mass>
<inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
<collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision></link>
<joint name="wrist" type="revolute"><parent>base</parent><child>hand</child>
<axis><xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper><effort>50</effort><velocity>3</velocity></limit>
<dynamics><damping>0</damping></dynamics></axis>
<drake:gear_ratio>100</drake:gear_ratio></joint>
"""
WRONG = [
    ("<mass>2<", "<mass>0<", "line 4: link 'hand': mass = 0 kg: must be above zero"),
    ("<mass>2<", "<mass>1e9<", "line 4: link 'hand': mass = 1e+09 kg: must be from 1e-09 to 10000 kg"),
    ("<mass>2<", "<mass>1e-12<", "mass = 1e-12 kg: must be from 1e-09 to 10000 kg"),
    ("<mass>2<", "<mass>2_0<", "inertial mass = '2_0': must be a number up to 1e+09"),
    ("<ixx>0.1<", "<ixx>-0.1<", "link 'hand': inertia -0.1, 0.1, 0.1 kg m2: must not be negative"),
    ("<ixx>0.1<", "<ixx>0.3<", "moments of inertia 0.1, 0.1, 0.3 kg m2: must be not negative, and the largest at"),
    ("<ixx>0.1<", "<ixx>0.2000001<", "moments of inertia 0.1, 0.1, 0.2 kg m2: must be not negative"),
    (
        "<ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1<",
        "<ixx>0</ixx><iyy>0</iyy><izz>0<",
        "link 'hand': inertia is zero: must be above zero in a link that moves",
    ),
    ("<ixx>0.1<", "<ixx>nan<", "line 5: inertia ixx = 'nan': must be a number up to 1e+09"),
    ("<pose>0.1 0", "<pose>50 0", "link 'hand': centre of mass 50 m from its origin: must be at most 5 m"),
    ("<pose>0 0 0.1", "<pose>1e6 0 0", "line 3: pose of link 'hand' = '1e6 0 0 0 0 0': must be 3 numbers up to 10"),
    ("<pose>0 0 0.1", "<pose degrees='1'>0 1e9 0 0", "must be 3 numbers up to 10 and then 3 numbers up to 720 deg"),
    ("<pose>0 0 0.1", "<pose rotation_format='quat_xyzw'>0 0 0", "up to 10 and then 4 numbers up to 1e+09"),
    ("<xyz>0 0 1<", "<xyz>0 0 1e-300<", "line 8: joint 'wrist': axis is zero: must be a direction"),
    ("<lower>-1<", "<lower>nan<", "line 8: limit lower = 'nan': must be a number"),
    ("<lower>-1<", "<lower>-1e9<", "line 8: joint 'wrist': lower = -1e+09: must be in radians, at most 50 in size"),
    ("<lower>-1<", "<lower>-170<", "joint 'wrist': lower = -170: must be in radians, at most 50 in size"),
    ("<effort>50<", "<effort>1e-12<", "joint 'wrist': effort = 1e-12: must be at least 0.0001"),
    ("<velocity>3<", "<velocity>1e9<", "joint 'wrist': velocity = 1e+09: must be in rad/s, at most 50, or inf"),
    ("<velocity>3<", "<velocity>0<", "joint 'wrist': velocity = 0: must be above zero, or left out for none"),
    (
        "</limit>",
        "<drake:acceleration>0</drake:acceleration></limit>",
        "drake:acceleration = '0': must be a number from",
    ),
    ("<damping>0<", "<damping>1e8<", "line 9: joint 'wrist': damping = 1e+08: must be from 0 to 1e+06"),
    (">100<", ">1e9<", "joint drake:gear_ratio = '1e9': must be a number from 0.001 to 100000 in size"),
    ("<radius>0.1<", "<radius>1e8<", "line 6: sphere radius = '1e8': must be a number from 1e-09 to 10"),
    ("<mass>2<", "<mass>3</mass><mass>2<", "line 4: inertial has another <mass>: must have one"),
    ("</inertial>", "</inertial><inertial/>", "link has another <inertial>: must have one"),
    ("</limit>", "</limit><limit><lower>-2</lower></limit>", "line 8: axis has another <limit>: must have one"),
    ("<sphere><radius>0.1</radius></sphere>", "", "line 6: geometry holds 0 shapes: must hold one"),
    ("</joint>", "", "own.sdf: cannot be read: not valid XML"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG, ids=[new for _, new, _ in WRONG])
def test_what_is_wrong_in_an_sdf_is_one_line(tmp_path, old, new, message):
    assert old in ARM
    with pytest.raises(BadInputError, match=r"^own\.sdf: cannot be read: ") as caught:
        ModelFile.read(write_sdf(tmp_path, ARM.replace(old, new)))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<lower>-1<", "<lower>-1e16<"),
        ("<lower>-1<", "<lower>-inf<"),
        ("<effort>50<", "<effort>-1<"),
        ("<velocity>3<", "<velocity>-1<"),
        ("<pose>0 0 0.1 0 0 0</pose>", "<pose relative_to='base'/>"),
        ("<pose>0 0 0.1", "<pose rotation_format='quat_xyzw'>0 0 0.1 1"),
        ("<pose>0 0 0.1 0", "<pose degrees='true'>0 0 0.1 180"),
    ],
)
def test_what_sdf_says_in_its_own_way_is_read(tmp_path, old, new):
    assert ModelFile.read(write_sdf(tmp_path, ARM.replace(old, new))).bodies == ("base", "hand")


@pytest.mark.parametrize(
    ("old", "new", "about"),
    [
        ("<velocity>3<", "<velocity>1e9<", ("wrist", "")),
        ("<lower>-1<", "<lower>-170<", ("wrist", "")),
        ("<mass>2<", "<mass>1e5<", ("", "hand")),
        ("<mass>2<", "<mass>0<", None),
        ("<damping>0<", "<damping>-1<", None),
    ],
)
def test_what_only_counts_where_it_moves_is_a_conditional_fault(tmp_path, old, new, about):
    file = write_sdf(tmp_path, ARM.replace(old, new))
    if about is None:
        with pytest.raises(BadInputError, match=r"^own\.sdf: cannot be read: "):
            ModelFile.read(file, everything=False)
        return
    (fault,) = ModelFile.read(file, everything=False).conditional_faults
    assert (fault.joint, fault.link) == about


@pytest.mark.parametrize("mass", ["0", "-1"])
def test_a_file_that_an_sdf_includes_has_masses(tmp_path, mass):
    inside = f"<link name='a'><inertial><mass>{mass}</mass></inertial></link>"
    (tmp_path / "other.sdf").write_text(f"<sdf version='1.9'><model name='other'>{inside}</model></sdf>")
    file = write_sdf(tmp_path, f"<include merge='true'><uri>file://{tmp_path}/other.sdf</uri></include>")
    with pytest.raises(BadInputError, match=r"own\.sdf: cannot be used: .* must have masses") as caught:
        parse_models(MultibodyPlant(time_step=0.0), {"own": ModelFile.read(file)}, [])
    assert "bazel" not in str(caught.value)


def test_a_file_that_has_changed_is_read_again(tmp_path):
    file = tmp_path / "own.urdf"
    for names in (("base",), ("base", "hand")):
        joint = '<joint name="j" type="fixed"><parent link="base"/><child link="hand"/></joint>' if names[1:] else ""
        links = "".join(f'<link name="{name}"/>' for name in names)
        file.write_text(f'<robot name="own">{links}{joint}</robot>')
        assert ModelFile.read(file).bodies == names


def parse(file):
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    return parse_models(plant, {"own": ModelFile.read(file)}, [])


@pytest.mark.parametrize("copied", [True, False])
@pytest.mark.parametrize(
    ("part", "wrong"),
    [
        ("<drake:collision_filter_group/>", "collision_filter_group"),  # found when the file is read by itself
        ('<link name="c"><visual/></link>', "geometry"),  # found with the shapes
    ],
)
def test_errors_of_drake_have_the_line_of_the_file_not_of_a_copy(tmp_path, part, wrong, copied):
    material = '<material name="m"/><!-- which is nowhere\n defined -->' if copied else ""
    ball = f'<visual><geometry><sphere radius="1"/></geometry>{material}</visual>'
    mounts = "".join(
        f'<joint name="{a}{b}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>' for a, b in ("ab", "ac")
    )
    part += "" if "link" in part else '<link name="c"/>'
    text = f'<robot name="own">\n<link name="a">{ball}</link>\n<link name="b"/>\n{mounts}\n{part}</robot>'
    file = tmp_path / "own.urdf"
    file.write_text(text)
    with pytest.raises(BadInputError) as caught:
        parse(file)
    line = 1 + text[: text.index(part)].count("\n")
    assert str(caught.value).startswith(f"own.urdf: cannot be read: line {line}: ")
    assert wrong in str(caught.value)


def test_of_mujoco_files_with_other_meshes_it_is_said_that_a_urdf_may_have_them(tmp_path):
    geom = '<geom type="mesh" mesh="m"/>'
    text = f'<asset><mesh name="m" file="m.stl"/></asset><worldbody><body name="a">{geom}</body></worldbody>'
    (tmp_path / "own.xml").write_text(f'<mujoco model="own">{text}</mujoco>')
    write_stl(tmp_path / "m.stl", (1, 1, 1), (0, 0, 0))
    with pytest.raises(
        BadInputError, match=r"line 1: .*\.obj.*was requested; only a URDF of the robot may have other m"
    ):
        parse(tmp_path / "own.xml")
