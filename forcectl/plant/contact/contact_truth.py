"""True contact wrenches between bodies, for every contact model.

A point contact has a force at a point. A hydroelastic contact has a surface of pressure; Drake computes its resultant
(torque and force) at the centroid of that surface. Both are here wrenches [torque; force] in the world [Nm, N].
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ContactResults, ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, FrameIndex, ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from forcectl.arrays import Array
from forcectl.errors import BadInputError, unknown
from forcectl.framework.block import PythonBlock
from forcectl.framework.kernels import cross


class BodyContact(NamedTuple):
    """One contact between two bodies.

    Attributes:
        body_a, body_b: indices of the bodies.
        point: where it acts, in the world, shape (3,) [m].
        wrench: on body B at this point in the world, shape (6,); on body A with minus sign [Nm, N].
    """

    body_a: int
    body_b: int
    point: Array
    wrench: Array


class ContactReader:
    """Reads the contact results of a plant.

    Args:
        plant: finalized.
    """

    def __init__(self, plant: MultibodyPlant):
        bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
        self._body_of = {
            geometry.get_value(): int(body.index())  # the identifier itself would keep the plant alive
            for body in bodies
            if plant.geometry_source_is_registered()
            for geometry in plant.GetCollisionGeometriesForBody(body)
        }

    def read(self, results: ContactResults) -> Iterator[BodyContact]:
        """All contacts, point contacts and hydroelastic ones."""
        for i in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(i)
            wrench = np.concatenate([np.zeros(3), pair.contact_force()])
            yield BodyContact(int(pair.bodyA_index()), int(pair.bodyB_index()), pair.contact_point(), wrench)
        for i in range(results.num_hydroelastic_contacts()):
            touch = results.hydroelastic_contact_info(i)
            surface, wrench = touch.contact_surface(), -touch.F_Ac_W().get_coeffs()
            first, second = (self._body_of[each.get_value()] for each in (surface.id_M(), surface.id_N()))
            yield BodyContact(first, second, surface.centroid(), wrench)


class ContactPairs:
    """Inputs `contact_pair_1` and so on of a block: contacts that are not in a plant's contact results.

    Args:
        block: where the inputs are declared.
        count: number of inputs.
    """

    def __init__(self, block: LeafSystem, count: int):
        names = [f"contact_pair_{i + 1}" for i in range(count)]
        self._ports = [block.DeclareAbstractInputPort(name, AbstractValue.Make(())) for name in names]
        self.tickets = {port.ticket() for port in self._ports}

    def read(self, context: Context) -> list[BodyContact]:
        """Contacts of all inputs."""
        return [contact for port in self._ports for contact in port.Eval(context)]


def applied_force(body: BodyIndex, place: Array, wrench: Array) -> ExternallyAppliedSpatialForce:
    """A wrench [torque; force] in the world on a body, at a point in its frame, as input of a plant [Nm, N], [m]."""
    applied = ExternallyAppliedSpatialForce()
    applied.body_index, applied.p_BoBq_B = body, place
    applied.F_Bq_W = SpatialForce(wrench[:3], wrench[3:])
    return applied


def wrench_between(
    contacts: Iterable[BodyContact], on: Collection[int], by: Collection[int] | None, point: Array
) -> Array:
    """Sum of the wrenches on some bodies by others.

    Args:
        contacts: of a plant.
        on: indices of the bodies on which the wrenches act.
        by: indices of the bodies that exert them; None: all that are not in `on`.
        point: reference of the torque, in the world, shape (3,) [m].

    Returns:
        [torque; force] at the point in the world, shape (6,) [Nm, N].
    """
    total = np.zeros(6)
    for contact in contacts:
        for body, other, sign in ((contact.body_b, contact.body_a, 1.0), (contact.body_a, contact.body_b, -1.0)):
            if body in on and (other not in on if by is None else other in by):
                total[:3] += sign * (contact.wrench[:3] + cross(contact.point - point, contact.wrench[3:]))
                total[3:] += sign * contact.wrench[3:]
    return total


def bodies_named(plant: MultibodyPlant, names: Sequence[str], key: str) -> frozenset[int]:
    """Indices of bodies, each named as "body", "model::body", or as "model" for all bodies of a model instance.

    Args:
        plant: finalized.
        names: of bodies and model instances.
        key: key that named them, for error messages.

    Raises:
        BadInputError: there is none of that name, or several.
    """
    bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    instances = [ModelInstanceIndex(i) for i in range(plant.num_model_instances())]
    models = [plant.GetModelInstanceName(each) for each in instances if plant.GetBodyIndices(each)]
    found: set[int] = set()
    for name in names:
        if plant.HasModelInstanceNamed(name):
            instance: ModelInstanceIndex = plant.GetModelInstanceByName(name)
            found |= {int(index) for index in plant.GetBodyIndices(instance)}
        else:
            named = [(body.name(), body.scoped_name().get_full()) for body in bodies]
            if not any(name in both for both in named):
                raise unknown(key, name, [*models, *(full for _, full in named)])
            place = _place(name, named, key)
            found.add(int(bodies[place].index()))
    return frozenset(found)


def frame_called(plant: MultibodyPlant, name: str, key: str) -> Frame:
    """A frame of a plant, named as "frame" or "model::frame"; "world" is the world's.

    Raises:
        BadInputError: there is none of that name, or several.
    """
    frames = [plant.get_frame(FrameIndex(i)) for i in range(plant.num_frames())]
    return frames[_place(name, [(frame.name(), frame.scoped_name().get_full()) for frame in frames], key)]


def _place(name: str, known: list[tuple[str, str]], key: str) -> int:
    found = [i for i, names in enumerate(known) if name in names]
    if len(found) > 1:
        raise BadInputError(f" = {name!r}: must be one of {', '.join(known[i][1] for i in found)}", key=key)
    if not found:
        raise unknown(key, name, [full for _, full in known])
    return found[0]


class ContactWrench(PythonBlock):
    """Contact wrench that some bodies of a plant exert on others, in the axes of a frame.

    ```
    name: ContactWrench
    input_ports: [contact_results, body_poses, contact_pair_1 (optional), (further ones of the same kind)]
    output_ports: [body_contact_wrench]
    ```

    contact_results, body_poses: abstract, of the plant.
    contact_pair_1: abstract, of a `PegContact` or `CapContact`; contact_pair_2 of a second one, and so on.
    body_contact_wrench: shape (6,), on the bodies `on` at the origin of the frame in the frame, [torque; force]; zero
    where they do not touch [Nm, N]. Feedthrough of all inputs.

    Sampling: none; evaluated when read. With sampled output ports of the plant the results are those of its last step.

    Args:
        plant: finalized.
        on: indices of the bodies on which the wrench acts.
        by: indices of the bodies that exert it; None: all others.
        frame: of the plant.
        pairs: number of contacts that the plant does not compute itself, each with an input.
    """

    def __init__(
        self, plant: MultibodyPlant, on: Collection[int], by: Collection[int] | None, frame: Frame, pairs: int = 0
    ):
        super().__init__()
        self._reader, self._on = ContactReader(plant), frozenset(map(int, on))
        self._by = None if by is None else frozenset(map(int, by))
        self._body, self._X_BF = int(frame.body().index()), frame.GetFixedPoseInBodyFrame()
        self._results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._pairs = ContactPairs(self, pairs)
        self.DeclareVectorOutputPort(
            "body_contact_wrench",
            6,
            self._show,
            prerequisites_of_calc={self._results.ticket(), self._poses.ticket()} | self._pairs.tickets,
        )

    def _show(self, context: Context, output: BasicVector) -> None:
        X_WF = self._poses.Eval(context)[self._body] @ self._X_BF
        contacts = [*self._reader.read(self._results.Eval(context)), *self._pairs.read(context)]
        wrench = wrench_between(contacts, self._on, self._by, X_WF.translation())
        output.SetFromVector((wrench.reshape(2, 3) @ X_WF.rotation().matrix()).ravel())
