# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo runs on a Dask cluster, if the extra ``dask`` is installed."""

from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager

from distributed import Client, KilledWorker

from fej_slam_ros.errors import UserError

#: Time limit of the connection to the scheduler [s].
CONNECTION_TIMEOUT = 10.0


@contextmanager
def dask(address: str) -> Iterator[Executor]:
    """
    Provide the workers of the scheduler at an address; they must have this package installed.

    Dask repeats a run whose worker ends on another one. If no scheduler answers, if it ends, or
    if the same run ends several workers, raise a `UserError`.
    """
    try:
        client = Client(address, timeout=CONNECTION_TIMEOUT)
    except (OSError, ValueError) as error:
        raise UserError(f'no Dask scheduler answers at {address}: {error}') from error
    # Not pure: no run is requested twice, so that results need not be identified by content.
    with client, client.get_executor(pure=False) as executor:
        try:
            yield executor
        except KilledWorker as error:
            raise UserError(
                f'a run has ended {error.allowed_failures + 1} workers of the Dask cluster: check'
                ' their memory limits') from error
        except CancelledError as error:
            raise UserError(
                f'the Dask scheduler at {address} has dropped the runs: check that it is alive'
            ) from error
