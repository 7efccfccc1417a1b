"""Which card a rank takes, and what is said where there is none: the driver is played by the test."""

import numpy as np
import pytest

import pmpm
from pmpm.parallel.comm import Alone
from pmpm.parallel.halo import Message
from pmpm.processors import cards
from pmpm.processors.cuda import Incoming
from pmpm.scene.errors import SceneError

GIBI = 1 << 30


class Ranks(Alone):
    """Rank `rank` of some on one host, all of whom say the same, but for the identities of their cards."""

    def __init__(self, rank, ids):
        self.rank, self.size, self.ids = rank, len(ids), ids

    def gather(self, value):
        if isinstance(value, dict):
            return [value | {"id": card} for card in self.ids]
        return [value] * self.size


@pytest.fixture
def driver(monkeypatch):
    """A driver with this version and these cards."""

    def with_cards(version=(13, 0), count=2):
        class Device:
            name, uuid = b"H100", "GPU-1"

        class Context:
            def get_memory_info(self):
                return 8 * GIBI, 80 * GIBI

        chosen = []
        monkeypatch.setattr(cards, "trouble", lambda: None)
        monkeypatch.setattr(cards, "driver_version", lambda: version)
        from numba import cuda

        monkeypatch.setattr(cuda, "gpus", [None] * count)
        monkeypatch.setattr(cuda, "select_device", lambda number: chosen.append(number) or Device())
        monkeypatch.setattr(cuda, "current_context", Context)
        return chosen

    return with_cards


@pytest.mark.parametrize(("rank", "taken"), [(0, 0), (1, 1), (2, 0)])
def test_ranks_of_a_host_take_its_cards_in_turn(driver, rank, taken):
    chosen = driver()
    found = cards.take(Ranks(rank, ["a", "b", "a"]))
    assert chosen == [taken]
    assert found.free == 8 * GIBI
    assert "3 of H100" in found.text


def test_ranks_that_share_a_card_are_warned(driver):
    driver()
    assert cards.take(Ranks(0, ["a", "b"])).warning is None
    assert "3 ranks share 2 cards" in cards.take(Ranks(0, ["a", "b", "a"])).warning


def test_a_driver_older_than_the_compiler_writes_for_is_refused(driver):
    driver(version=(12, 8))
    with pytest.raises(SceneError, match=r"the driver knows CUDA 12\.8, 13\.0 is needed"):
        cards.take(Alone())


def test_a_driver_without_cards_is_refused(driver):
    driver(count=0)
    with pytest.raises(SceneError, match="CUDA_VISIBLE_DEVICES"):
        cards.take(Alone())


def test_all_ranks_hear_where_a_card_is_missing(driver):
    driver(count=0)
    with pytest.raises(SceneError, match="rank 0; 2 of 2 ranks say so"):
        cards.take(Ranks(1, ["a", "b"]))


def test_the_way_of_shared_planes_is_told(driver):
    driver()
    ranks = Ranks(0, ["a", "b"])
    assert "by way of the host" in cards.take(ranks).text
    ranks.reaches_cards = lambda: True
    assert "from card to card" in cards.take(ranks).text
    assert "shared planes" not in cards.take(Alone()).text


def test_a_scene_too_large_for_the_cards_is_refused_with_how_many_would_do():
    scene = pmpm.Scene.builtin("dam_break_3d")
    taken = cards.of_scene(scene)
    cards.refuse_memory(scene, taken, 1)
    with pytest.raises(SceneError, match="5 ranks, each with such a card, would do"):
        cards.refuse_memory(scene, taken / 4.5, 2)


class Everywhere:
    """A patch whose nodes are numbered by (plane, node), without plane 3."""

    def find(self, plane, middle, node):
        return np.where(plane == 3, -1, 100 * plane + 10 * middle + node)


def test_what_comes_is_looked_up_again_when_it_has_other_nodes():
    message = Message(2, 1, 4, np.float32)
    message.tell([1, 1], np.array([[0, 0, 1], [0, 2, 3]]), 2 * 16)
    incoming = Incoming(message, np.array([3, 5]), None)
    assert incoming.is_new()
    assert incoming.numbers_in(Everywhere()).tolist() == [-1] * 4 + [508, 509, 510, 511]
    assert incoming.count == 8
    assert not incoming.is_new()
    message.tell([0, 1], np.array([[0, 1, 3]]), 2 * 16)
    assert incoming.is_new()
    assert incoming.numbers_in(Everywhere()).tolist() == list(range(504, 512))
