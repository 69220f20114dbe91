# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Limits of this machine, and the times that are compared with them.

The limit of a step with n states and m observations is the rank-2m update of one triangle by BLAS,
limited by arithmetic or by memory: max(2 m n (n + 1) / F, 8 n (n + 1) / B), with the flop/s F of
dsyrk and the memory bandwidth B. A kernel that computes products faster than BLAS is below it.
"""

from collections.abc import Callable, Sequence
import ctypes
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
import platform
from time import perf_counter

import numpy as np
from scipy.linalg.blas import dsyrk

from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.ros.session.percentiles import percentiles

#: Maximum ratio of the machine's limits within a run; a run with more drift is invalid.
MAX_DRIFT = 1.3
#: Number of states and observations of the update that measures F.
UPDATE_STATES, UPDATE_OBSERVATIONS = 1000, 10
#: Names of the function that returns the processor type, in different builds of OpenBLAS.
CORE_NAMES = 'openblas_get_corename', 'scipy_openblas_get_corename'


@dataclass(frozen=True)
class Machine:
    """Floating-point operations of dsyrk and bytes of memory per second."""

    flops: float
    bandwidth: float

    def limit(self, n: int, m: int) -> float:
        """Return the least time [s] of an update of n states with m observations by BLAS."""
        triangle = n * (n + 1)
        return max(2.0 * m * triangle / self.flops, 8.0 * triangle / self.bandwidth)


@dataclass(frozen=True)
class Times:
    """Distribution of step times [s]."""

    median: float
    mean: float
    p99: float
    longest: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> 'Times':
        """Return the distribution of some times."""
        times = percentiles(np.array(seconds))
        return cls(times.median, float(np.mean(seconds)), times.p99, times.longest)


def measure_machine() -> Machine:
    """Measure dsyrk with the shapes of an update, and a copy far larger than the caches."""
    n, k = UPDATE_STATES, 2 * UPDATE_OBSERVATIONS
    C, A = np.zeros((n, n), order='F'), np.ones((n, k), order='F')
    update = best(lambda: dsyrk(-1.0, A, beta=1.0, c=C, lower=1, overwrite_c=1))
    source = np.ones(8_000_000)
    target = np.empty_like(source)
    copy = best(lambda: np.copyto(target, source))
    return Machine(n * (n + 1) * k / update, 2 * source.nbytes / copy)


def drift(measured: Sequence[Machine]) -> tuple[float, float]:
    """Return the ratios of the largest to the smallest F and B."""
    F, B = [m.flops for m in measured], [m.bandwidth for m in measured]
    return max(F) / min(F), max(B) / min(B)


def fastest(measured: Sequence[Machine]) -> Machine:
    """Return the highest measured F and B, those of the machine without other load."""
    return Machine(max(m.flops for m in measured), max(m.bandwidth for m in measured))


def best(call: Callable[[], object], repetitions: int = 20) -> float:
    """Return the shortest time of some calls, that of a machine without other load."""
    times = []
    for _ in range(repetitions):
        begin = perf_counter()
        call()
        times.append(perf_counter() - begin)
    return min(times)


def versions() -> dict[str, str]:
    """Return the processor and the versions that the times depend on."""
    packages = [name for name in ('numpy', 'scipy', 'gtsam') if find_spec(name)]
    return {
        'processor': _processor(), 'BLAS core': _blas_core(), 'kernel': KERNEL.NAME,
        'products': KERNEL.PRODUCTS,
        'python': platform.python_version(), **{name: version(name) for name in packages}}


def _processor() -> str:
    for line in Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines():
        if line.startswith('model name'):
            return line.partition(':')[2].strip()
    return platform.machine()


def _blas_core() -> str:
    """Return the processor type for which the BLAS of scipy has chosen its kernels."""
    loaded = {line.split()[-1] for line in Path('/proc/self/maps').read_text().splitlines()}
    for library in map(ctypes.CDLL, sorted(path for path in loaded if 'openblas' in path)):
        for core_name in (getattr(library, name, None) for name in CORE_NAMES):
            if core_name is not None:
                core_name.restype = ctypes.c_char_p
                return str(core_name().decode())
    return 'unknown'
