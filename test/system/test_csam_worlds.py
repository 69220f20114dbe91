# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joint maps of the paper's two experiments equal those of GTSAM, in any frame."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam import base_node
from fej_slam_ros.core.csam.base_node import align
from fej_slam_ros.core.csam.map_merging import join_maps
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.rendezvous_alignment import alignment_window
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.experiments.andersson import experiment
from helpers.csam import in_another_frame, rendezvous_of
from helpers.slow import slow


@pytest.mark.parametrize('world', [slow('map_joining'), 'sensor_extension'])
def test_the_joint_map_and_all_covariances_are_those_of_gtsam(world):
    gtsam_reference = pytest.importorskip(
        'helpers.gtsam_reference', reason='gtsam is not installed')
    joint = experiment.solve(experiment.CsamTask(world, 1)).joint

    reference = gtsam_reference.Reference(joint.problem, joint.values)

    gtsam_reference.assert_is_minimum(joint, reference)


@pytest.mark.slow
@pytest.mark.parametrize(('world', 'frames'), [('map_joining', 1000), ('sensor_extension', 100)])
@pytest.mark.parametrize('reach', [30.0, 1000.0])
def test_maps_in_any_frame_are_aligned_correctly_in_ten_iterations(
    monkeypatch, world, frames, reach
):
    solved = experiment.solve(experiment.CsamTask(world, 2))
    window = alignment_window(solved.measurements)
    expected = align(*rendezvous_of(solved.maps, window)).base_node.pose
    rng = np.random.default_rng(5)
    monkeypatch.setattr(base_node, 'MAX_ALIGNMENT_ITERATIONS', 10)
    for _ in range(frames):
        frame = rng.uniform([-reach, -reach, -np.pi], [reach, reach, np.pi])
        maps = [solved.maps[0], in_another_frame(solved.maps[1], frame)]

        aligned = align(*rendezvous_of(maps, window))

        # The start of Q; at 1 km a rounding error of the heading moves it by 1e-13 m.
        assert_allclose(compose(aligned.base_node.pose, frame), expected, atol=1e-7)


@pytest.mark.parametrize('reach', [slow(30.0), 1000.0])
def test_the_joint_map_does_not_depend_on_the_frames(reach):
    solved = experiment.solve(experiment.CsamTask('map_joining', 2))
    rng = np.random.default_rng(6)
    for _ in range(5):
        frame = rng.uniform([-reach, -reach, -np.pi], [reach, reach, np.pi])
        p, q = solved.maps[0], in_another_frame(solved.maps[1], frame)

        (joint,), failed, *_ = join_maps([*map(JointMap.of, (p, q))], solved.measurements)

        assert failed == []
        assert joint.landmarks == solved.joint.landmarks
        assert_allclose(
            compose(joint.base_nodes(joint.information())['q'].pose, frame),
            joint.values.poses[joint.first_poses['q']], atol=1e-8)
        assert_allclose(joint.values.poses, solved.joint.values.poses, atol=1e-7)
