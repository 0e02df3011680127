"""A shipped URDF in Pinocchio: an independent parser and independent rigid-body algorithms to compare ours with."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio


class PinocchioModel:
    """The robot in a URDF, its root fixed to the world; vectors are in the order of `joints`."""

    def __init__(self, urdf: Path, joints: Sequence[str]):
        root = ElementTree.parse(urdf).getroot()
        for link in root.findall("link"):
            for shape in (*link.findall("visual"), *link.findall("collision")):
                link.remove(shape)  # its parser complains about capsules
        self.model = pinocchio.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
        self.data = self.model.createData()
        assert set(self.model.names[1:]) == set(joints)
        self.order = np.array([self.model.joints[self.model.getJointId(name)].idx_q for name in joints])

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        upper = np.triu(pinocchio.crba(self.model, self.data, self._to(q)))
        return (upper + np.triu(upper, 1).T)[np.ix_(self.order, self.order)]

    def gravity(self, q: np.ndarray) -> np.ndarray:
        return pinocchio.computeGeneralizedGravity(self.model, self.data, self._to(q))[self.order].copy()

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, vdot: np.ndarray) -> np.ndarray:
        return pinocchio.rnea(self.model, self.data, *map(self._to, (q, v, vdot)))[self.order].copy()

    def coriolis_matrix(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """C of the Christoffel symbols: Mdot = C + C'."""
        C = pinocchio.computeCoriolisMatrix(self.model, self.data, self._to(q), self._to(v))
        return C[np.ix_(self.order, self.order)].copy()

    def position_of_joint(self, q: np.ndarray, joint: str) -> np.ndarray:
        """Where the child's frame of a joint is, in the root's frame."""
        pinocchio.forwardKinematics(self.model, self.data, self._to(q))
        return self.data.oMi[self.model.getJointId(joint)].translation.copy()

    def frame(self, q: np.ndarray, name: str) -> tuple[pinocchio.SE3, np.ndarray]:
        """Pose of a link in the root's frame; Jacobian of its velocity, [translation; rotation] in its own axes."""
        index = self.model.getFrameId(name)
        J = pinocchio.computeFrameJacobian(self.model, self.data, self._to(q), index, pinocchio.ReferenceFrame.LOCAL)
        pinocchio.framesForwardKinematics(self.model, self.data, self._to(q))
        return self.data.oMf[index].copy(), J[:, self.order].copy()

    def _to(self, vector: np.ndarray) -> np.ndarray:
        theirs = np.zeros(self.model.nq)
        theirs[self.order] = vector
        return theirs
