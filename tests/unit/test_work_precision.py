"""The arithmetic behind docs/results/work_precision.md, on numbers whose answers are plain."""

import pytest
from precision_arithmetic import cost_to_reach, order, pareto, ranks
from precision_found import Claim, Found, Run
from precision_plan import CFLS, PEER_CASES, TRANSFERS, Point, plan
from work_precision import Rows, disagreements

SECOND_ORDER = [(1.0, 1e-1), (8.0, 2.5e-2), (64.0, 6.25e-3)]  # in 2-D: twice the cells, 8 times the particle-steps


def test_a_point_beaten_in_cost_and_error_is_not_on_the_front():
    points = [
        (1.0, 0.1, "a"),
        (2.0, 0.2, "beaten by a"),
        (3.0, 0.05, "b"),
        (3.0, 0.06, "beaten by b"),
        (4.0, 0.05, "late"),
    ]
    assert [label for _, _, label in pareto(points)] == ["a", "b"]


def test_the_cost_between_two_runs_lies_on_the_line_of_their_logarithms():
    """Error falls as cost^(-2/3): to half of 0.1 it takes 2^(3/2) times the cost."""
    cost, exact = cost_to_reach(SECOND_ORDER, 5e-2)
    assert cost == pytest.approx(2.0**1.5)
    assert exact


def test_an_error_that_the_coarsest_run_is_below_gives_a_bound():
    assert cost_to_reach(SECOND_ORDER, 0.2) == (1.0, False)


def test_an_error_that_no_run_reaches_is_not_extrapolated():
    assert cost_to_reach(SECOND_ORDER, 1e-3) is None


def test_a_series_that_grows_again_counts_where_it_was_low():
    """Linear splines: finer grids are worse once particles cross cells."""
    cost, _ = cost_to_reach([(1.0, 0.2), (8.0, 0.1), (64.0, 0.3)], 0.1)
    assert cost == pytest.approx(8.0)


def test_schemes_whose_bars_overlap_share_ranks():
    times = {"quick": [1.0, 1.1, 1.2], "quick too": [1.15, 1.2, 1.3], "slow": [5.0, 5.1, 5.2]}
    assert ranks(times) == {"quick": (1, 1, 2), "quick too": (2, 1, 2), "slow": (3, 3, 3)}


def test_the_order_is_that_of_the_two_finest_runs():
    assert order([64, 16, 32], [0.01, 0.9, 0.04]) == pytest.approx(2.0)


def test_the_plan_has_each_factor_alone_in_every_case():
    points = plan(quick=False, peers=True)
    for case in {point.case for point in points} - {"sand"}:
        own = [point for point in points if point.case == case]
        cells = max(point.cells for point in own if point.transfer == "pic")
        base = Point(case, cells)
        assert base in points
        assert {(p.transfer, p.blend) for p in own if p.cells == cells and p.degree == "quadratic"} == set(TRANSFERS)
        assert {p.cfl for p in own if p.cells == cells and p.scheme == base.scheme} >= set(CFLS)
        assert {p.precision for p in own} == {"float32", "float64"}
        assert {p.per_direction for p in own} == {1, 2, 3, 4}


@pytest.mark.parametrize("quick", [False, True])
def test_peers_run_at_the_steps_and_grids_at_which_pmpm_runs_the_same_scheme(quick):
    points = plan(quick, peers=True)
    for point in points:
        if point.code in ("taichi", "warp"):
            assert point.case in PEER_CASES
            assert Point(point.case, point.cells, precision=point.precision, cfl=point.cfl) in points


def test_a_call_goes_on_with_the_whole_rows_of_one_that_was_killed(tmp_path):
    first = Rows(tmp_path, {"processor": "this one"})
    first.add("a", 0, {"seconds": 1.0})
    with first.path.open("a", encoding="utf-8") as file:
        file.write('{"key": "b", "round": 0, "sec')
    again = Rows(tmp_path, {"processor": "this one"})
    again.add("c", 0, {"seconds": 2.0})
    assert list(Rows(tmp_path, {"processor": "this one"}).known) == [("a", 0), ("c", 0)]


def test_rows_of_another_machine_are_not_mixed_in(tmp_path):
    Rows(tmp_path, {"processor": "this one"})
    with pytest.raises(SystemExit, match="another machine"):
        Rows(tmp_path, {"processor": "another"})


@pytest.mark.parametrize(("error", "told"), [(0.0200001, 0), (0.021, 1)])
def test_a_peer_may_differ_from_pmpm_by_roundings_only(tmp_path, error, told):
    """100 steps of float32 within 1 m, u of 0.01 m: 4 sqrt(100) 2^-24 / 0.01 = 2.4e-4."""
    peer, own = Point("waves 2-D", 16, code="warp", precision="float32"), Point("waves 2-D", 16, precision="float32")
    rows = Rows(tmp_path, {})
    rows.add(own.key, 0, {"e_u": 0.02})
    rows.add(peer.key, 0, {"e_u": error, "steps": 100, "farthest": 1.0, "reference": 0.01})
    lines, compared = disagreements([own, peer], rows)
    assert (len(lines), compared) == (told, 1)


def test_a_peer_that_is_sooner_at_an_error_is_named():
    """Both halve the error with 8 times the time; the peer takes twice as long."""
    runs = {}
    for code, unit in (("pmpm", 1.0), ("warp", 2.0)):
        for cells, error in ((16, 0.2), (32, 0.05)):
            point = Point("waves 2-D", cells, code=code, precision="float32")
            runs[point] = Run(point, {}, error, (unit * cells**3,))
    found = Found({}, None, {}, True, 0.0, set())
    found.wanted, found.runs = dict.fromkeys(runs, 1), runs
    (claim, *_) = found.claims()
    assert (claim.level, claim.peer, claim.theirs / claim.mine, claim.lost) == (0.1, "warp", pytest.approx(2.0), False)
    assert Claim("waves 2-D", 0.1, "warp", 2.0, "mls", 1.0).lost
    assert not Claim("waves 2-D", 0.1, "warp", 2.0, "mls", None).lost
