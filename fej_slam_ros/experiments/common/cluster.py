# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The workers of a Dask cluster, where the extra ``dask`` is installed."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from distributed import Client

from fej_slam_ros.errors import UserError

TIMEOUT = 10.0


@contextmanager
def dask(address: str) -> Iterator[Executor]:
    """
    Provide the workers of the scheduler at an address; they must have this package installed.

    Raises
    ------
    UserError
        No scheduler answers there.

    """
    try:
        client = Client(address, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise UserError(f'no Dask scheduler answers at {address}: {error}') from error
    # Not pure: nobody else asks for the same run, so there is no need to tell runs by content.
    with client, client.get_executor(pure=False) as executor:
        yield executor
