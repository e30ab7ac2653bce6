from __future__ import annotations

import pytest
from msgspec.structs import replace

from lss_motion.cli.dialog import servo_table
from lss_motion.playing.player.events import CheckedServo

PAN = CheckedServo(
    joint="pan",
    servo_id=7,
    model="LSS-HT1",
    firmware=370,
    status="limp",
    position_deg=-12.34,
    start_deg=30.0,
    voltage_v=11.96,
    temperature_c=31.4,
    speed_max_deg_s=180.0,
    accel_max_deg_s2=600.0,
)
SILENT = CheckedServo(
    joint="a_longer_name",
    servo_id=120,
    model=None,
    firmware=None,
    status=None,
    position_deg=0.0,
    start_deg=0.0,
    voltage_v=None,
    temperature_c=None,
    speed_max_deg_s=None,
    accel_max_deg_s2=None,
)


def test_what_was_found_is_a_line_each_with_where_it_is_and_how_far_it_has_to_go():
    head, pan, silent = servo_table([PAN, SILENT])
    assert pan.split() == [
        "pan",
        "7",
        "LSS-HT1",
        "370",
        "limp",
        "-12.3",
        "+42.3",
        "12.0",
        "31",
        "180",
        "600",
    ]
    assert silent.split() == [
        "a_longer_name",
        "120",
        "-",
        "-",
        "-",
        "0.0",
        "+0.0",
        "-",
        "-",
        "-",
        "-",
    ]
    assert [len(line) for line in (pan, silent)] == [len(head)] * 2


@pytest.mark.parametrize("name", ["pan", "left_front_shoulder", "a" * 60])
@pytest.mark.parametrize("model", ["LSS-HT1", "LSS-PRO-XT1-LONG"])
def test_the_table_fits_a_terminal_and_is_whole_where_it_is_asked_for(name, model):
    servos = [replace(PAN, joint=name, model=model, status="holding", position_deg=-179.96), SILENT]
    for rows in (servos, servos[:1]):
        table = servo_table(rows)
        assert max(map(len, table)) <= 80
        assert {"joint", "id", "at", "start"} <= set(table[0].split())
        assert "-180.0" in table[1]
        whole = servo_table(rows, is_whole=True)
        assert name in whole[1]
        assert len(whole[1].split()) == 11


def test_an_angle_that_is_rounded_to_0_has_no_sign():
    [_, row] = servo_table([replace(PAN, position_deg=-0.04, start_deg=-0.08)])
    assert "-0.0" not in row
