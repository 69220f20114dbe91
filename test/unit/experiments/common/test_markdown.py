# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
from fej_slam_ros.experiments.common.markdown import table


def test_words_stand_to_the_left_and_numbers_to_the_right():
    assert table(['runs', 'filter', 'rmse'], [['8', 'FEJ', '0.1']], words=(1,)) == (
        '| runs | filter | rmse |\n'
        '| --: | --- | --: |\n'
        '| 8 | FEJ | 0.1 |')
