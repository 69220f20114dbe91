# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors for users: the executables print them as one sentence, without a traceback.

Functions that read files, or check arguments and parameters, raise them; callers pass them on.
"""


class UserError(Exception):
    """Invalid or inaccessible data and files; the executables exit with status 1."""


class UsageError(UserError):
    """Invalid arguments or parameters; the executables exit with status 2."""
