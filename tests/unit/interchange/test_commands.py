"""Command text: groups, instants, commands during a move, and other commands."""

from __future__ import annotations

import pytest

from lss_motion.interchange.commands import CommandReader
from lss_motion.interchange.reader import Unit
from lss_motion.sequence.model import Interpolation


def keys(motion) -> dict[str, list[tuple[float, float]]]:
    return {
        channel.name: list(zip(channel.times_s.tolist(), channel.values.tolist(), strict=True))
        for channel in motion.channels
    }


def test_commands_to_different_servos_move_together_and_groups_follow_each_other(read_one) -> None:
    text = "#1D100T500\r#2D-200T1000\r#1D300T500\r#2D0T250\r"
    motion = read_one(CommandReader(), text)
    assert keys(motion) == {
        "ID1": [(0.5, 10.0), (1.0, 10.0), (1.5, 30.0)],
        "ID2": [(1.0, -20.0), (1.25, 0.0)],
    }
    assert motion.ease is Interpolation.LINEAR
    assert [(c.unit, c.servo_id) for c in motion.channels] == [(Unit.DEG, 1), (Unit.DEG, 2)]


def test_ssc32_groups_share_the_time_at_their_end(read_one) -> None:
    motion = read_one(CommandReader(), "#5P1500#7P600S200T1000\n#5P1600T500\n")
    assert keys(motion) == {"PIN5": [(1.0, 1500.0), (1.5, 1600.0)], "PIN7": [(1.0, 600.0)]}
    assert motion.channels[0].unit is Unit.US
    assert "Not carried over: 1 speeds (S, SD)" in motion.comments


@pytest.mark.parametrize(
    "text",
    [
        "# lss_motion log 1\n1.000000 main > #5D100T1000\\r\n1.500000 main > #5D0T1000\\r\n",
        "# lss_motion program 1\n# name: x\n1000000 main #5D100T1000\n1500000 main #5D0T1000\n",
        "1.0 #5D100T1000\n1.5 #5D0T1000\n",
    ],
)
def test_with_instants_a_command_starts_at_the_position_of_the_servo(read_one, text: str) -> None:
    # At its target of 10 deg before; the second command comes before the first has ended.
    assert keys(read_one(CommandReader(), text)) == {"ID5": [(1.5, 10.0), (2.5, 0.0)]}


def test_a_command_during_a_move_starts_at_the_position_in_the_move(read_one) -> None:
    text = "0.0 #5D0T100\n1.0 #5D100T1000\n1.25 #5D-100T500\n"
    motion = read_one(CommandReader(), text)
    assert motion.ease is Interpolation.SPLINE  # From rest to rest it would stop there.
    assert keys(motion) == {"ID5": [(0.1, 0.0), (1.0, 0.0), (1.25, 2.5), (1.75, -10.0)]}


def test_a_stream_of_commands_is_a_recording(read_one) -> None:
    text = "".join(f"{0.05 * n:.2f} main > #5D{n}T100\\r\n" for n in range(40))
    motion = read_one(CommandReader(), text)
    assert motion.is_recording
    assert motion.ease is Interpolation.SPLINE


def test_queries_replies_and_holds_are_counted(read_one) -> None:
    text = "0.1 b > #5QD\\r\n0.2 b < *5QD12\\r\n0.3 b > #5D10T100\\r#254H\\r\n0.4 b > #5QD\\r\n"
    comments = read_one(CommandReader(), text).comments
    assert "Not carried over: 2 commands #QD" in comments
    assert "Not carried over: 1 commands *QD" in comments
    assert "Not carried over: 1 commands #H" in comments


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("#1D100T500\n#1D200\n", 2, "'#1D200' has no time (T)"),
        ("#1D100T500\n#1D200T0\n", 2, "has no time"),
        ("#1D100T500\n#251D200T10\n", 2, "'251' is not a whole number from 0 to 250"),
        ("#1D100T500\n#1D200T99999999\n", 2, "is not a whole number from 0 to 3600000"),
        ("1.0 #1D100T500\n#1D200T10\n", 2, "some commands have an instant and some have none"),
        ("1.0 #1D100T500\n0.5 #1D200T10\n", 2, "instants must not go back"),
        ("99999.0 #1D100T500\n", 1, "more than a day"),
        ("#1QD\n", None, "has no command that moves a servo"),
    ],
)
def test_a_wrong_command_is_refused_with_its_line(refusal, text, line, reason) -> None:
    error = refusal(CommandReader(), text)
    assert (error.line, reason in error.reason) == (line, True), error
