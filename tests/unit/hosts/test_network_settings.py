"""Nothing is open to a network by itself; keys say who may do what."""

import pytest

from lss_motion.errors import InputError
from lss_motion.stage.hosts.peer import (
    NetworkSettings,
    check_settings,
    configuration,
    make_keys,
)


def settings(**changes):
    plain = {"stage": "hall", "figure": "left", "conductor": "left", "figures": ["left", "right"]}
    return NetworkSettings(**{**plain, **changes})


def test_by_default_only_this_computer_reaches_the_conductor():
    plain = configuration(settings())
    assert plain["listen"]["endpoints"] == ["tcp/127.0.0.1:7447"]
    assert plain["connect"]["endpoints"] == []
    assert plain["scouting"] == {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    other = configuration(settings(figure="right"))
    assert other["listen"]["endpoints"] == []
    assert other["connect"]["endpoints"] == ["tcp/127.0.0.1:7447"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"address": "192.168.1.20:7447"}, "there are no keys"),
        ({"address": "0.0.0.0:7447"}, "there are no keys"),
        ({"address": "[fe80::1%eth0]:7447"}, "there are no keys"),
        ({"scouting": "eth0"}, "there are no keys"),
        ({"address": "192.168.1.20"}, "HOST:PORT"),
        ({"address": "127.0.0.1:70000"}, "HOST:PORT"),
        ({"figure": "middle"}, "it has left, right"),
    ],
)
def test_what_is_open_or_wrong_is_refused(changes, text):
    with pytest.raises(InputError, match=text):
        check_settings(settings(**changes))


@pytest.mark.parametrize("address", ["127.0.0.1:7447", "[::1]:7447", "localhost:7447"])
def test_the_loopback_needs_no_keys(address):
    check_settings(settings(address=address))


def test_a_trusted_network_needs_no_keys():
    check_settings(settings(address="192.168.1.20:7447", is_trusted=True))


def test_keys_are_made_once_and_for_new_figures(tmp_path):
    from cryptography import x509

    first = make_keys("hall", ["left", "right"], tmp_path)
    assert {path.name for path in first} == {
        "ca.pem",
        "ca.key",
        "left.pem",
        "left.key",
        "right.pem",
        "right.key",
    }
    assert all(path.stat().st_mode & 0o077 == 0 for path in first)
    more = make_keys("hall", ["left", "right", "middle"], tmp_path)
    assert {path.name for path in more} == {"middle.pem", "middle.key"}
    authority = x509.load_pem_x509_certificate((tmp_path / "ca.pem").read_bytes())
    for name in ("left", "middle"):
        own = x509.load_pem_x509_certificate((tmp_path / f"{name}.pem").read_bytes())
        own.verify_directly_issued_by(authority)
        assert own.subject.rfc4514_string() == f"CN={name}"
    check_settings(settings(address="192.168.1.20:7447", keys=tmp_path))
    (tmp_path / "right.key").unlink()
    with pytest.raises(InputError, match=r"right\.key is missing"):
        check_settings(settings(figure="right", address="192.168.1.20:7447", keys=tmp_path))


def test_half_of_an_authority_makes_no_keys(tmp_path):
    make_keys("hall", ["left"], tmp_path)
    (tmp_path / "ca.key").unlink()
    with pytest.raises(InputError, match="both are needed"):
        make_keys("hall", ["left", "right"], tmp_path)


def test_a_figure_may_only_speak_for_itself(tmp_path):
    make_keys("hall", ["left", "right"], tmp_path)
    rules = configuration(settings(keys=tmp_path))["access_control"]
    assert rules["default_permission"] == "deny"
    said = {rule["id"]: rule["key_exprs"] for rule in rules["rules"]}
    assert said["right-says"] == ["hall/figure/right/**"]
    assert said["left-says"] == ["hall/**"]
