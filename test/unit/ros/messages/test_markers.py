# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers show robots, maps and detected landmarks as documented."""

from math import pi

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.ros.messages import markers
from helpers.ros import through_cdr

MARKER = ros.visualization_msgs__msg__Marker
P = np.diag([0.04, 0.01, 0.09])


def estimate(stamp=1_500_000_000, pose=(1.0, 2.0, pi / 2), frame='map', robot='r1', P=P):
    return PoseEstimate(robot, stamp, frame, np.array(pose), P)


def picture(robots=(), maps=()):
    """Return the markers of robots (estimate, path), after the one that deletes, and of maps."""
    placed = [(k, now, np.array(way)) for k, (now, way) in enumerate(robots)]
    return through_cdr(markers.markers(0, placed, maps, 'map')).markers[1:]


def colours_of(drawn):
    return {(m.color.r, m.color.g, m.color.b) for m in drawn}


WAY = [(0.0, 0.0, 0.0), (1.0, 2.0, pi / 2)]
#: Joined, not joined, joined.
TEAM = [
    (estimate(robot=robot, frame=frame), WAY)
    for robot, frame in (('r1', 'map'), ('r2', 'r2/map'), ('r3', 'map'))]
MAPS = [
    (frame, np.array([[1.0, 2.0]]), np.eye(2)[None]) for frame in ('map', 'r2/map')]


def test_markers_start_with_deleteall():
    first, *others = through_cdr(markers.markers(0, [], MAPS, 'map')).markers

    assert first.action == MARKER.DELETEALL
    assert {m.action for m in others} == {MARKER.ADD}


def test_robots_have_arrow_name_path_and_ellipse_and_landmarks_dot_and_ellipse():
    drawn = picture(TEAM[:1], MAPS[:1])

    assert [(m.ns, m.type) for m in drawn] == [
        ('robots', MARKER.ARROW), ('names', MARKER.TEXT_VIEW_FACING),
        ('paths', MARKER.LINE_STRIP), ('robot_ellipses', MARKER.CYLINDER),
        ('landmarks', MARKER.POINTS), ('landmark_ellipses', MARKER.CYLINDER)]
    assert [m.text for m in drawn if m.text] == ['r1']
    assert [(p.x, p.y) for m in drawn for p in m.points] == [(0.0, 0.0), (1.0, 2.0), (1.0, 2.0)]


def test_every_marker_has_a_unique_name():
    drawn = picture(TEAM, MAPS)

    assert len({(m.ns, m.id) for m in drawn}) == len(drawn) == 3 * 4 + 2 * 2


def test_each_robot_in_map_has_its_own_colour_and_landmarks_another():
    drawn = [
        m for m in picture(TEAM, MAPS) if m.header.frame_id == 'map' and m.ns != 'names']

    assert len(colours_of(m for m in drawn if 'landmark' not in m.ns)) == 2
    assert len(colours_of(drawn)) == 3


def test_frames_that_have_not_joined_are_grey_and_can_be_hidden():
    drawn = picture(TEAM, MAPS)

    apart = [m for m in drawn if m.header.frame_id == 'r2/map']
    (red, green, blue), = colours_of(apart)
    assert red == green == blue
    assert all(m.ns.startswith('r2/map ') for m in apart)
    assert not colours_of(apart) & colours_of(m for m in drawn if m.header.frame_id == 'map')


def test_a_path_of_one_pose_is_not_drawn_as_rviz_rejects_it():
    assert 'paths' not in {m.ns for m in picture([(estimate(), WAY[:1])])}


@pytest.mark.parametrize('seed', range(5))
def test_an_ellipse_has_half_axes_of_three_sigmas(seed):
    factor = np.random.default_rng(seed).normal(size=(2, 2))
    covariance = factor @ factor.T
    variances, axes = np.linalg.eigh(covariance)

    ellipse = picture(maps=[('map', np.array([[5.0, 6.0]]), covariance[None])])[-1]

    q = ellipse.pose.orientation
    heading = 2.0 * np.arctan2(q.z, q.w)
    np.testing.assert_allclose(
        (ellipse.scale.x / 2.0, ellipse.scale.y / 2.0), 3.0 * np.sqrt(variances[::-1]),
        rtol=1e-12)
    assert (ellipse.pose.position.x, ellipse.pose.position.y) == (5.0, 6.0)
    # The long axis lies along its eigenvector, in one direction or the other.
    along = abs(axes[:, 1] @ (np.cos(heading), np.sin(heading)))
    assert along == pytest.approx(1.0, rel=1e-12)


def test_a_detected_landmark_is_a_disc_of_its_radius_with_an_ellipse_and_a_name():
    first, disc, ellipse, name = through_cdr(markers.detection_markers(
        0, 'base', np.array([[1.0, 2.0]]), np.diag([4e-4, 1e-4])[None], np.array([0.2]),
        ['post'])).markers

    assert first.action == MARKER.DELETEALL
    assert (disc.ns, disc.pose.position.x, disc.scale.x) == ('base detections', 1.0, 0.4)
    assert (name.type, name.text, name.pose.position.x) == (MARKER.TEXT_VIEW_FACING, 'post', 1.0)
    # Three sigmas to each side.
    assert sorted([ellipse.scale.x, ellipse.scale.y]) == pytest.approx([0.06, 0.12], rel=1e-12)
