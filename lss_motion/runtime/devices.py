"""The serial devices of this computer: their names, and what keeps us from opening one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A serial port that the system knows. `name` is what its USB chip calls itself."""

    path: str
    name: str
    is_usb: bool


def list_devices() -> list[Device]:
    """Return the serial ports of this computer, those on USB first."""
    from serial.tools.list_ports import comports

    found = [
        Device(path=port.device, name=_name(port), is_usb=port.vid is not None)
        for port in comports()
    ]
    return sorted(found, key=lambda device: (not device.is_usb, device.path))


def permission_hint(path: str) -> str:
    """Return how to get the permission to open a device: which group to join, where there is one.

    Never raises.
    """
    try:
        import grp

        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        user = os.environ.get("USER") or "$USER"
    except (ImportError, KeyError, OSError):
        return "no permission; on Linux join the group that owns it, usually `dialout`"
    if group == "root":
        return (
            "no permission: it belongs to root alone. `sudo chmod a+rw` helps until it is plugged "
            "in again; a udev rule that gives it to `dialout` helps for good"
        )
    return (
        f"no permission: it belongs to the group `{group}`. Join it with "
        f"`sudo usermod -aG {group} {user}`, then log out and in again"
    )


def _name(port: object) -> str:
    """Return what a port of pyserial's list is called, and its serial number where it has one."""
    words = [getattr(port, key, None) for key in ("manufacturer", "product")]
    name = " ".join(str(word) for word in words if word)
    if not name:
        description = getattr(port, "description", None)
        name = "" if description in (None, "n/a") else str(description)
    serial_number = getattr(port, "serial_number", None)
    return f"{name} ({serial_number})" if serial_number else name or "no name"
