"""More ranks than cores, and than the material has room for, write the same bits as one process alone.

tests/by_hand/many_ranks_all.py runs every built-in scene on 64 ranks.
"""

import bits
import many_ranks
import pytest

RANKS = 16
# Disks of 80 layers, five for each rank, and a column of 20 layers, which leaves ranks without any.
SETTINGS = {
    "colliding_disks": many_ranks.SETTINGS["colliding_disks"] | {"domain.cell_size": 0.0125},
    "dam_break": many_ranks.SETTINGS["dam_break"],
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Folders of the runs of one process, and of many ranks."""
    found = tmp_path_factory.mktemp("alone"), tmp_path_factory.mktemp("many")
    for folder, ranks in zip(found, (None, RANKS), strict=True):
        many_ranks.run_several(SETTINGS, folder, ranks, SETTINGS)
    return found


@pytest.mark.parametrize("name", SETTINGS)
def test_many_ranks_give_the_bits_of_one(name, folders):
    alone, many = (folder / name for folder in folders)
    assert bits.differences(alone, many) == []
    assert sum(map(sum, bits.report(many)["sent"])) > 0


def test_most_of_many_ranks_own_layers_or_only_a_few_of_them(folders):
    owners = {name: many_ranks.ranks_that_own_layers(folders[1] / name)[0] for name in SETTINGS}
    assert owners["colliding_disks"] > RANKS // 2 > owners["dam_break"] > 1
