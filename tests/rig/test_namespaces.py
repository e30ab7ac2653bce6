"""Two computers in network namespaces, each with its robot and its clock, and what goes wrong."""

import os

import pytest

pytest.importorskip("zenoh", reason="needs the extra `network`")

from rig.stage import RigStage, may_make_namespaces, why_not

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@pytest.fixture
def rig(tmp_path):
    why = why_not()
    if why and os.environ.get("CI") == "true" and may_make_namespaces():
        pytest.fail(f"on a machine for tests with root there must be namespaces: {why}")
    if why:
        pytest.skip(why)
    with RigStage(tmp_path, hosts=2, seed=1, ppm=100.0, show_s=6) as rig:
        rig.start_all()
        yield rig


def test_a_cut_cable_is_held_through_and_rejoined(rig):
    rig.go()
    rig.cut("f1")
    rig.wait("f1", "playing -> freewheeling", 10)
    rig.wait("f0", "the others hold", 10)
    mark = rig.wait("f1", "freewheeling -> holding", 10)
    rig.heal("f1")
    mark = rig.wait("f1", "holding -> playing", 10, mark)
    rig.wait("f0", "all figures play: the show goes on", 10)
    rig.wait("f1", "playing -> ended", 60, mark)
    verdicts = rig.end()
    assert [one["objections"] for one in verdicts.values()] == [[], []]
    assert min(one["lines"]["main"] for one in verdicts.values()) > 100
