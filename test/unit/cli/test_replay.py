# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`replay`: the bits of the estimator, independence of arrival, files and error messages."""

from dataclasses import replace
from math import nan
import sys

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, Writer

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation
from helpers.records import team
from helpers.ros import (
    assert_one_sentence, cloud, decoded, meeting, ODOMETRY, odometry_message, raw, raw_record,
    run_verb, seen, summary_of, TYPES, write_bag, write_parameters)

#: Two robots, a step every 50 ms.
SIMULATED = [raw_record(record) for record in simulation.parse(
    {'loops': 1, 'steps_per_loop': 20, 'landmarks': 12, 'rate': 20}).records()]
MEETING = [raw_record(record) for record in meeting()]


@pytest.fixture
def replay(places, capsys):
    """Return a function that replays messages and returns status, output and error output."""
    bag, params, output = places

    def run(messages=MEETING, *options, storage='mcap'):
        if messages is not None:
            write_bag(bag, messages, storage)
        status = run_verb('replay', bag, '--params', params, '--output', output, *options)
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def summary(places):
    """Return a function that reads the summary of the run."""
    return lambda: summary_of(places[2])


def direct_hash(messages):
    """Return the hash of an estimator that received the records of messages."""
    estimator = Estimator(team())
    for message in messages:
        estimator.add(decoded(message), message.received)
        list(estimator.take())
    list(estimator.close())
    return estimator.state_hash()


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_replay_has_the_hash_of_the_estimator_given_the_records(replay, summary, storage):
    status, _, error = replay(SIMULATED, storage=storage)

    assert (status, error) == (0, '')
    assert summary()['state_hash'] == direct_hash(SIMULATED)
    assert summary()['counts']['used'] == len(SIMULATED) - 1  # the true map is of no robot
    assert set(summary()['rmse']) == {'r1', 'r2', 'landmarks'}


def test_replaying_again_gives_the_same_bytes(replay, places):
    replay(SIMULATED)
    first = contents(places[2])

    status, _, _ = replay(None, '--force')

    assert status == 0
    assert contents(places[2]) == first


def test_each_pass_of_a_bag_that_loops_is_a_run_in_a_folder_of_its_own(replay, places):
    _, params, output = places
    write_parameters(params, robots=['r1', 'r2'], on_time_jump='reset', stale_after=0.1)
    again = [replace(message, received=message.received + 2 * 10**9) for message in SIMULATED]

    status, _, _ = replay([*SIMULATED, *again])

    assert status == 0
    for folder in (output, output.with_name(f'{output.name}_2')):
        assert summary_of(folder)['state_hash'] == direct_hash(SIMULATED)


def by_kind(message):
    return message.received, message.topic.endswith('landmarks')


def robots_backwards(message):
    return message.received, -ord(message.topic[1])


@pytest.mark.parametrize('order', [by_kind, robots_backwards])
def test_the_order_of_arrival_within_a_stamp_does_not_matter(replay, summary, order):
    arrived = sorted(SIMULATED, key=order)

    replay(arrived)

    assert arrived != SIMULATED
    assert summary()['state_hash'] == direct_hash(SIMULATED)


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_delays_below_max_delay_do_not_matter(replay, summary, seed):
    delays = np.random.default_rng(seed).integers(0, 99_000_000, len(SIMULATED)).tolist()
    late = [replace(m, received=m.received + delay) for m, delay in zip(SIMULATED, delays)]

    replay(sorted(late, key=lambda message: message.received))

    assert summary()['state_hash'] == direct_hash(SIMULATED)
    assert (summary()['depends_on_arrival'], summary()['counts']['late']) == (False, 0)


@pytest.mark.parametrize('order', [1, -1], ids=['odometry first', 'scans first'])
@pytest.mark.parametrize(('changes', 'topics', 'reason', 'cure'), [
    ({'frame': 'camera'}, '<robot>/landmarks and <robot>/robots', '2 wrong_frame',
     'set frame_id to <robot>/base_link'),
    ({'quaternion': (0.0, 0.0, 0.0, 0.0)}, '<robot>/odom', '3 bad_quaternion', 'normalise it'),
    ({'twist_covariance': -np.eye(6)}, '<robot>/odom', '3 bad_covariance',
     'correct twist.covariance, give all zero if unknown, or set <robot>.use_odometry')])
def test_input_that_is_all_rejected_is_an_error_after_the_files_are_written(
        replay, summary, changes, topics, reason, cure, order):
    frame = {'frame': changes['frame']} if 'frame' in changes else {}
    turn = {} if frame else changes

    status, table, error = replay([
        *(odom(ms, **turn) for ms in (0, 100, 200)),
        *(scan(ms, (1, 2.0, 1.0), **frame) for ms in (100, 50))][::order])

    assert status == 1
    assert f'all {reason[0]} messages on {topics} are rejected: {reason}: {cure}' in error
    assert '; fej_slam doctor' in error
    assert 'state hash' in table
    assert summary()['counts'][reason[2:]] == int(reason[0])


def test_a_bag_of_odometry_only_is_named_with_the_check_for_it(replay, places, caplog):
    bag, params, _ = places

    status, table, _ = replay([odom(ms) for ms in (0, 100, 200)] + [scan(50)])

    assert status == 0
    assert caplog.messages[-1] == (
        f'{bag} has no observations of landmarks or robots, so all poses are those of odometry'
        f' alone: fej_slam doctor {bag} --params {params} names the cause')
    assert table.splitlines()[-1].startswith('state hash ')


def odom(ms, received=390, **fields):
    return raw('r1/odom', odometry_message(ms, **fields), received)


def scan(ms, *observations, frame=''):
    return raw('r1/landmarks', seen(*observations, ms=ms, frame=frame), 390)


NO_COVARIANCE = {'var_x': ('f8', [-1.0]), 'cov_xy': ('f8', [0.0]), 'var_y': ('f8', [1.0])}
SPILT = odometry_message(350)
NO_SCAN = cloud({'id': ('i4', [7])}, 300)
A_POINT = {'x': ('f8', [1.0]), 'y': ('f8', [1.0]), 'id': ('i4', [6])}

#: Recorded 10 ms before the last step of the meeting.
WRONG = [
    odom(350, xyz=(nan, 0.0, 0.0)),
    odom(350, xyz=(1e12, 0.0, 0.0)),
    odom(350, quaternion=(0.0, 0.0, 0.0, 0.0)),
    odom(350, quaternion=(1.0, 0.0, 0.0, 0.0)),
    odom(350, twist_covariance=-np.eye(6)),
    odom(300, xyz=(9.0, 0.0, 0.0)),
    odom(50, xyz=(9.0, 0.0, 0.0)),
    odom(5400),
    odom(0),
    raw('r1/odom', replace(SPILT, header=replace(
        SPILT.header, stamp=replace(SPILT.header.stamp, nanosec=2 * 10**9))), 390),
    replace(odom(350), raw=odom(350).raw[:100]),
    raw('r1/odom', NO_SCAN, 390),
    raw('r1/landmarks', NO_SCAN, 390),
    raw('r1/landmarks', cloud(A_POINT | NO_COVARIANCE, 200), 390),
    raw('r9/odom', odometry_message(350), 390),
    scan(300, (1, 2.0, 3.0), frame='r1/laser'),
    scan(450, (1, 2.0, 3.0)),
    scan(300, (-2, 1.0, 0.0), (5, 1.0, nan), (4, 1.0, 0.0), (4, 2.0, 0.0)),
    scan(300, (1, -9.0, 9.0)),
    raw('r1/ground_truth', odometry_message(350, quaternion=(0.0, 0.0, 2.0, 2.0)), 390),
]
COUNTED = {
    'not_finite': 2, 'out_of_range': 1, 'wrong_frame': 1, 'tilted': 1, 'bad_quaternion': 2,
    'bad_covariance': 2, 'bad_cloud': 1, 'bad_id': 1, 'bad_message': 2, 'bad_stamp': 1,
    'duplicate_id': 2, 'no_identity': 0, 'doubtful_match': 0,
    'duplicate': 1, 'conflicting': 1, 'before_odometry': 1,
    'after_odometry': 1, 'late': 1, 'before_checkpoint': 0, 'before_time_jump': 0,
    'after_time_jump': 0, 'future': 1, 'gated': 1, 'moved_landmark': 0, 'unknown_robot': 1,
    'self_sighting': 0, 'other_robot_stale': 0, 'already_located': 0, 'does_not_fit': 0,
    'not_joined': 0, 'left': 0, 'too_large': 0, 'map_full': 0, 'too_many_new': 0, 'overload': 0,
    'interrupted': 0, 'lost_robot': 0, 'impossible_motion': 0}
BEFORE = raw('r1/landmarks', seen((1, 2.0, 3.0), ms=-1), 0)


def test_invalid_input_is_counted_and_does_not_change_the_result(replay, summary):
    first, second = MEETING[:-4], MEETING[-4:]

    status, said, _ = replay([BEFORE, *first, *WRONG, *second])

    counts = summary()['counts']
    assert status == 0
    assert {name: counts[name] for name in COUNTED} == COUNTED
    assert set(COUNTED) == {reason.value for reason in RejectionReason}
    # Of the invalid input only the scan with the gated observation is used, without it.
    assert counts['used'] == len(MEETING) + 1
    assert summary()['state_hash'] == direct_hash(MEETING)
    assert 'not_finite 2' in said


def test_the_table_ends_with_the_state_hash(replay, summary):
    _, said, _ = replay(SIMULATED)

    lines = said.splitlines()
    assert [line.split()[:3] for line in lines[1:3]] == [['r1', 'map', '21'], ['r2', 'map', '21']]
    assert lines[-1] == f'state hash {summary()["state_hash"]}'


def test_the_output_topics_are_written_as_a_bag(replay, places):
    status, _, _ = replay(MEETING, '--bag')

    found = bags.topics(places[2] / 'bag')
    latched = {topic for topic, info in found.items() if info.latched}
    assert status == 0
    assert {topic: info.type_name for topic, info in found.items()} == {
        'r1/pose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
        'r2/pose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
        'r1/path': 'nav_msgs/msg/Path', 'r2/path': 'nav_msgs/msg/Path',
        'estimator/landmarks': 'sensor_msgs/msg/PointCloud2',
        'estimator/markers': 'visualization_msgs/msg/MarkerArray',
        'estimator/joint_covariance': 'std_msgs/msg/Float64MultiArray',
        'tf': 'tf2_msgs/msg/TFMessage', 'diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'}
    assert latched == {'estimator/landmarks'}
    assert (found['r1/pose'].messages, found['estimator/joint_covariance'].messages) == (5, 5)


def test_the_poses_in_the_bag_are_those_of_the_trajectory_file(replay, places):
    replay(SIMULATED, '--bag')

    with Reader(places[2] / 'bag') as reader:
        poses = [
            TYPES.deserialize_cdr(data, c.msgtype) for c, _, data in reader.messages()
            if c.topic == '/r1/pose']
    table = (places[2] / 'trajectory_r1.csv').read_text().splitlines()[1:]
    assert [
        f'{m.header.stamp.sec * 10**9 + m.header.stamp.nanosec},{m.pose.pose.position.x!r},'
        f'{m.pose.pose.position.y!r}' for m in poses
    ] == [','.join(row.split(',')[:3]) for row in table]


def test_messages_recorded_after_the_last_time_of_ros_are_used(replay, summary):
    late = [*MEETING[:4], *(replace(m, received=2**63 - 1) for m in MEETING[4:])]

    assert replay(late, '--bag')[0] == 0

    assert summary()['state_hash'] == direct_hash(MEETING)


def test_rejections_are_in_the_bag(replay, places):
    replay([*MEETING, *WRONG], '--bag')

    assert bags.topics(places[2] / 'bag')['estimator/rejections'].messages == sum(
        COUNTED.values()) - 1  # except the scan before odometry


def test_an_output_bag_is_replaced_with_force(replay, places):
    replay(MEETING, '--bag')

    status, _, _ = replay(None, '--bag', '--force')

    assert status == 0
    assert bags.topics(places[2] / 'bag')['r1/pose'].messages == 5


def test_what_stays_of_an_earlier_run_is_named(replay, places, caplog):
    replay(MEETING, '--bag')
    (places[2] / 'evaluation').mkdir()

    replay(None, '--force')

    assert f'{places[2] / "bag"} is of an earlier run and stays as it is: --bag' in caplog.text
    assert f'{places[2] / "evaluation"} is of an earlier run' in caplog.text


def test_a_bag_of_other_robots_is_reported(replay, places):
    stranger = [raw('r9/odom', odometry_message(), 0), raw('tf', seen(), 0)]

    assert_one_sentence(
        replay(stranger), 1, f'{places[0]} has messages on none of the topics r1/odom, r2/odom',
        'it has nav_msgs/msg/Odometry on /r9/odom (1) and sensor_msgs/msg/PointCloud2 on /tf (1)',
        '--remap /r9/odom:=/r1/odom', 'name its robots (r9) in the parameter robots')


def test_an_empty_bag_is_reported(replay):
    assert_one_sentence(
        replay([]), 1, 'none of the topics r1/odom, r2/odom, it has no topics: record')


def test_topics_without_messages_are_as_missing_topics(replay, places):
    with Writer(places[0], version=9) as bag:
        for robot in 'r1', 'r2':
            bag.add_connection(f'/{robot}/odom', ODOMETRY, typestore=TYPES)

    assert_one_sentence(
        replay(None), 1, 'none of the topics r1/odom, r2/odom', 'record nav_msgs/msg/Odometry on')


def text(message):
    """Return a message of another type on the topic of a message."""
    return replace(
        raw(message.topic, TYPES.types['std_msgs/msg/String'](data='')), received=message.received)


def test_a_topic_of_another_type_is_named(replay, places, summary, caplog):
    status, _, _ = replay([
        text(message) if message.topic == 'r2/landmarks' else message for message in MEETING])

    assert status == 0
    (warning,) = caplog.messages
    assert warning == (
        f'{places[0]} has r2/landmarks of the type std_msgs/msg/String, which is not used: record'
        ' sensor_msgs/msg/PointCloud2 on it, or give the topic that has it with --remap')
    assert summary()['counts']['bad_message'] > 0


def test_odometry_of_another_type_is_reported_as_none(replay):
    texts = [text(message) if message.topic.endswith('odom') else message for message in MEETING]

    assert_one_sentence(
        replay(texts), 1, 'has r1/odom of the type std_msgs/msg/String',
        'record nav_msgs/msg/Odometry on it')


def test_a_missing_bag_is_reported(replay, places):
    assert_one_sentence(replay(None), 1, f'{places[0]} does not exist')


@pytest.mark.parametrize(('name', 'fault'), [
    ('in.mcap', '/in.mcap is truncated'), ('metadata.yaml', ' cannot be read as a rosbag2')])
def test_a_damaged_bag_is_reported(replay, places, name, fault):
    damaged = write_bag(places[0], MEETING) / name
    damaged.write_bytes(damaged.read_bytes()[:-40])

    assert_one_sentence(replay(None), 1, f'{places[0]}{fault}')
    assert not places[2].exists()


def test_a_missing_parameter_file_is_reported(replay, places):
    places[1].unlink()

    assert_one_sentence(replay(), 2, f'{places[1]}: No such file or directory')


def test_an_unknown_parameter_is_a_warning_with_file_and_nearest_name(replay, places, caplog):
    write_parameters(places[1], robots=['r1'], gate_probabilty=0.9)

    status, _, _ = replay()

    assert status == 0
    nearest = "did you mean 'gate_probability'?"
    assert caplog.messages == [
        f"{places[1]}: unknown parameter 'gate_probabilty' is ignored: {nearest}"]


def test_strict_parameters_refuse_an_unknown_one(replay, places):
    write_parameters(places[1], robots=['r1'], gate_probabilty=0.9, strict_parameters=True)

    assert_one_sentence(
        replay(), 2, f"{places[1]}: unknown parameter 'gate_probabilty'",
        "did you mean 'gate_probability'?")


def test_results_are_not_overwritten_without_force(replay, places):
    replay()
    before = contents(places[2])

    assert_one_sentence(replay(None), 2, 'summary.json exists', '--force')
    assert contents(places[2]) == before


def test_an_output_bag_is_not_overwritten_without_force(replay, places):
    (places[2] / 'bag').mkdir(parents=True)

    assert_one_sentence(replay(MEETING, '--bag'), 2, f'{places[2] / "bag"} exists', '--force')


@pytest.mark.parametrize('options', [[], ['--picture']])
def test_a_picture_is_neither_overwritten_nor_deleted_without_force(replay, places, options):
    if options:
        pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    picture = places[2] / 'scene.png'
    places[2].mkdir()
    picture.write_text('of an earlier run')

    assert_one_sentence(replay(MEETING, *options), 2, f'{picture} exists', '--force')
    assert contents(places[2]) == {'scene.png': b'of an earlier run'}


def test_a_file_as_output_is_a_wrong_argument(replay, places):
    places[2].write_text('')

    assert_one_sentence(replay(), 2, f'{places[2]} is a file: choose a folder for the results')


def test_a_filter_without_its_ground_truth_is_reported_and_leaves_no_results(replay, places):
    write_parameters(places[1], robots=['r1', 'r2'], filter='ideal')

    assert_one_sentence(replay(MEETING, '--bag'), 1, 'no ground truth of r1', 'another filter')
    assert not places[2].exists()


def test_the_input_bag_is_never_replaced(tmp_path):
    write_bag(bag := tmp_path / 'bag', MEETING)
    params = write_parameters(tmp_path / 'params.yaml', robots=['r1', 'r2'])
    before = contents(bag)

    words = bag, '--params', params, '--output', tmp_path, '--bag', '--force'

    assert run_verb('replay', *words) == 2
    assert contents(bag) == before


def test_a_bag_is_no_folder_for_results(places):
    bag, params, _ = places
    write_bag(bag, MEETING)
    before = contents(bag)

    assert run_verb('replay', bag, '--params', params, '--output', bag, '--force') == 2
    assert contents(bag) == before


def test_an_empty_output_is_not_the_current_folder(places, tmp_path, monkeypatch):
    bag, params, _ = places
    write_bag(bag, MEETING)
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)

    assert run_verb('replay', bag, '--params', params, '--output', '') == 2
    assert contents(tmp_path) == before


def test_an_interrupted_replay_leaves_no_results(replay, places, monkeypatch):
    def interrupted(_bag, _names):
        yield from MEETING[:-1]
        raise KeyboardInterrupt

    monkeypatch.setattr(bags, 'read', interrupted)

    status, said, error = replay(MEETING, '--bag')

    assert (status, said, error) == (130, '', '')
    assert not places[2].exists()


@pytest.mark.parametrize('options', [['--forse'], ['--for'], ['--bag', 'x', 'y'], ['--params']])
def test_bad_arguments_end_with_status_2(replay, options):
    assert replay(MEETING, *options)[0] == 2


def test_a_picture_of_the_estimates_is_drawn_on_request(replay, places):
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')

    assert replay(MEETING, '--picture')[0] == 0

    picture = places[2] / 'scene.png'
    assert picture.read_bytes().startswith(b'\x89PNG')
    assert replay(None, '--force')[0] == 0
    assert not picture.exists()


def test_a_picture_without_matplotlib_is_refused_before_the_run(replay, places, monkeypatch):
    monkeypatch.setitem(sys.modules, 'matplotlib', None)

    assert_one_sentence(replay(MEETING, '--picture'), 1, 'matplotlib', '--picture')

    assert not places[2].exists()
