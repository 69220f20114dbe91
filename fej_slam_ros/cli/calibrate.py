# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Find by which factors the noise in a bag is claimed wrongly, and write parameters that correct it.

The factors are on standard deviations: odometry_noise_scale, landmark_noise_scale and
robot_noise_scale. Where the bag has ground truth, they come from errors: of the way by odometry
over 5 s, and of observations. A robot with enough data has factors of its own. What ground truth does
not tell is told by the innovations of the estimator: the factors, the same for all robots, with
the highest likelihood, without a gate. Gross errors, beyond a chi-square probability of 0.999999,
are left out. Observations without identity are not used.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.atomic_files import refuse_existing, write_text
from fej_slam_ros.cli.arguments import add_bag_and_parameters, at_least
from fej_slam_ros.cli.offline_run import check_topics
from fej_slam_ros.cli.run_table import format_table
from fej_slam_ros.core.calibration.from_innovations import (
    counts, most_likely_scales, Received, run as run_estimator)
from fej_slam_ros.core.calibration.from_truth import (
    DOF, Errors, MAX_RELATIVE_ERROR, noise_scales, NoiseScale, normalized_errors,
    ODOMETRY_WINDOW)
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import NS, Odometry, Record, TrueLandmarks
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.session.inputs import Inputs

#: The factor of each kind of noise for all robots, '', and for those that have one of their own.
Found = dict[str, dict[str, NoiseScale]]

FACTOR_HEADINGS = ('noise', 'robot', 'factor', 'standard error', 'samples', 'from')
SCORE_HEADINGS = (
    'robot', 'NIS/dof before', 'after', 'NEES/3 before', 'after', 'gated before', 'after')

#: What a parameter may be.
SMALLEST, LARGEST = 1e-3, 1e3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bag_and_parameters(parser)
    parser.add_argument(
        '--output', type=Path, required=True, metavar='FILE.yaml',
        help='the same parameters with the factors')
    parser.add_argument(
        '--from', dest='source', choices=('truth', 'innovations'),
        help='what the factors may come from (default: ground truth where there is any, and'
        ' innovations for the rest)')
    parser.add_argument(
        '--seconds', metavar='N', type=at_least(1, '--seconds'), default=120,
        help='how much of the beginning of the bag innovations are taken from; the estimator goes'
        ' through it some 30 to 100 times (default: %(default)s s)')
    parser.add_argument(
        '--force', action='store_true', help='replace the output if it exists')


def run(arguments: argparse.Namespace) -> int:
    """Find the factors, write them, and print them with what they change."""
    refuse_existing([arguments.output], arguments.force)
    settings = parameters.load(arguments.params).estimation
    values = parameters.load_values(arguments.params, ['estimator'])
    recorder = _read(arguments.bag, settings)
    truth, innovations = _found(arguments, values, recorder.records)
    corrected = _corrected(values, truth | innovations)
    if corrected == values:
        raise UserError(
            f'{arguments.bag} has too little data to tell any noise: record it for longer, with'
            ' ground truth or with more observations of the same landmarks')
    before, after = (
        _scored(name, those, recorder.records)
        for name, those in (('before', values), ('after', corrected)))
    write_text(arguments.output, parameters.dump_values(corrected))
    rows = [*_factor_rows(truth, 'truth'), *_factor_rows(innovations, 'innovations')]
    print(format_table([FACTOR_HEADINGS, *rows]))
    print(format_table([SCORE_HEADINGS, *_score_rows(before, after)]))
    print('\n'.join([*_remarks(recorder, truth | innovations), f'wrote {arguments.output}']))
    return 0


class RecordCollector:
    """Keeps what an estimator would get."""

    #: Who is seen may change with the noise, and would hide what the noise is.
    needs_ids = True

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.robots = {robot.name: robot for robot in settings.robots}
        self.statistics = InputStatistics()
        self.truth = RecordedTruth()
        self.records: list[Received] = []

    def add(self, record: Record, received: int | None = None) -> None:
        """Take in a record."""
        self.records.append((record, received))


def _read(bag: Path, settings: Settings) -> RecordCollector:
    """Return what is in a bag, of which there must be odometry."""
    topics = bags.topics(bag)
    check_topics(bag, topics, settings)
    recorder = RecordCollector(settings)
    inputs = Inputs(recorder)
    total = sum(topic.messages for topic in topics.values())
    for message in tqdm(bags.read(bag), 'read', total=total, unit='msg', disable=None):
        inputs.receive(message)
    inputs.close()
    if not counts(recorder.records)['odometry']:
        raise UserError(
            f'{bag} has no odometry that can be used: replay it to see what is refused, and why')
    return recorder


def _found(
    arguments: argparse.Namespace, values: Mapping[str, object], records: Sequence[Received]
) -> tuple[Found, Found]:
    """Return what ground truth and what innovations tell, as far as they are wanted."""
    settings, amounts = parameters.parse(values), counts(records)
    errors: Mapping[str, Errors] = {}
    if arguments.source != 'innovations':
        errors = normalized_errors([record for record, _ in records], settings.estimation)
    if arguments.source == 'truth' and not errors:
        raise UserError(
            f'{arguments.bag} has no ground truth that reaches over'
            f' {ODOMETRY_WINDOW / NS:g} s of odometry or an observation: leave out --from truth')
    truth = {kind: noise_scales(of, DOF[kind]) for kind, of in errors.items()}
    rest = [kind for kind in DOF if amounts[kind] and not _is_known(truth, kind)]
    if not rest or arguments.source == 'truth':
        return truth, {}
    if not amounts['landmark'] + amounts['robot']:
        if truth:
            return truth, {}
        raise UserError(
            f'{arguments.bag} has no observations with identity, so that there are no innovations:'
            ' record ground truth or observations')
    corrected = parameters.parse(_corrected(values, truth)).estimation
    with tqdm(desc='search', unit='run', disable=None) as bar:
        likeliest = most_likely_scales(
            corrected, _beginning(records, arguments.seconds), rest,
            prior_map(settings.node.prior_landmarks),
            bar.update)
    return (
        {kind: of for kind, of in truth.items() if kind not in rest},
        {kind: {'': found} for kind, found in likeliest.items()})


def _beginning(records: Sequence[Received], seconds: int) -> list[Received]:
    """Return the records of so many seconds from the first odometry on."""
    first = min(record.stamp for record, _ in records if isinstance(record, Odometry))
    return [
        (record, received) for record, received in records
        if isinstance(record, TrueLandmarks) or record.stamp <= first + seconds * NS]


def _corrected(values: Mapping[str, object], found: Found) -> dict[str, object]:
    """Return parameters with the factors that are known."""
    corrected = dict(values)
    for kind, of in found.items():
        if _is_known(found, kind):
            name = f'{kind}_noise_scale'
            corrected = {key: x for key, x in corrected.items() if key.split('.')[-1] != name}
            corrected |= {
                f'{robot}.{name}'.lstrip('.'): _rounded(told.scale) for robot, told in of.items()}
    return corrected


def _is_known(found: Found, kind: str) -> bool:
    return kind in found and found[kind][''].is_known()


def _rounded(scale: float) -> float:
    return float(f'{min(max(scale, SMALLEST), LARGEST):.4g}')


def _scored(
    name: str, values: Mapping[str, object], records: Sequence[Received]
) -> Estimator:
    """Return an estimator that has had all records."""
    settings = parameters.parse(values)
    estimator, _ = run_estimator(
        settings.estimation, tqdm(records, name, unit='msg', disable=None),
        prior_map(settings.node.prior_landmarks))
    return estimator


def _factor_rows(found: Found, source: str) -> Iterator[tuple[str, ...]]:
    for kind, of in found.items():
        for robot, told in of.items():
            yield (
                kind, robot or 'all', f'{told.scale:.3f}',
                f'{told.scale * told.relative_error:.3f}', str(told.samples), source)


def _score_rows(before: Estimator, after: Estimator) -> Iterator[tuple[str, ...]]:
    for robot in before.robots:
        cells = zip(_scores(before, robot), _scores(after, robot))
        yield (robot, *(cell for pair in cells for cell in pair))


def _scores(estimator: Estimator, robot: str) -> tuple[str, str, str]:
    """Return NIS per degree of freedom, NEES / 3 and how many observations failed the gate."""
    nis, score = estimator.innovations.nis[robot], estimator.evaluation.scores.get(robot)
    mean_nees = None if score is None else score.mean_nees()
    rejected = estimator.statistics.rejection_counts[robot]
    return (
        f'{nis.total / nis.dof:.2f}' if nis.dof else '-',
        '-' if mean_nees is None else f'{mean_nees:.2f}',
        str(rejected[RejectionReason.GATED] + rejected[RejectionReason.MOVED_LANDMARK]))


def _remarks(recorder: RecordCollector, found: Found) -> Iterator[str]:
    """Yield what a user should know besides the factors."""
    amounts = counts(recorder.records)
    for kind in DOF:
        if amounts[kind] and not _is_known(found, kind):
            yield (
                f'too little data to tell {kind}_noise_scale to {100 * MAX_RELATIVE_ERROR:.0f} %,'
                ' which stays as it was')
    without = recorder.statistics.total(RejectionReason.NO_IDENTITY)
    if without:
        yield f'{without} observations without identity were left out, also of NIS and NEES'
