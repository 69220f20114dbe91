# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results that are computed once per run of the tests, whichever worker process needs them."""

import fcntl
import os
import pickle


def computed_once(tmp_path_factory, name, compute):
    """Return the result of `compute`, which the first of several processes calls."""
    folder = tmp_path_factory.getbasetemp()
    if 'PYTEST_XDIST_WORKER' in os.environ:
        folder = folder.parent  # of all workers
    path = folder / f'{name}.pickle'
    with path.with_suffix('.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            path.write_bytes(pickle.dumps(compute()))
    return pickle.loads(path.read_bytes())  # noqa: S301, written above
