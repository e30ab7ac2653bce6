"""The command `install-service`: what it writes, what it leaves alone, what it removes."""

from __future__ import annotations

import os
import pwd

import pytest

from lss_motion.cli import stages
from lss_motion.cli.main import main
from lss_motion.system.service import MARK

USER = next(one.pw_name for one in pwd.getpwall() if one.pw_uid)
STAGE = "stage: hall\nrobot: arm.yaml\nshows: {a: a.yaml}\n"


@pytest.fixture
def run(tmp_path, capsys):
    (tmp_path / "hall of fear.yaml").write_text(STAGE)

    def run(*words):
        command = ["install-service", str(tmp_path / "hall of fear.yaml"), "--user", USER]
        code = main([*command, "--folder", str(tmp_path), *words])
        out, errors = capsys.readouterr()
        return code, out, errors

    return run


def test_a_unit_is_shown_written_and_removed(run, tmp_path):
    path = tmp_path / "lss-hall_of_fear.service"
    code, shown, _ = run("--print", "--port", "/dev/ttyUSB0")
    assert code == 0
    assert not path.exists()
    assert f"User={USER}" in shown
    assert "--wait-port --real-time --port /dev/ttyUSB0" in shown
    assert f'serve "{tmp_path}/hall of fear.yaml"' in shown
    code, out, _ = run()
    assert code == 0
    assert path.read_text().startswith(MARK)
    assert "sudo systemctl enable lss-hall_of_fear.service" in out, "systemd does not run here"
    assert run()[0] == 0, "a unit of ours is written anew"
    assert run("--remove")[0] == 0
    assert not path.exists()
    code, _, errors = run("--remove")
    assert (code, "there is no such unit" in errors) == (2, True)


def test_a_unit_of_another_is_left_as_it_is(run, tmp_path):
    path = tmp_path / "lss-hall_of_fear.service"
    path.write_text("[Unit]\n")
    for words in ((), ("--remove",)):
        code, _, errors = run(*words)
        assert code == 2
        assert "was not written by install-service" in errors
    assert path.read_text() == "[Unit]\n"


def test_a_stage_never_runs_as_root(run, monkeypatch, tmp_path):
    code, _, errors = run("--user", "root", "--print")
    assert (code, "does not run as root" in errors) == (2, True)
    code, _, errors = run("--user", "no_such_user", "--print")
    assert (code, "there is no user no_such_user" in errors) == (2, True)
    monkeypatch.setattr(os, "access", lambda *_: False)
    code, _, errors = run()
    assert (code, "run it as root: sudo" in errors) == (2, True)


def test_what_systemd_refuses_is_not_written(run, monkeypatch, tmp_path):
    if stages.shutil.which("systemd-analyze") is None:
        pytest.skip("sudo apt install systemd")
    monkeypatch.setattr(stages.sys, "executable", "/no/python")
    code, _, errors = run()
    assert (code, "systemd refuses the unit" in errors) == (2, True)
    assert not (tmp_path / "lss-hall_of_fear.service").exists()
