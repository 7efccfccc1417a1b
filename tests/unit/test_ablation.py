"""What a scene does not use leaves no instruction in its kernels: benchmarks/ablation.py compares machine code."""

import ablation
import pytest

import pmpm


def test_branches_of_features_that_a_scene_does_not_use_leave_no_instruction(monkeypatch):
    monkeypatch.setenv("PMPM_LOOPS", "lanes")
    found, cut = ablation.left_by_unused(pmpm.Scene.builtin("colliding_disks"))
    assert cut >= 10
    assert {name: differ for name, (_, differ) in found.items()} == {"p2g 0": 0, "g2p 0": 0}
    assert all(count > 1000 for count, _ in found.values())


@pytest.mark.parametrize(("one", "other", "differ"), [("abc", "abc", 0), ("abc", "axc", 1), ("abc", "abcd", 1)])
def test_the_comparison_counts_what_differs(one, other, differ):
    assert ablation.different_lines(list(one), list(other)) == differ
