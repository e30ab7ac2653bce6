"""`lss-motion doctor`: every problem is named with its fix, and no check ends the others."""

from __future__ import annotations

from importlib import metadata

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE
from lss_motion.system import computer
from lss_motion.system.computer import Level
from lss_motion.system.devices import SerialDevice

US = 1000


def only(findings):
    (finding,) = findings
    return finding


def test_this_computer_is_examined_from_python_to_its_timer(capsys, monkeypatch):
    monkeypatch.setattr(computer, "JITTER_WAITS", 5)
    assert main(["doctor"]) == EXIT_FINISHED
    out = capsys.readouterr().out
    for subject in ("Python", "packages", "port", "clock", "timer", "simulated ports"):
        assert f"  {subject}" in out
    assert "could not be checked" not in out


def test_packages_are_compared_with_the_required_ones():
    installed = {"numpy": "1.26.4", "rich": "13.10.0"}

    def version_of(name):
        if name not in installed:
            raise metadata.PackageNotFoundError(name)
        return installed[name]

    def check(*required):
        return only(computer.check_packages(required, version_of))

    assert check("numpy>=1.26", "rich>=13.7", 'pytest>=8; extra == "dev"').level is Level.OK
    assert check("numpy>=1.26", "rich>=13.7").text == "all 2 are there"
    old = check("numpy>=2.0", "rich>=13.7")
    assert (old.level, old.text) == (Level.BAD, "numpy 1.26.4 is older than 2.0")
    assert check("toppra>=0.6", "rich").text == "toppra is missing"


def test_a_port_without_permission_names_the_group(monkeypatch, capsys):
    import grp

    port = SerialDevice(path="/dev/null", name="FT232R USB UART (A5XK)", is_usb=True)
    monkeypatch.setattr(computer, "list_devices", lambda: [port])
    monkeypatch.setattr(computer, "JITTER_WAITS", 5)
    assert only(computer.check_ports()).level is Level.OK
    monkeypatch.setattr("os.access", lambda *_: False)
    monkeypatch.setattr(grp, "getgrgid", lambda _: grp.struct_group(("dialout", "x", 20, [])))
    finding = only(computer.check_ports())
    assert (finding.level, finding.text) == (Level.BAD, "/dev/null, FT232R USB UART (A5XK)")
    assert "sudo usermod -aG dialout" in finding.fix
    assert main(["doctor"]) == EXIT_UNREACHABLE
    assert "BAD   port" in capsys.readouterr().out


def test_a_slow_latency_timer_is_named_with_its_file(tmp_path):
    folder = tmp_path / "sys/bus/usb-serial/devices/ttyUSB0"
    folder.mkdir(parents=True)
    for text, level in (("16\n", Level.HINT), ("1\n", Level.OK)):
        (folder / "latency_timer").write_text(text)
        finding = only(computer.check_latency(tmp_path))
        assert (finding.level, finding.text) == (level, f"/dev/ttyUSB0: {text.strip()} ms")
        assert (str(folder / "latency_timer") in finding.fix) == (level is Level.HINT)


def test_programs_that_grab_ports_are_named(tmp_path):
    for number, name in ((1, "init"), (77, "ModemManager"), (78, "brltty")):
        (tmp_path / f"proc/{number}").mkdir(parents=True)
        (tmp_path / f"proc/{number}/comm").write_text(f"{name}\n")
    said = [finding.text for finding in computer.check_grabbers(tmp_path)]
    assert said == ["ModemManager is running", "brltty is running"]


@pytest.mark.parametrize(("steps_ns", "level"), [(50, Level.OK), (15_000_000, Level.HINT)])
def test_a_coarse_clock_is_reported(steps_ns, level):
    assert only(computer.check_clock(steps_ns)).level is level


def test_a_late_timer_is_judged_by_its_99th_percentile():
    quick = [60 * US] * 99 + [5000 * US]
    finding = only(computer.check_timer(quick))
    assert (finding.level, "5000 us at worst" in finding.text) == (Level.OK, True)
    slow = [60 * US] * 97 + [1500 * US] * 3
    finding = only(computer.check_timer(slow))
    assert finding.level is Level.HINT
    assert "1500 us in one of a hundred" in finding.text
    assert "--real-time" in finding.fix


def test_a_cpu_that_saves_power_is_reported(tmp_path):
    assert computer.check_governor(tmp_path) == []
    folder = tmp_path / "sys/devices/system/cpu/cpu0/cpufreq"
    folder.mkdir(parents=True)
    (folder / "scaling_governor").write_text("powersave\n")
    assert only(computer.check_governor(tmp_path)).level is Level.HINT


def test_a_check_that_fails_does_not_end_the_others(monkeypatch, capsys):
    def fail(*_):
        raise OSError("a device that nobody knows")

    for name in ("check_ports", "check_timer", "check_clock", "check_packages"):
        monkeypatch.setattr(computer, name, fail)
    assert main(["doctor"]) == EXIT_FINISHED
    out = capsys.readouterr().out
    assert out.count("could not be checked: OSError: a device that nobody knows") == 4
    assert "ok    Python" in out


def test_a_missing_package_is_an_error_of_its_own(monkeypatch, capsys):
    monkeypatch.setattr(computer, "JITTER_WAITS", 5)
    monkeypatch.setattr(metadata, "requires", lambda _: ["no-such-package>=1"])
    assert main(["doctor"]) == EXIT_INPUT
    assert "no-such-package is missing" in capsys.readouterr().out
