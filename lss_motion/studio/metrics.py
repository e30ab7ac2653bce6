"""What Prometheus is told of a stage: counts of shows, cues and faults, and the health of servos.

Everything comes from the events of the player; nothing is asked for a scrape.
"""

from __future__ import annotations

from typing import Any, Final

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    Counter,
    Gauge,
    disable_created_metrics,
    generate_latest,
)

STATES: Final = (
    "off",
    "waits_for_port",
    "connecting",
    "idle",
    "plays",
    "rests",
    "given_up",
    "stopped",
)

TIMECODE_STATES: Final = (
    "searching",
    "locked",
    "freewheeling",
    "lost",
    "standing",
    "reverse",
    "off_speed",
)


class Metrics:
    """The metrics of one stage, in a registry of their own."""

    def __init__(self) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]  # Instants that no question about a figure needs.
        own = self.registry = CollectorRegistry()
        self.state = Gauge("lss_stage_state", "1 for the present state", ["state"], registry=own)
        self.notes = Counter("lss_stage_notes", "Notes of the director", ["kind"], registry=own)
        self.cues = Counter("lss_cues", "Cues, fired or refused", ["cue", "result"], registry=own)
        self.shows = Counter("lss_shows", "Shows that have begun", ["show"], registry=own)
        self.faults = Counter("lss_faults", "Faults", ["joint", "kind"], registry=own)
        self.starts = Counter("lss_player_starts", "Starts of the player", registry=own)
        self.messages = Counter(
            "lss_messages", "Messages of other programs", ["source", "result"], registry=own
        )
        self.temperature_c = self._of_joint("temperature_celsius", "Temperature")
        self.voltage_v = self._of_joint("voltage_volts", "Voltage at the servo")
        self.current_a = self._of_joint("current_amperes", "Current of the servo")
        self.error_deg = self._of_joint("error_degrees", "Planned minus measured angle")
        self.use_ratio = Gauge("lss_line_use_ratio", "Use of a line", ["bus"], registry=own)
        self.timecode = Gauge(
            "lss_timecode_state", "1 for the present state of the timecode", ["state"], registry=own
        )
        self.timecode_rate = Gauge("lss_timecode_rate_ratio", "Rate of the timecode", registry=own)
        self.timecode_off_s = Gauge(
            "lss_timecode_off_seconds", "Timecode minus the show that follows it", registry=own
        )
        self.late_s = Gauge("lss_late_seconds", "Latest move of this show", registry=own)
        self.note_state("off")

    def _of_joint(self, name: str, text: str) -> Gauge:
        return Gauge(f"lss_joint_{name}", text, ["joint"], registry=self.registry)

    def note_state(self, state: str) -> None:
        """Note the state of the stage."""
        for one in STATES:
            self.state.labels(one).set(one == state)

    def take(self, event: dict[str, Any]) -> None:
        """Take an event of the player."""
        match event["event"]:
            case "started":
                self.starts.inc()
            case "stage":
                self.note_state(event["state"])
                self._take_timecode(event.get("timecode"))
            case "stage_note":
                self._take_note(event)
            case "fault":
                self.faults.labels(event["joint"], event["kind"]).inc()
            case "health":
                self._take_health(event)

    def _take_note(self, note: dict[str, Any]) -> None:
        kind = note["kind"]
        self.notes.labels(kind).inc()
        if kind in ("fired", "refused") and note.get("cue"):
            self.cues.labels(note["cue"], kind).inc()
        elif kind == "started" and note.get("show"):
            self.shows.labels(note["show"]).inc()

    def _take_timecode(self, timecode: dict[str, Any] | None) -> None:
        if timecode is None:
            return
        for one in TIMECODE_STATES:
            self.timecode.labels(one).set(one == timecode["state"])
        if timecode["rate"] is not None:
            self.timecode_rate.set(timecode["rate"])
        if timecode["off_ms"] is not None:
            self.timecode_off_s.set(timecode["off_ms"] / 1e3)

    def _take_health(self, health: dict[str, Any]) -> None:
        for name, joint in health["joints"].items():
            for gauge, key in (
                (self.temperature_c, "temperature_c"),
                (self.voltage_v, "voltage_v"),
                (self.current_a, "current_a"),
                (self.error_deg, "error_deg"),
            ):
                if joint[key] is not None:
                    gauge.labels(name).set(joint[key])
        for name, bus in health["buses"].items():
            self.use_ratio.labels(name).set(bus["use_ratio"])
        self.late_s.set(health["late_us"] / 1e6)

    def text(self) -> tuple[bytes, str]:
        """Return what a scrape gets, and its type."""
        return generate_latest(self.registry), CONTENT_TYPE_LATEST
