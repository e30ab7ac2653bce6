"""stage.yaml → `Stage`: its robot, its shows, its cues and what they wait for.

Law: all problems of a file come in one `InputError`, each with its line. What could not be read
is left out of later checks, so that one mistake is reported once. The shows are found, not read:
`stage.check` plans them.
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake, read_yaml
from lss_motion.robot.load import load_robot
from lss_motion.robot.on_fault import Cause
from lss_motion.stage.model import (
    CueTrigger,
    DutyRule,
    Listen,
    LogRule,
    Stage,
    StageCue,
    StageFigure,
    StageShow,
    TriggerKind,
)
from lss_motion.stage.timecode.timecode import FPS_29_97_DROP, RATES, FrameRate, Timecode
from lss_motion.stage.triggering import clock_time, cron_problem

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import time, tzinfo

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.model import Robot
    from lss_motion.stage.file import (
        Budget,
        CueEntry,
        DutyEntry,
        ListenEntry,
        OnEntry,
        Retry,
        StageFile,
        Sync,
    )
    from lss_motion.stage.model import Side


SOURCES: Final[Mapping[TriggerKind, str]] = MappingProxyType(
    {
        TriggerKind.OSC: "osc",
        TriggerKind.HTTP: "http",
        TriggerKind.MQTT: "mqtt",
        TriggerKind.NOTE: "midi",
        TriggerKind.PROGRAM: "midi",
        TriggerKind.SACN: "sacn",
    }
)
"""The key of `listen` without which such a trigger would never come."""

OWN_KEYS: Final[Mapping[TriggerKind, frozenset[str]]] = MappingProxyType(
    {
        TriggerKind.SENSOR: frozenset({"below_mm", "above_mm", "below_raw", "above_raw"}),
        TriggerKind.OSC: frozenset({"above"}),
        TriggerKind.MQTT: frozenset({"above"}),
        TriggerKind.NOTE: frozenset({"channel"}),
        TriggerKind.PROGRAM: frozenset({"channel"}),
        TriggerKind.SACN: frozenset({"slot", "above"}),
        TriggerKind.TIMECODE: frozenset({"song"}),
    }
)

SACN_ABOVE: Final = 127.0
"""The upper half of a level from 0 to 255."""

RATE_FPS: Final = 25.0
"""Of the timecodes in a file, if nothing gives another rate."""


def load_stage(path: Path | str) -> Stage:
    """Return the stage of a file, with its robot.

    Raises `InputError` with file, line, value and remedy; its `more` holds all further problems,
    also those of the robot file.
    """
    from lss_motion.files.validation import validate
    from lss_motion.stage.file import CueEntry, OnEntry, StageFile

    source = read_yaml(Path(path))
    blank = CueEntry(cue="-", on=OnEntry())
    content, problems, left_out = validate(StageFile, source, blanks={"cues": blank})
    if content is None:
        raise source.error(problems)
    loader = _StageLoader(content, left_out, source)
    stage = loader.stage()
    problems += loader.problems
    own = [source.error(problems)] if problems else []
    if not own and not loader.errors:
        return stage
    top, *others = [*own, *loader.errors]
    raise InputError(top.reason, path=top.path, line=top.line, more=[*top.more, *others])


def stage_schema() -> dict[str, Any]:
    """Return the JSON Schema of a stage file."""
    from lss_motion.files.keys import json_schema
    from lss_motion.stage.file import StageFile

    return json_schema(StageFile)


def timecode_s(text: str, rate_fps: float) -> float | None:
    """Return the seconds of `hh:mm:ss:ff`, or of `hh:mm:ss;ff` with dropped frames.

    None: there is no such frame.
    """
    label = Timecode(*map(int, re.split("[:;]", text)))
    name = FPS_29_97_DROP.name if ";" in text else f"{rate_fps:g}"
    rate = RATES.get(name) or FrameRate(name, round(rate_fps), rate_fps)
    return label.at_s(rate) if label.is_valid(rate) else None


@dataclass(slots=True)
class _StageLoader:
    """Builds the stage of one file.

    `problems` are those of this file, `errors` those of other files.
    """

    content: StageFile
    left_out: frozenset[Location]
    source: YamlSource
    problems: list[Mistake] = field(default_factory=list)
    errors: list[InputError] = field(default_factory=list)

    def stage(self) -> Stage:
        content = self.content
        figures = self._figures()
        robot_path, robot = self._robot()
        return Stage(
            name=content.stage,
            path=self.source.path,
            robot_path=robot_path,
            robot=robot,
            shows=self._shows(),
            idle=self._show(content.idle, ("idle",)),
            cues=self._cues(robot),
            sync=self._sync(),
            listen=self._listen(content.listen, ("listen",)),
            duty=self._duty(content.duty),
            retry=self._retry(content.on_fault),
            alerts=content.alerts,
            log=LogRule(
                folder=self.source.path.parent / content.log.folder,
                max_bytes=round(content.log.max_mb * 1e6),
                ring_s=content.log.ring_s,
            ),
            zone=self._zone(),
            figures=figures,
            network=content.network,
            conductor=self._conductor(figures),
        )

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _is_left_out(self, *place: str) -> bool:
        return any(place[: len(part)] == part for part in self.left_out)

    # ---- robots and shows

    def _robot(self) -> tuple[Path | None, Robot | None]:
        name = self.content.robot
        if name is None:
            if not self.content.figures and not self._is_left_out("robot"):
                self._note((), "no robot: give 'robot: FILE', or 'figures' for several")
            return None, None
        if self.content.figures:
            self._note(("robot",), "robot does not go with figures, which have their own")
        return self._robot_at(name, ("robot",))

    def _robot_at(self, name: str, place: Location) -> tuple[Path, Robot | None]:
        path = self._file(name, place, "robot file")
        if not path.exists():
            return path, None
        try:
            return path, load_robot(path)
        except InputError as error:
            self.errors.append(error)
            return path, None

    def _file(self, name: str, place: Location, what: str) -> Path:
        path = self.source.path.parent / name
        if not path.exists():
            self._note(place, f"{what} {name!r} not found; looked for {path}")
        return path

    def _figures(self) -> Mapping[str, StageFigure]:
        figures = {}
        for name, entry in self.content.figures.items():
            place = ("figures", name)
            figures[name] = StageFigure(
                name=name,
                robot_path=self._robot_at(entry.robot, (*place, "robot"))[0],
                address=self._port(entry.address, (*place, "address")),
                listen=None
                if entry.listen is None
                else self._listen(entry.listen, (*place, "listen")),
                line=self.source.line(place),
            )
        return figures

    def _conductor(self, figures: Mapping[str, StageFigure]) -> str | None:
        name = self.content.conductor
        if name is not None and name not in figures and not self._is_left_out("figures"):
            self._note(("conductor",), f"no figure {name!r}; {known_names(name, figures)}")
        return name or next(iter(figures), None)

    def _shows(self) -> Mapping[str, StageShow]:
        shows = {}
        for name, files in self.content.shows.items():
            place: Location = ("shows", name)
            if isinstance(files, str):
                paths = {"": self._file(files, place, "show")}
            else:
                paths = {
                    figure: self._file(file, (*place, figure), "show")
                    for figure, file in files.items()
                }
                for figure in files:
                    if figure not in self.content.figures and not self._is_left_out("figures"):
                        known = known_names(figure, self.content.figures)
                        self._note((*place, figure), f"no figure {figure!r}; {known}")
            line = self.source.line(place)
            shows[name] = StageShow(name=name, paths=paths, line=line)
        return shows

    def _show(self, name: str | None, place: Location) -> str | None:
        """Return the name of a show; note it if there is none such."""
        shows = self.content.shows
        if name is not None and name not in shows and not self._is_left_out("shows", name):
            self._note(place, f"no show {name!r}; {known_names(name, shows)}")
        return name

    # ---- cues

    def _cues(self, robot: Robot | None) -> tuple[StageCue, ...]:
        cues: dict[str, StageCue] = {}
        names = [entry.cue for entry in self.content.cues]
        for index, entry in enumerate(self.content.cues):
            place: Location = ("cues", index)
            if place in self.left_out:
                continue
            if entry.cue in cues:
                line = cues[entry.cue].line
                self._note((*place, "cue"), f"{entry.cue!r} is given twice, first in line {line}")
                continue
            cues[entry.cue] = cue = self._cue(entry, place, robot, names)
            first = next(one for one in cues.values() if one.is_ready or one is cue)
            if cue.is_ready and first is not cue:
                text = f"the robot waits for one cue only, {first.name!r} in line {first.line}"
                self._note((*place, "ready"), text)
        return tuple(cues.values())

    def _cue(
        self, entry: CueEntry, place: Location, robot: Robot | None, names: list[str]
    ) -> StageCue:
        trigger = self._trigger(entry.on, (*place, "on"), robot)
        named = entry.play if isinstance(entry.play, list) else [entry.play]
        shows = [name for name in named if name is not None]
        for number, show in enumerate(shows):
            inner = (number,) if isinstance(entry.play, list) else ()
            self._show(show, (*place, "play", *inner))
        if shows and entry.do is not None:
            self._note((*place, "do"), "a cue has 'play' or 'do', not both")
        if not (shows or entry.do or entry.enable or entry.disable):
            self._note(place, "does nothing: give 'play', 'do', 'enable' or 'disable'")
        for key in ("start", "choose", "cooldown_s"):
            if key in entry.given and not shows:
                self._note((*place, key), f"{key} belongs to play")
        follows = self._follows(entry, place, trigger)
        for key in ("enable", "disable"):
            for number, name in enumerate(getattr(entry, key)):
                if name not in names:
                    self._note(
                        (*place, key, number), f"no cue {name!r}; {known_names(name, names)}"
                    )
        return StageCue(
            name=entry.cue,
            on=trigger,
            shows=tuple(shows),
            choice=entry.choose,
            deed=entry.do,
            start=entry.start,
            priority=entry.priority,
            cooldown_s=entry.cooldown_s,
            follows=follows,
            is_ready=entry.ready,
            is_enabled=entry.enabled,
            enables=tuple(entry.enable),
            disables=tuple(entry.disable),
            line=self.source.line(place),
        )

    def _follows(self, entry: CueEntry, place: Location, trigger: CueTrigger) -> bool:
        """Return whether the show of a cue follows the timecode; note keys that do not belong."""
        if entry.start == "add" and self.content.figures:
            text = "figures play one show together: add does not go with them; queue, or interrupt"
            self._note((*place, "start"), text)
        if "follow" in entry.given and trigger.kind is not TriggerKind.TIMECODE:
            self._note((*place, "follow"), "follow belongs to a trigger of timecode")
        follows = entry.follow and trigger.kind is TriggerKind.TIMECODE
        can_wait = follows and isinstance(entry.play, str) and entry.start != "add"
        if entry.ready and not can_wait:
            text = "ready belongs to a cue that plays one show in step with the timecode"
            self._note((*place, "ready"), text)
        return follows

    def _trigger(self, entry: OnEntry, place: Location, robot: Robot | None) -> CueTrigger:
        given = entry.given
        kinds = [kind for kind in TriggerKind if kind in given]
        if len(kinds) != 1:
            known = ", ".join(kind for kind in TriggerKind if kind is not TriggerKind.CUE)
            self._note(place, f"a trigger is one of: {known}")
            return CueTrigger(kind=TriggerKind.CUE)
        kind = kinds[0]
        for key in sorted(given - {kind} - OWN_KEYS.get(kind, frozenset())):
            self._note((*place, key), f"{key} does not belong to {kind}")
        self._check_source(kind, place)
        match kind:
            case TriggerKind.SENSOR:
                return self._sensor(entry, place, robot)
            case TriggerKind.TIME:
                return self._time(str(entry.time), place)
            case TriggerKind.TIMECODE:
                return self._timecode(str(entry.timecode), entry.song or "", place)
            case TriggerKind.SACN:
                return self._sacn(entry, place)
            case TriggerKind.START | TriggerKind.GO:
                if getattr(entry, kind) is not True:
                    self._note((*place, kind), f"{kind} can only be true")
                return CueTrigger(kind=kind)
        return self._message(kind, entry, place)

    def _message(self, kind: TriggerKind, entry: OnEntry, place: Location) -> CueTrigger:
        """Return the trigger of a message with an address, and maybe with a value."""
        if kind is TriggerKind.END_OF:
            self._show(entry.end_of, (*place, kind))
        side: Side | None = None if entry.above is None else "above"
        return CueTrigger(
            kind=kind,
            address=str(getattr(entry, kind)),
            side=side,
            threshold=entry.above or 0.0,
            channel=entry.channel,
        )

    def _check_source(self, kind: TriggerKind, place: Location) -> None:
        """Note a trigger that would never come, since nothing listens for it."""
        key = SOURCES.get(kind)
        entries = [self.content.listen, *(one.listen for one in self.content.figures.values())]
        if key is None or self._is_left_out("listen") or self._is_left_out("figures"):
            return
        if not any(entry is not None and getattr(entry, key) for entry in entries):
            self._note((*place, kind), f"nothing listens for it; give '{key}' under listen")

    def _sensor(self, entry: OnEntry, place: Location, robot: Robot | None) -> CueTrigger:
        assert entry.sensor is not None
        plain = CueTrigger(kind=TriggerKind.SENSOR, address=entry.sensor)
        if robot is None:
            if self.content.figures:
                self._note((*place, "sensor"), "sensors belong to one robot, not to figures")
            return plain
        sensor = robot.sensors.get(entry.sensor)
        if sensor is None:
            known = known_names(entry.sensor, robot.sensors)
            reason = f"robot {robot.name!r} has no sensor {entry.sensor!r}; {known}"
            self._note((*place, "sensor"), reason)
            return plain
        keys = [key for key in OWN_KEYS[TriggerKind.SENSOR] if key in entry.given]
        allowed = (f"below_{sensor.unit}", f"above_{sensor.unit}")
        if len(keys) != 1 or keys[0] not in allowed:
            reason = f"a sensor of kind {sensor.kind} needs one of {allowed[0]} and {allowed[1]}"
            self._note(place, reason)
            return plain
        side: Side = "below" if keys[0] == allowed[0] else "above"
        threshold = float(getattr(entry, keys[0]))
        return CueTrigger(
            kind=TriggerKind.SENSOR, address=sensor.name, side=side, threshold=threshold
        )

    def _sacn(self, entry: OnEntry, place: Location) -> CueTrigger:
        if entry.slot is None:
            self._note(place, "sacn needs slot, from 1 to 512")
        return CueTrigger(
            kind=TriggerKind.SACN,
            address=f"{entry.sacn}/{entry.slot}",
            side="above",
            threshold=SACN_ABOVE if entry.above is None else entry.above,
        )

    def _time(self, text: str, place: Location) -> CueTrigger:
        try:
            reason = cron_problem(text)
        except InputError as error:
            reason = error.reason
        if reason:
            self._note((*place, "time"), f"{text!r} {reason}")
        return CueTrigger(kind=TriggerKind.TIME, address=text)

    def _timecode(self, text: str, song: str, place: Location) -> CueTrigger:
        source = self.content.sync.timecode
        if source is None and not self._is_left_out("sync"):
            self._note((*place, "timecode"), "there is no timecode; give one under sync")
        rate_fps = RATE_FPS if source is None or source.rate_fps is None else source.rate_fps
        at_s = timecode_s(text, rate_fps)
        if at_s is None:
            reason = f"there is no frame {text} at {rate_fps:g} frames a second"
            self._note((*place, "timecode"), reason)
        if song and source is not None and source.source != "fpp":
            self._note((*place, "song"), f"{source.source} does not say which song is played")
        return CueTrigger(kind=TriggerKind.TIMECODE, address=text, at_s=at_s or 0.0, song=song)

    # ---- the rest

    def _sync(self) -> Sync:
        sync = self.content.sync
        from lss_motion.stage.stage_timecode import send_spec_of, spec_of

        if sync.timecode is not None:
            try:
                spec_of(sync.timecode)
            except InputError as error:
                self._note(("sync", "timecode", "input"), error.reason)
        if sync.send and self.content.figures:
            text = (
                "a stage with figures does not send its clock: take send out, and let lights and "
                "sound follow the timecode that the figures follow (sync: {timecode: …})"
            )
            self._note(("sync", "send"), text)
        for index, output in enumerate(sync.send):
            try:
                send_spec_of(output)
            except InputError as error:
                self._note(("sync", "send", index), error.reason)
        return sync

    def _listen(self, entry: ListenEntry, place: Location) -> Listen:
        for index, network in enumerate(entry.allow):
            try:
                ipaddress.ip_network(network)
            except ValueError as error:
                self._note((*place, "allow", index), f"{network!r} is no network: {error}")
        feedback = [
            self._port(text, (*place, "feedback", index))
            for index, text in enumerate(entry.feedback)
        ]
        return Listen(
            http=self._port(entry.http, (*place, "http")),
            osc=self._port(entry.osc, (*place, "osc")),
            feedback=tuple(port for port in feedback if port is not None),
            midi=entry.midi,
            sacn=entry.sacn,
            mqtt=entry.mqtt,
            allow=tuple(entry.allow),
            line=self.source.line(place),
        )

    def _port(self, text: str | None, place: Location) -> tuple[str, int] | None:
        if text is None:
            return None
        host, _, digits = text.rpartition(":")
        if not 0 < int(digits) < 65_536:
            self._note(place, f"port {digits} is not from 1 to 65535")
        return host.strip("[]"), int(digits)

    def _duty(self, entry: DutyEntry) -> DutyRule:
        place = "duty"
        self._show(entry.rest, (place, "rest"))
        for key in ("limp", "temperature_c", "current_a"):
            if self.content.figures and key in entry.given:
                text = (
                    f"{key} belongs to one robot: with figures, each has on_fault in its robot file"
                )
                self._note((place, key), text)
        if entry.limp and entry.rest is None:
            self._note((place, "limp"), "limp needs rest, a show that goes to a pose that stands")
        return DutyRule(
            work_s=entry.work_s,
            rest_s=entry.rest_s,
            rest=entry.rest,
            is_limp=entry.limp,
            temperature_c=self._budget(entry.temperature_c, (place, "temperature_c")),
            current_a=self._budget(entry.current_a, (place, "current_a")),
            slow_ratio=entry.slow_ratio,
            quiet=tuple(self._quiet(entry.quiet)),
        )

    def _budget(self, budget: Budget | None, place: Location) -> Budget | None:
        if budget is not None and budget.slow >= budget.rest:
            text = f"slow ({budget.slow:g}) must be below rest ({budget.rest:g})"
            self._note((*place, "slow"), text)
        return budget

    def _quiet(self, spans: list[str]) -> list[tuple[time, time]]:
        found = []
        for index, span in enumerate(spans):
            begin, end = map(clock_time, span.split("-"))
            if begin is None or end is None or begin == end:
                self._note(("duty", "quiet", index), f"{span!r}: two times such as 23:00-08:00")
            else:
                found.append((begin, end))
        return found

    def _retry(self, entry: Retry) -> Retry:
        for name in entry.attempts:
            if name not in list(Cause):
                reason = f"no kind of fault {name!r}; {known_names(name, map(str, Cause))}"
                self._note(("on_fault", "attempts", name), reason)
        return entry

    def _zone(self) -> tzinfo | None:
        name = self.content.time_zone
        if name is None:
            return None
        import zoneinfo

        try:
            return zoneinfo.ZoneInfo(name)
        except (OSError, ValueError, zoneinfo.ZoneInfoNotFoundError):
            known = known_names(name, sorted(zoneinfo.available_timezones()))
            self._note(("time_zone",), f"no time zone {name!r}; {known}")
            return None
