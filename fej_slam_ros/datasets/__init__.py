# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Published data sets: files to records and settings.

A data set has a reader, ``read(path)``, which returns the content of the files as arrays; if a
file is missing, damaged or of another data set, it raises a `UserError` that names the file. And
it has a converter: ``records(log, ...)`` yields records in the order of stamps, ``settings(log,
...)`` returns the `Settings` of a run on them. The verb ``convert`` (``cli/converters``) writes
both as a bag and a parameter file. To add a data set, write these three.

==========================  ================================  =================================
data set                    reader                            converter
==========================  ================================  =================================
Victoria Park, associated   ``victoria_park/associated_log``  ``victoria_park/associated_log``
Victoria Park, raw          ``victoria_park/raw_log``         ``victoria_park/raw_conversion``
MRCLAM                      ``mrclam/files``                  ``mrclam/conversion``, settings in
                                                              ``mrclam/run_settings``
==========================  ================================  =================================

`liu` reads the files of the authors of [Liu] for the experiments; it has no records.
"""
