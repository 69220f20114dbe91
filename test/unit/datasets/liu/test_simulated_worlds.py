# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The worlds of the paper are read exactly, or rejected with the reason."""

import re

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.io import loadmat, savemat

from fej_slam_ros.datasets.liu.simulated_worlds import file_of, read
from fej_slam_ros.errors import UsageError, UserError

CONFIGURATIONS = [(environment, n) for environment in (1, 2) for n in (20, 60, 100)]

#: A world that was made up: poses at steps 0 to 2, and landmarks by ids that are not in order.
POSES = {
    'R1': np.array([[0.0, 0.5, -0.25], [1.0, 2.0, 3.0], [-4.0, 5.0, -3.0]]),
    'R2': np.array([[7.0, 8.0, 0.125], [9.0, -1.0, 0.75], [2.5, 3.5, 1.5]])}
LANDMARKS = {4: [1.5, -2.5], 2: [30.0, 40.0], 9: [-6.0, 0.0]}


def stacked(values):
    """Return rows (name, value) of values by their names, each in turn."""
    return np.array([[name, number] for name, row in values for number in row], dtype=float)


def variables(**changes):
    """Return what the file of this world holds, but for the changes; None leaves out."""
    found = {'XfTrueAll': stacked(LANDMARKS.items())}
    for robot, rows in POSES.items():
        found[f'{robot}XrTrue'] = stacked(enumerate(rows[:, :2]))
        found[f'{robot}XphiT'] = stacked(enumerate(rows[:, 2:]))
    return {name: value for name, value in {**found, **changes}.items() if value is not None}


def changed(name, index, value):
    """Return a variable of the world with one of its numbers changed."""
    array = variables()[name].copy()
    array[index] = value
    return {name: array}


def cut(name, rows):
    """Return a variable of the world without its last rows."""
    return {name: variables()[name][:-rows]}


def write(folder, environment, landmarks, content):
    savemat(folder / f'MT_Parameters_{landmarks}fea_{environment}.mat', content)


def test_a_world_is_its_poses_by_step_and_its_landmarks_by_id(tmp_path):
    write(tmp_path, 2, 60, variables())

    world = read(tmp_path, 2, 60)

    assert {robot: poses.tolist() for robot, poses in world.poses.items()} == {
        'r1': POSES['R1'].tolist(), 'r2': POSES['R2'].tolist()}
    assert {id_: point.tolist() for id_, point in world.landmarks.items()} == LANDMARKS


def test_only_environment_1_with_20_landmarks_has_its_headings_elsewhere(tmp_path):
    for environment, landmarks in CONFIGURATIONS:
        headings = stacked((step, [0.01 * landmarks + step]) for step in range(3))
        write(tmp_path, environment, landmarks, variables(R1XphiT=headings, R2XphiT=headings))

    for environment, landmarks in CONFIGURATIONS:
        first = 0.6 if (environment, landmarks) == (1, 20) else 0.01 * landmarks
        for robot, poses in read(tmp_path, environment, landmarks).poses.items():
            assert poses[:, :2].tolist() == POSES[robot.upper()][:, :2].tolist()
            assert poses[:, 2].tolist() == [first, first + 1, first + 2]


@pytest.mark.parametrize(('wrong', 'reason'), [
    ({'XfTrueAll': None, 'R2XphiT': None}, 'it lacks the variables R2XphiT, XfTrueAll'),
    (dict.fromkeys(variables()),
     'it lacks the variables R1XrTrue, R1XphiT, R2XrTrue, R2XphiT, XfTrueAll'),
    ({'R1XphiT': np.zeros((3, 3))}, 'R1XphiT is not a matrix of 2 columns'),
    ({'R2XrTrue': np.zeros((6, 1))}, 'R2XrTrue is not a matrix of 2 columns'),
    ({'XfTrueAll': 'text'}, 'XfTrueAll is not a matrix of 2 columns'),
    ({'R1XrTrue': np.array([[{}, {}]])}, 'R1XrTrue is not a matrix of 2 columns'),
    (cut('XfTrueAll', 1), '5 rows are no multiple of 2 coordinates'),
    ({'XfTrueAll': np.zeros((0, 2))}, 'XfTrueAll is not a matrix of 2 columns'),
    (changed('XfTrueAll', (3, 0), 5.0), 'rows that belong together name different'),
    (changed('R1XrTrue', (1, 0), 1.0), 'rows that belong together name different'),
    (changed('R2XrTrue', ([4, 5], 0), 3.0), 'its steps are not numbered 0, 1 and so on'),
    (changed('R1XrTrue', ([2, 3], 0), 0.0), 'its steps are not numbered 0, 1 and so on'),
    (changed('R2XphiT', (0, 0), 1.0), 'its steps are not numbered 0, 1 and so on'),
    (cut('R1XrTrue', 2), 'its steps are not numbered 0, 1 and so on'),
    (cut('R2XphiT', 1), 'its steps are not numbered 0, 1 and so on'),
    ({**cut('R1XrTrue', 4), **cut('R1XphiT', 2)}, 'its steps are not numbered 0, 1 and so on'),
    (changed('R1XphiT', (2, 1), np.nan), 'a value is not finite'),
    (changed('XfTrueAll', (0, 1), np.inf), 'a value is not finite'),
])
def test_a_foreign_or_damaged_file_is_rejected_with_the_reason(tmp_path, wrong, reason):
    write(tmp_path, 2, 20, variables(**wrong))

    with pytest.raises(UserError) as rejected:
        read(tmp_path, 2, 20)

    path = re.escape(str(file_of(tmp_path, 2, 20)))
    assert re.fullmatch(rf'{path}: {reason}.*; fetch the file again', str(rejected.value))


@pytest.mark.parametrize(
    'content', [b'', b'landmarks,x,y\n1,2,3\n', bytes(500)], ids=['empty', 'text', 'zeros'])
def test_a_file_in_another_format_is_rejected(tmp_path, content):
    path = file_of(tmp_path, 1, 100)
    path.write_bytes(content)

    # For scipy 1.11, zeros are a MATLAB file without variables.
    with pytest.raises(UserError, match=r'cannot be read as a MATLAB file|lacks') as rejected:
        read(tmp_path, 1, 100)

    assert str(rejected.value).startswith(f'{path}: ')
    assert '\n' not in str(rejected.value)


@pytest.mark.parametrize(('present', 'missing'), [(60, 20), (20, 60)])
def test_a_missing_file_is_named_with_its_folder(tmp_path, present, missing):
    write(tmp_path, 1, present, variables())

    # The headings among 20 are in the file of 60.
    with pytest.raises(UserError) as rejected:
        read(tmp_path, 1, 20)

    assert str(rejected.value) == (
        f"{tmp_path} holds no MT_Parameters_{missing}fea_1.mat: put the files of the paper's"
        ' authors there, or omit --data to use the worlds of this package')


def test_a_missing_folder_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match=r'^no folder .*nowhere: give the one with the MT_'):
        read(tmp_path / 'nowhere', 1, 20)


# What follows needs the published data.

@pytest.fixture(scope='module')
def folder(data):
    return data / 'fej_ekf_paper'


def in_frame_of(poses, points):
    """Return C^T (f - p), eq. (7) of [Liu], of each pose (m, 3) and its point (m, 2)."""
    x, y = (points - poses[:, :2]).T
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack([c * x + s * y, c * y - s * x])


def observations(folder, environment, landmarks, robot):
    """Return the authors' observations without noise: step and id (m, 2), z (m, 2)."""
    content = loadmat(file_of(folder, environment, landmarks))
    rows = content[f'{robot.upper()}ObsT'].reshape(-1, 2, 3)
    return rows[:, 0, :2].astype(int), rows[:, :, 2]


@pytest.mark.parametrize('robot', ['r1', 'r2'])
@pytest.mark.parametrize(('environment', 'landmarks'), CONFIGURATIONS[1:])
def test_robots_have_the_measurements_of_the_authors(folder, environment, landmarks, robot):
    world = read(folder, environment, landmarks)
    poses = world.poses[robot]
    odometry = loadmat(file_of(folder, environment, landmarks))[f'{robot.upper()}OdoT']
    of_step, z = observations(folder, environment, landmarks, robot)
    seen = np.array([world.landmarks[id_] for _, id_ in of_step])

    u = np.column_stack([in_frame_of(poses[:-1], poses[1:, :2]), np.diff(poses[:, 2])])

    # Rounding at coordinates of some 50 m.
    assert_allclose(u, odometry[:, 2].reshape(-1, 3), rtol=0, atol=1e-13)
    assert_allclose(in_frame_of(poses[of_step[:, 0]], seen), z, rtol=0, atol=1e-13)


@pytest.mark.parametrize('robot', ['r1', 'r2'])
@pytest.mark.parametrize(('environment', 'landmarks'), CONFIGURATIONS)
def test_landmarks_within_15_m_are_in_view(folder, environment, landmarks, robot):
    world = read(folder, environment, landmarks)
    of_step, _ = observations(folder, environment, landmarks, robot)

    in_range = [
        [step, id_] for step, pose in enumerate(world.poses[robot])
        for id_, point in sorted(world.landmarks.items()) if np.hypot(*(point - pose[:2])) <= 15.0]

    assert in_range == of_step.tolist()


def test_the_world_of_environment_1_with_20_landmarks_is_that_of_the_authors_stored_run(folder):
    world = read(folder, 1, 20)
    stored = np.load(folder / 'exact_env1_20.npz')

    for robot, poses in world.poses.items():
        name = robot.upper()
        assert poses[:, :2].ravel().tolist() == stored[f'{name}XrTrue'][:, 1].tolist()
        assert poses[:, 2].tolist() == stored[f'{name}XphiT'][:, 1].tolist()
    points = np.array([world.landmarks[i + 1] for i in range(20)])
    assert points.ravel().tolist() == stored['XfTrueAll'][:, 1].tolist()
