"""Command text: groups, instants, commands during a move, and other commands."""

from __future__ import annotations

import pytest

from lss_motion.interchange.command_text import COMMANDS, command_reader
from lss_motion.interchange.mapping import map_template, mapped
from lss_motion.interchange.reader import Measure
from lss_motion.show.model import Interpolation


def keys(motion) -> dict[str, list[tuple[float, float]]]:
    return {
        channel.name: list(zip(channel.times_s.tolist(), channel.values.tolist(), strict=True))
        for channel in motion.channels
    }


def test_commands_to_different_servos_move_together_and_groups_follow_each_other(read_one) -> None:
    text = "#1D100T500\r#2D-200T1000\r#1D300T500\r#2D0T250\r"
    motion = read_one(COMMANDS, text)
    assert keys(motion) == {
        "ID1": [(0.5, 10.0), (1.0, 10.0), (1.5, 30.0)],
        "ID2": [(1.0, -20.0), (1.25, 0.0)],
    }
    assert motion.ease is Interpolation.LINEAR
    assert [(c.unit, c.servo_id) for c in motion.channels] == [
        (Measure.DEG, 1),
        (Measure.DEG, 2),
    ]


def test_ssc32_groups_share_the_time_at_their_end(read_one) -> None:
    motion = read_one(COMMANDS, "#5P1500#7P600S200T1000\n#5P1600T500\n")
    assert keys(motion) == {"PIN5": [(1.0, 1500.0), (1.5, 1600.0)], "PIN7": [(1.0, 600.0)]}
    assert motion.channels[0].unit is Measure.US
    assert "Not carried over: 1 speed (S, SD)" in motion.comments


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
    assert keys(read_one(COMMANDS, text)) == {"ID5": [(1.5, 10.0), (2.5, 0.0)]}


def test_a_command_during_a_move_starts_at_the_position_in_the_move(read_one) -> None:
    text = "0.0 #5D0T100\n1.0 #5D100T1000\n1.25 #5D-100T500\n"
    motion = read_one(COMMANDS, text)
    assert motion.ease is Interpolation.SPLINE  # From rest to rest it would stop there.
    assert keys(motion) == {"ID5": [(0.1, 0.0), (1.0, 0.0), (1.25, 2.5), (1.75, -10.0)]}


def test_a_stream_of_commands_is_a_recording(read_one) -> None:
    text = "".join(f"{0.05 * n:.2f} main > #5D{n}T100\\r\n" for n in range(40))
    motion = read_one(COMMANDS, text)
    assert motion.is_recording
    assert motion.ease is Interpolation.SPLINE


def test_queries_replies_and_holds_are_counted(read_one) -> None:
    text = "0.1 b > #5QD\\r\n0.2 b < *5QD12\\r\n0.3 b > #5D10T100\\r#254H\\r\n0.4 b > #5QD\\r\n"
    comments = read_one(COMMANDS, text).comments
    assert "Not carried over: 2 commands #QD" in comments
    assert "Not carried over: 1 command *QD" in comments
    assert "Not carried over: 1 command #H" in comments


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
    error = refusal(COMMANDS, text)
    assert (error.line, reason in error.reason) == (line, True), error


@pytest.mark.parametrize(
    "wait",
    ["wait 750", "WAIT 750 ms", "pause 0.75", "delay(750);", "sleep 0.75", "time.sleep(0.75)  # s",
     "pause: 0,75 s", "delay_ms(750)", "delay(500); delay(250); // then go"],
)  # fmt: skip
def test_waits_pace_the_commands_from_the_instant_they_were_sent(read_one, wait: str) -> None:
    motion = read_one(COMMANDS, f"#1D100T500\n#2D0T1000\n{wait}\n#1D200T250\n")
    assert keys(motion) == {"ID1": [(0.5, 10.0), (0.75, 10.0), (1.0, 20.0)], "ID2": [(1.0, 0.0)]}
    assert any("paced by the waits" in comment for comment in motion.comments)
    assert not any("means nothing" in comment for comment in motion.comments)


def test_a_wait_that_is_shorter_than_the_move_cuts_the_move(read_one) -> None:
    text = "#1D0T100\r\ndelay(100)\r\n#1D100T1000 delay(250) #1D0T500\n"
    times_s, values = zip(*keys(read_one(COMMANDS, text))["ID1"], strict=True)
    assert times_s == (0.1, 0.35, 0.85)
    assert values == pytest.approx((0.0, 2.5, 0.0))


def test_a_wait_at_the_end_is_a_hold(read_one) -> None:
    motion = read_one(COMMANDS, "delay(100)\n#1D100T500\ndelay(2000)\n")
    assert keys(motion) == {"ID1": [(0.6, 10.0)]}
    assert motion.notes[0.6].hold_s == 1.5


def test_a_unit_that_the_text_does_not_give_is_named(read_one) -> None:
    comments = read_one(COMMANDS, "#1D100T500\nwait 700\npause 0.5\nsleep 1\n").comments
    assert (
        "`wait 700` is read as ms; if it is not, use --wait-unit s or write the unit." in comments
    )
    assert (
        "`pause 0.5` is read as s; if it is not, use --wait-unit ms or write the unit." in comments
    )
    assert not any("sleep" in comment for comment in comments)


def test_lines_without_a_meaning_are_listed_and_comments_are_not(read_one) -> None:
    lines = [f"go {n}" for n in range(12)]
    text = "# a comment\n// one more\n; and this\n#1D100T500\n" + "\n".join(lines) + "\n"
    comments = read_one(COMMANDS, text).comments
    listed = [comment for comment in comments if "means nothing here" in comment]
    assert len(listed) == 10
    assert "line 5, which means nothing here: 'go 0'" in listed[0]
    assert "Not carried over: 2 more lines without a meaning here" in comments


def test_waits_beside_instants_are_listed(read_one) -> None:
    comments = read_one(COMMANDS, "0.5 #1D100T500\nwait 300\n1.5 #1D0T500\n").comments
    assert "Not carried over: 1 wait, because the commands have instants" in comments


def test_a_log_has_no_lines_without_a_meaning(read_one) -> None:
    text = (
        "# lss_motion log 2\n0.100000000 main > #5D100T500\\r#5QD\\r\n0.110000000 main < *5Q\n"
        "0.120000000 main < D98\\r\n0.130000000 main ~ lost\n"
        "0.140000000 - ! MarkPassed(label='wait 5')\n"
        "0.150000000 - #\n"
    )
    motion = read_one(COMMANDS, text)
    assert keys(motion) == {"ID5": [(0.6, 10.0)]}
    assert not any("means nothing" in comment for comment in motion.comments)
    assert not any("waits" in comment for comment in motion.comments)


@pytest.mark.parametrize(
    ("text", "unit", "wait_s"),
    [
        ("pause 2", None, 2.0),
        ("pause 19", None, 19.0),
        ("pause 20", None, 0.02),
        ("pause 500\npause 2", None, 0.502),
        ("wait 700\npause 2", None, 2.7),
        ("pause 2", "ms", 0.002),
        ("pause 700", "s", 700.0),
        ("pause 700.5", "ms", 0.7005),
        ("pause 2 s\npause 0.1 ms", "ms", 2.0001),
        ("delay(2)", "s", 0.002),
    ],
)
def test_the_unit_of_a_bare_wait(read_one, text, unit, wait_s) -> None:
    """Few seconds, or milliseconds as T; an option settles it."""
    reader = command_reader(unit)
    motion = read_one(reader, f"#1D100T500\n{text}\n#1D0T500\n")
    assert motion.channels[0].times_s[-1] == pytest.approx(wait_s + 0.5)


@pytest.mark.parametrize(
    "text",
    [
        "#5 P1600 #10 P750 T2500 \n",
        "#5P1600#10P750T2500\r",
        "#5 p 1600 #10 p 750 t 2500\n",
        'Serial.print("#5 P1600 #10 P750 T2500");\n',
    ],
)
def test_case_and_spaces_within_commands_do_not_count(read_one, text) -> None:
    """As the manual of the SSC-32 writes its commands, and its readers type them."""
    motion = read_one(COMMANDS, text)
    assert [(c.name, c.values.tolist()) for c in motion.channels] == [
        ("PIN5", [1600.0]),
        ("PIN10", [750.0]),
    ]
    assert all(c.times_s.tolist() == [2.5] for c in motion.channels)


def test_a_broadcast_moves_the_servos_of_the_text_and_all_others_of_the_robot(
    read_one, arm
) -> None:
    motion = read_one(COMMANDS, "#1D100T500\n#254D300T500\n#9D0T500\n")
    assert keys(motion) == {
        "ID1": [(0.5, 10.0), (1.0, 30.0)],
        "ID254": [(1.0, 30.0)],
        "ID9": [(1.0, 30.0), (1.5, 0.0)],
    }
    own = {
        c.name: (c.times_s.tolist(), c.values.tolist()) for c in mapped(motion, arm, None).channels
    }
    assert own == {
        "base": ([0.5, 1.0], [10.0, 30.0]),
        "elbow": ([1.0], [-20.0]),
        "lift": ([1.0, 1.5], [30.0, 0.0]),
    }
    alone = mapped(read_one(COMMANDS, "#254D0T500\n"), arm, None)
    assert {channel.name for channel in alone.channels} == {"base", "elbow", "lift"}
    template = map_template(motion, arm)
    assert '"ID5"' in template
    assert "ID254" not in template
