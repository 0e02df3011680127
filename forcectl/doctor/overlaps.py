"""The check that bodies of a plant do not overlap at the start, where contact would push them apart at once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from forcectl.doctor.report import Finding, warning
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import context_of
from forcectl.plant.contact.contact_truth import ContactReader

_LARGEST_FORCE = 100.0  # [N] between two bodies that do not overlap
_LARGEST_ACCELERATION = 1000.0  # [m/s^2] of the lighter one by this force


def overlapping_bodies(values: StartValues) -> Iterator[Finding]:
    """Pairs of bodies that contact pushes apart at t = 0 in the default context.

    With more than 100 N, or 100 times the weight of the lighter one.
    """
    wiring, root = values.wiring, values.root
    if root is None:
        return
    for path, plant in wiring.leaves():
        if not isinstance(plant, MultibodyPlant):
            continue
        try:
            context = context_of(plant, wiring.root, root)
            if plant.has_sampled_output_ports():  # its results are those of the last step, of which there is none
                context = values.block_context(path)
                plant.ExecuteForcedEvents(context, False)
            results = plant.get_contact_results_output_port().Eval(context)
        except FAILURES:
            continue  # the block that feeds this plant fails; it is reported on its own
        forces = defaultdict[tuple[int, int], float](float)
        for contact in ContactReader(plant).read(results):
            forces[contact.body_a, contact.body_b] += float(np.linalg.norm(contact.wrench[3:]))
        for pair, force in forces.items():
            if force > min(_LARGEST_FORCE, _LARGEST_ACCELERATION * _lighter(plant, pair)):
                names = " and ".join(_name(plant, body) for body in pair)
                text = f"{names} overlap: contact pushes them apart with {force:.3g} N at the start"
                yield warning("overlap", path, text)


def _lighter(plant: MultibodyPlant, pair: tuple[int, int]) -> float:
    """The smaller mass of two bodies [kg]; the world, and bodies without mass, do not count."""
    masses = [plant.get_body(BodyIndex(body)).default_mass() for body in pair if body]
    return min((mass for mass in masses if mass > 0), default=np.inf)


def _name(plant: MultibodyPlant, body: int) -> str:
    return plant.get_body(BodyIndex(body)).scoped_name().to_string() if body else "the world"
