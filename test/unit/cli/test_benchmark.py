# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`benchmark` reports all measurements as tables and as JSON."""

import json
import struct
import sys

import pytest

from fej_slam_ros.benchmark import matching_speed, run_speed, smoother_speed
from fej_slam_ros.benchmark.machine import Machine, Times
from fej_slam_ros.benchmark.peers import OURS, PeerTime
from fej_slam_ros.benchmark.step_speed import CompressedTime, StepTime
from fej_slam_ros.benchmark.tables import report
from fej_slam_ros.cli import benchmark
from fej_slam_ros.cli.main import main

MACHINE = Machine(flops=4e10, bandwidth=1e10)
#: Small sizes of everything that is measured besides steps.
LITTLE = {
    matching_speed: {'MAP_SIZE': 50, 'SCAN_COUNT': 3},
    run_speed: {'PARK_LANDMARKS': 20, 'PARK_STEPS': 50},
    smoother_speed: {'LOG_POSES': 200, 'LOG_LANDMARKS': 20}}


def times(milliseconds):
    return Times(*(1e-3 * factor * milliseconds for factor in (1.0, 1.5, 3.0, 4.0)))


def cells(text, *starts):
    """Return the words of the lines of a text that start with one of some words."""
    return [line.split() for line in text.splitlines() if line.startswith(starts)]


@pytest.fixture
def quick(monkeypatch):
    """Return a function that runs the verb with small sizes."""
    def run(*words):
        monkeypatch.setattr(sys, 'argv', ['fej_slam', 'benchmark', *words])
        return main()
    monkeypatch.setattr(benchmark, 'measure_machine', lambda: MACHINE)
    monkeypatch.setattr(benchmark, 'SIZES', ((50, 2), (500, 10)))
    monkeypatch.setattr(benchmark, 'TIMED_STEPS', 6)
    monkeypatch.setattr(benchmark, 'PEER_LANDMARKS', (20, 30))
    monkeypatch.setattr(benchmark.mrpt, 'is_installed', lambda: False)
    for module, sizes in LITTLE.items():
        for name, little in sizes.items():
            monkeypatch.setattr(module, name, little)
    return run


def test_every_size_has_its_row_beside_the_limit():
    compressed = CompressedTime(times(0.2), 7, 1e-13)
    steps = [
        StepTime(50, 2, 9, times(0.01), times(0.03), None),
        StepTime(500, 10, 9, times(0.3), times(0.4), compressed),
        StepTime(1000, 10, 9, times(0.9), times(1.0), compressed)]

    small, middle, large, *regions = cells(report(MACHINE, {'steps': steps}), '50', '500', '1000')

    # 2 m n (n + 1) / F is 0.255 us for 50 states, but 8 n (n + 1) / B is 2.04 us.
    assert small == ['50', 'states', '2', '2.0', '10.0', '4.90', *(
        '30', '45', '90', '120', '14.71', '22.06')]
    # 200.4 us by memory, and 125 by arithmetic.
    assert middle[2:] == ['10', '200.4', '300.0', '1.50', *(
        '400', '600', '1200', '1600', '2.00', '2.99')]
    assert large[:3] == ['1000', 'states', '10']
    # 300 us in the mean, beside 200.4 and 800.8.
    assert regions[0] == ['500', 'states', '200', '300', '600', '800', '1.50', '7', '1e-13']
    assert regions[1][6] == '0.37'


def test_peers_are_compared_with_our_filter_at_the_same_number_of_landmarks():
    raced = [
        PeerTime(name, landmarks, 15, 8, times(milliseconds), 0.01, alone, 0.2)
        for name, landmarks, milliseconds, alone in (
            (OURS, 20, 1.0, 0.5e-3), ('x', 20, 6.0, 5e-3), (OURS, 30, 2.0, 1e-3),
            ('x', 30, 6.0, 4e-3))]

    rows = cells(report(MACHINE, {'peers': raced}), 'x')

    assert [(row[1], *row[8:12]) for row in rows] == [
        ('20', '6.0', '6.0', '5.00', '10.0'), ('30', '3.0', '3.0', '4.00', '4.0')]


def test_a_run_prints_and_writes_all_results(quick, tmp_path, capsys):
    output = tmp_path / 'speed.json'

    assert quick('--peers', '4', '--output', str(output)) == 0

    printed, figures = capsys.readouterr().out, json.loads(output.read_text())
    assert figures['machine'] == {'flops': 4e10, 'bandwidth': 1e10}
    assert len(cells(printed, OURS)) == len(cells(printed, 'textbook')) == 2
    assert [step['states'] for step in figures['steps']] == [50, 500]
    assert {peer['landmarks'] for peer in figures['peers']} == {20, 30}
    assert [len(figures[part]) for part in ('matching', 'runs', 'smoothers')] == [1, 1, 1]
    assert figures['versions'].keys() >= {'BLAS core', 'numpy'}


@pytest.mark.needs('matplotlib')
def test_a_picture_has_a_panel_for_each_part_with_growth_curves(quick, tmp_path):
    quick('--picture', str(tmp_path / 'one.png'))
    quick('--peers', '4', '--picture', str(tmp_path / 'two.png'))

    (width, one), (same_width, two) = (
        # Width and height follow the signature and the first chunk's name.
        struct.unpack('>2I', (tmp_path / name).read_bytes()[16:24])
        for name in ('one.png', 'two.png'))
    assert (width, 2 * one) == (same_width, two)


def test_missing_gtsam_is_reported_with_the_install_command(quick, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, 'find_spec', lambda name: None)

    assert quick('--peers', '4') == 0

    printed = capsys.readouterr().out
    assert "pip install '.[benchmark]'" in printed
    assert not cells(printed, 'iSAM2,')


def test_a_machine_whose_speed_drifts_gives_no_file(quick, monkeypatch, capsys, tmp_path):
    speeds = iter([4e10] * 3 + [2e10] * 9)
    monkeypatch.setattr(benchmark, 'measure_machine', lambda: Machine(next(speeds), 1e10))

    assert quick('--output', str(tmp_path / 'times.json')) == 1

    printed = capsys.readouterr()
    assert 'F by 2.00, B by 1.00' in printed.err
    assert cells(printed.out, '500')
    assert not (tmp_path / 'times.json').exists()


def test_missing_ros_is_reported_at_once(quick, monkeypatch, capsys):
    measured = []
    monkeypatch.setattr(benchmark, 'measure_machine', lambda: measured.append(1))
    monkeypatch.setitem(sys.modules, 'fej_slam_ros.benchmark.live_load', None)

    assert (quick('--live', '1'), measured) == (1, [])
    assert 'live_load is missing' in capsys.readouterr().err


def test_missing_data_are_reported_at_once(quick, monkeypatch, capsys, tmp_path):
    measured = []
    monkeypatch.setattr(benchmark, 'measure_machine', lambda: measured.append(1))

    status = quick('--data', str(tmp_path / 'missing'))

    assert (status, measured) == (2, [])
    assert 'missing: give the one with the Victoria Park data' in capsys.readouterr().err
