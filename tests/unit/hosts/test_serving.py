"""What is typed at a computer of a stage, and what its triggers send, are operations."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.stage.hosts.serving import TypedOperations, operation_of, settings_of
from lss_motion.stage.load import load_stage

SEQUENCES = Path(__file__).parents[3] / "sequences"


@pytest.fixture(scope="module")
def stage():
    return load_stage(SEQUENCES / "stages" / "duet.yaml")


@pytest.mark.parametrize(
    ("line", "operation"),
    [
        ("s", m.Stop()),
        ("p", m.Pause()),
        ("r", m.Resume()),
        ("v 0.5", m.Rate(ratio=0.5)),
        ("j 12.5", m.Seek(to=12.5)),
        ("l bow", s.StagePlay(show="bow")),
        ("c door", s.FireCue(label="door")),
    ],
)
def test_a_line_is_an_operation_of_the_schema(stage, line, operation):
    assert operation_of(line.split(), stage) == operation


def test_g_is_go_where_something_waits_for_it_and_else_the_first_show(stage):
    bare = replace(stage, idle=None, cues=())
    assert operation_of(["g"], bare) == s.StagePlay(show="bow")
    assert operation_of(["g"], replace(bare, idle="bow")) == m.Go()


@pytest.mark.parametrize(
    ("line", "remedy"),
    [
        *((line, "v needs a share of the speed: v 0.5") for line in ("v", "v fast", "v 0.5 1")),
        *((line, "v needs a share of the speed: v 0.5") for line in ("v nan", "v 7", "v -1")),
        *((line, "j needs a show time in seconds") for line in ("j", "j 1:30", "j inf", "j -1")),
        *((line, "keys, each with Enter") for line in ("x", "s now", "l", "gg")),
    ],
)
def test_a_line_that_is_none_is_answered_with_what_there_is(stage, line, remedy):
    with pytest.raises(InputError, match=remedy):
        operation_of(line.split(), stage)


def test_lines_and_triggers_are_carried_out_and_what_is_refused_is_told(stage):
    log, done = [], []
    typed = TypedOperations(stage, lambda: ["left: idle"], log.append)

    def obey(operation, origin):
        if isinstance(operation, m.Pause):
            raise InputError("no show plays")
        done.append((operation.op, origin))

    for line in ("s", "p", "", "?", "x"):
        typed.type(line)
    typed.put(s.Trigger(kind="osc", address="/door"), "OSC 127.0.0.1")
    typed.carry_out(obey)
    assert done == [("stop", "keyboard"), ("trigger", "OSC 127.0.0.1")]
    assert log[:2] == ["refused: no show plays", "left: idle"]
    assert log[2].startswith("refused: keys, each with Enter")
    assert not typed.has_ended
    typed.type("q")
    typed.carry_out(obey)
    assert typed.has_ended


def test_the_settings_are_those_of_the_stage(stage):
    settings = settings_of(stage, "right", is_trusted=False)
    assert (settings.conductor, settings.address, settings.is_conductor) == (
        "left",
        "127.0.0.1:7447",
        False,
    )
    with pytest.raises(InputError, match="there are left, right"):
        settings_of(stage, "middle", is_trusted=False)
