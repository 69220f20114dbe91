# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The experiments of the papers and others on real data: one module a table or figure.

An experiment module lists its tasks and runs one of them; ``common.executor`` runs them in worker
processes. A report module (or the same one) has ``markdown``, ``csv_rows`` and ``summary``, for
the page, the CSV and the JSON file of the results; a figure module draws them.
"""
