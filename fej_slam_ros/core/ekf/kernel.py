# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Choice of the kernel: the compiled one where it was built, else numpy.

Both compute the same within rounding, so results are repeatable bit for bit within each. The
environment variable FEJ_SLAM_KERNEL, ``numpy`` or ``compiled``, overrides the choice.
"""

from importlib import import_module
from importlib.util import find_spec
import os
from typing import cast, Protocol

from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.errors import UsageError

VARIABLE = 'FEJ_SLAM_KERNEL'
PACKAGE = __name__.rpartition('.')[0]


class MatrixKernel(Protocol):
    """Functions for matrices of the size of the state."""

    PRODUCTS: str

    def diagonal_block(self, lower: Array, start: int, size: int) -> Array:
        """Return the symmetric block of a variable."""

    def settle(self, lower: Array, n: int, start: int, Phi: Array, block: Array) -> None:
        """Apply a transition to the cross-covariances of a variable."""

    def columns(self, lower: Array, indices: Indices) -> Array:
        """Return full columns of a symmetric matrix."""

    def replace_columns(self, lower: Array, indices: Indices, full: Array) -> None:
        """Replace full columns of a symmetric matrix."""

    def product(self, A: Array, B: Array) -> Array:
        """Return A B."""

    def subtract_product(self, lower: Array, W: Array, n: int) -> None:
        """Subtract W W^T from a triangle in place."""


class Kernel(MatrixKernel, Protocol):
    """Functions of a kernel; `numpy_kernel` describes them."""

    NAME: str
    STORAGE_GROWTH: float

    def moved(self, x: Array, u: Array, Q: Array) -> tuple[Array, Array]:
        """Return f(x, u) and G Q G^T."""

    def Phi(self, x: Array, x_next: Array) -> Array:
        """Return the transition of a pose error between two poses."""

    def propagated(
        self, before: Array | None, block: Array, Phi: Array, N: Array
    ) -> tuple[Array, Array]:
        """Return the product of transitions and the diagonal block after the last."""

    def stacked(
        self, observers: list[int], observed: list[int], z: list[Array], R: list[Array]
    ) -> tuple[Indices, Array, Array]:
        """Return observations and the states that they depend on as arrays."""

    def h(self, x: Array) -> Array:
        """Return the predicted observations."""

    def H(self, x: Array) -> Array:
        """Return their Jacobians."""

    def project(
        self, lower: Array, n: int, observed: Indices, blocks: Array, R: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return columns of P, H, S = H P H^T + R and its diagonal blocks."""

    def squared_distances(self, r: Array, S: Array) -> Array:
        """Return the squared Mahalanobis distance of each observation."""

    def correction(
        self, P: Array, H: Array, S: Array, r: Array, n: int
    ) -> tuple[Array, Array, Array, float]:
        """Return K r, L^-1 r, P H^T L^-T and log det S."""

    def retracted(self, x: Array, dx: Array, headings: Indices) -> Array:
        """Return x + dx with wrapped headings."""


def load(name: str) -> Kernel:
    """Return a kernel by its name, by default the fastest that is installed."""
    built = ['compiled', 'numpy'] if find_spec(f'{PACKAGE}._kernel') else ['numpy']
    if name and name not in built:
        raise UsageError(f'{VARIABLE} is {name}; installed here: {", ".join(built)}')
    return cast(Kernel, import_module(f'{PACKAGE}.{name or built[0]}_kernel'))


KERNEL = load(os.environ.get(VARIABLE, ''))
