# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Values of poses and landmarks, and the measurements between them.

Poses and landmarks are indexed from 0; the robot that a pose belongs to does not matter.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.geometry import (
    Array, Indices, inverse, transform, transform_poses, wrap_all)


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """Poses (n, 3) [m, m, rad] and landmarks (l, 2) [m] in one frame, each by index."""

    poses: Array
    points: Array

    def in_frame_of(self, pose: Array) -> 'Values':
        """Return the values in the frame of a pose (3,) that is given in the present one."""
        back = inverse(pose)
        return Values(transform_poses(back, self.poses), transform(back, self.points))


@dataclass(frozen=True, slots=True, eq=False)
class Factors(ABC):
    """m measurements, each from a pose to a target: a pose, or for some kinds a landmark."""

    DIMENSION: ClassVar[int] = 2

    #: pose, target: (m,) arrays, indices of the poses and of the targets
    pose: Indices
    target: Indices
    z: Array  #: (m, d) array, the target in the frame of the pose [m, (m, rad)]
    R: Array  #: (d, d) or (m, d, d) array, covariance of z

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the two variables (m,) of each factor; landmarks are counted after the poses."""
        return self.pose, self.target

    @abstractmethod
    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return the Jacobian H (m, d, c) with respect to the two nodes, and the residual r."""


class OdometryFactors(Factors):
    """Odometry increments u to a later pose with covariance Q."""

    __slots__ = ()
    DIMENSION = 3

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 3, 6) and r (m, 3)."""
        begin, end = x.poses[self.pose], x.poses[self.target]
        r = self.z - np.column_stack([models.h(begin, end[:, :2]), end[:, 2] - begin[:, 2]])
        r[:, 2] = wrap_all(r[:, 2])
        return models.H_pose(begin, end), r


class LandmarkFactors(Factors):
    """Observations of landmarks."""

    __slots__ = ()

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the pose and the landmark of each factor."""
        return self.pose, poses + self.target

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 5) and r (m, 2), eqs. (13), (16) and (17) of [Andersson]."""
        poses, points = x.poses[self.pose], x.points[self.target]
        return models.H(poses, points), self.z - models.h(poses, points)


class RendezvousFactors(Factors):
    """Robot-to-robot observations of the position of a pose."""

    __slots__ = ()

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 6) and r (m, 2), eqs. (22) and (23) of [Andersson]."""
        poses, observed = x.poses[self.pose], x.poses[self.target]
        return models.H_pose(poses, observed)[:, :2], self.z - models.h(poses, observed[:, :2])


#: A kind of factors, and pose, target, z and R of one of them.
FactorsT = TypeVar('FactorsT', bound=Factors)
Row = tuple[int, int, Array, Array]


def stacked(kind: type[FactorsT], rows: Iterable[Row]) -> FactorsT:
    """Return factors of one kind from their rows."""
    rows, d = [*rows], kind.DIMENSION
    return kind(
        np.array([row[0] for row in rows], np.intp), np.array([row[1] for row in rows], np.intp),
        np.array([row[2] for row in rows]).reshape(-1, d),
        np.array([row[3] for row in rows]).reshape(-1, d, d))


def shifted(factors: FactorsT, poses: int) -> FactorsT:
    """Return factors between poses whose indices are larger by a number of poses."""
    return replace(factors, pose=factors.pose + poses, target=factors.target + poses)


def concatenated(*parts: FactorsT) -> FactorsT:
    """Return factors of one kind as one, in the same order, with one covariance each."""
    R = [np.broadcast_to(part.R, (len(part.z), *part.R.shape[-2:])) for part in parts]
    return type(parts[0])(
        np.concatenate([part.pose for part in parts]),
        np.concatenate([part.target for part in parts]),
        np.concatenate([part.z for part in parts]), np.concatenate(R))


def rows_of(factors: FactorsT, rows: Indices) -> FactorsT:
    """Return some of the factors, with one covariance each."""
    R = np.broadcast_to(factors.R, (len(factors.z), *factors.R.shape[-2:]))
    return replace(
        factors, pose=factors.pose[rows], target=factors.target[rows], z=factors.z[rows],
        R=R[rows])


def whitener(R: Array) -> Array:
    """
    Return L^-1 of the covariance R = L L^T, one (d, d) or several (k, d, d).

    Raises
    ------
    SingularError
        If a covariance is not positive definite within rounding.

    """
    try:
        L = np.linalg.cholesky(R)
    except np.linalg.LinAlgError:
        raise SingularError('the covariance of a measurement is singular') from None
    # numpy 1.26 takes a single identity for vectors where R is a stack.
    return np.linalg.solve(L, np.broadcast_to(np.eye(R.shape[-1]), R.shape))


def whitened(L_inv: Array, H: Array, r: Array) -> tuple[Array, Array]:
    """Return A = L^-1 H and b = L^-1 r of Jacobians (m, d, c) and residuals (m, d)."""
    return L_inv @ H, (L_inv @ r[:, :, None])[:, :, 0]
