"""A sample of `lab/run attack`: bad inputs end in one sentence and change nothing."""

import pytest

from gsut.cli import build_parser
from lab.attack.datasets import list_dataset_cases
from lab.attack.harness import attack, find_disagreement
from lab.attack.kills import COMMANDS
from lab.attack.numbers import list_numbers, render_numbers
from lab.attack.requests import list_requests, send_requests
from lab.attack.tables import list_cases
from lab.attack.world import LATER, make_world

EVERY = 127  # of the table; another part of it for each kind
EVERY_DATASET = 97  # these train: slower
LEAST = 400  # cases in the whole table


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world"))


def test_sample_of_bad_inputs_is_refused_in_one_sentence(world, tmp_path):
    table = [case for case in list_cases() if not LATER.keys() & set(case.needs)]  # seconds to make
    assert len(table) >= LEAST
    assert len({case.title for case in table}) == len(table)
    for number, case in enumerate(table[::EVERY]):
        said = attack(case, world, tmp_path / str(number))
        assert said is None, f"{case.title}: {said}"


def test_doctor_and_train_agree_on_a_sample_of_spoiled_datasets(world, tmp_path):
    pairs = list(list_dataset_cases(world))
    assert len(pairs) >= LEAST
    for number, (doctor, train) in enumerate(pairs[::EVERY_DATASET]):
        said = find_disagreement(doctor, train, world, tmp_path / str(number))
        assert said is None, f"{train.title}: {said}"


def test_sample_of_requests_that_are_wrong_huge_or_foreign_are_refused(world):
    rows = list(list_requests())
    assert len(rows) >= 20
    for _, title in rows[::3]:
        said = send_requests(title, world)
        assert said is None, f"{title}: {said}"


def test_sample_of_extreme_numbers_is_drawn_exactly_or_named():
    rows = list(list_numbers())
    assert len(rows) >= 40
    for _, title in rows[::7]:
        assert render_numbers(title) is None, title


def test_commands_to_kill_are_understood():
    parser = build_parser()
    assert len(COMMANDS) >= 12
    for command in COMMANDS:
        for words in (command.words, command.again or command.words):
            assert parser.parse_args(words)
