# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The errors that a user can meet; the executables print their one sentence and no traceback."""


class UserError(Exception):
    """A mistake of the user's or of the data: bad arguments, files or values."""


class UsageError(UserError):
    """A mistake in arguments or parameters: the executables end with status 2 instead of 1."""
