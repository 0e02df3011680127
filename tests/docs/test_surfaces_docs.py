"""docs/surfaces.md says what is true."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import parse
from tests.examples.pages import blocks, page_text

PAGE = page_text("surfaces.md")
(SCENARIO,) = blocks(PAGE, "yaml")


@pytest.mark.slow
def test_the_tool_touches_presses_and_drags_with_the_friction_of_the_surface():
    log = fc.run(parse(SCENARIO, "surface.yaml")).log.squeeze()
    wrench, force = log["body_contact_wrench"].values[:, 3:], log["contact_force"].values
    assert force[0] == 0.0
    slides = slice(1200, 1450)  # 2.4 to 2.9 s
    np.testing.assert_allclose(-wrench[slides, 2], force[slides], rtol=0.01)
    # The plate is dragged along with mu F.
    np.testing.assert_allclose(wrench[slides, 0], 0.3 * force[slides], rtol=0.02)
    # With dissipation Drake takes the normal force of the step before.
    normal = np.maximum(-wrench[1:, 2], -wrench[:-1, 2])
    assert (np.linalg.norm(wrench[1:, :2], axis=1) <= 0.3 * normal + 1e-3).all()


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic"])
def test_friction_needs_a_fidelity_with_forces_across_the_normal(fidelity):
    with pytest.raises(BadInputError, match=r"environment.friction = 0.3: must be 0, or have a fidelity with dynamics"):
        fc.build({"station": {"fidelity": fidelity, "environment": {"friction": 0.3}}})


def test_dissipation_stands_alone_in_a_plant():
    environment = "{parts: {plate: !Surface {dissipation: 5.0}, box: !Box {}}}"
    tree = parse(f"station: {{fidelity: Multibody, environment: !Parts {environment}}}", "surface.yaml")
    with pytest.raises(BadInputError, match=r"environment\.parts\.plate\.dissipation: must be 0 together with box"):
        fc.build(tree)
