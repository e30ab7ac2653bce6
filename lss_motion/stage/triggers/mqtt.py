"""A broker of MQTT messages (triggers in, state and alerts out, Home Assistant), and a web hook.

All topics of a stage begin with `lss/STAGE`:

    cue/NAME      in   any message fires the cue
    enable/NAME   in   ON or OFF
    do            in   go, stop, estop, pause, resume, idle, rest, wake
    state         out  JSON, kept by the broker
    enabled/NAME  out  ON or OFF, kept by the broker
    event         out  JSON
    online        out  online or offline, kept by the broker

Besides these, the topics of cues with `mqtt` are triggers. A description of all this for Home
Assistant is kept at the broker. The library has a thread of its own, and connects again by itself.

`WebHook` sends faults as JSON by POST, with a few attempts. A hook that does not answer delays
nothing: at most `WAITING_MAX` alerts wait, the oldest is dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import math
import os
import re
import socket
import urllib.error
import urllib.request
from collections import deque
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

from msgspec import Struct

from lss_motion.errors import InputError, install_command
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as stage
from lss_motion.stage.triggers.sources import DEEDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from collections.abc import Set as AbstractSet

    from lss_motion.stage.triggers.sources import AllowList, Crossings, Gate, Sink

PAYLOAD_MAX_BYTES: Final = 256
PASSWORD_VARIABLE: Final = "LSS_MQTT_PASSWORD"  # noqa: S105  (the name of a variable)
PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
KEEP_ALIVE_S: Final = 20
DISCOVERY: Final = "homeassistant/device/{}/config"
"""The topic that Home Assistant reads from 2024.12 on: all of a device in one message."""


class Broker(Struct, frozen=True, kw_only=True):
    """Where the broker is, and how it is entered."""

    host: str
    port: int
    is_tls: bool = False
    user: str | None = None
    password: str | None = None

    def __repr__(self) -> str:
        """Return where it is; a password is not shown."""
        return f"Broker({self.host}:{self.port})"

    @property
    def has_password(self) -> bool:
        return self.password is not None


def broker_of(url: str, environment: Mapping[str, str] | None = None) -> Broker:
    """Return the broker of `mqtt://USER@HOST:PORT`; raises `InputError`.

    The password is in the environment variable `LSS_MQTT_PASSWORD`, or behind the user.
    """
    variables = os.environ if environment is None else environment
    found = urlsplit(url)
    try:
        port = found.port
    except ValueError:
        port = -1
    if found.scheme not in PORTS or not found.hostname or port == -1 or found.path.strip("/"):
        raise InputError(f"mqtt {_without_password(url)!r}: write mqtt://USER@HOST:PORT")
    password = unquote(found.password) if found.password else variables.get(PASSWORD_VARIABLE)
    return Broker(
        host=found.hostname,
        port=PORTS[found.scheme] if port is None else port,
        is_tls=found.scheme == "mqtts",
        user=unquote(found.username) if found.username else None,
        password=password if found.username else None,
    )


def _without_password(url: str) -> str:
    return re.sub(r":[^:@/]*@", ":…@", url)


def require_trusted(broker: Broker, allow: AllowList) -> None:
    """Raise `InputError` for a broker without a password outside of the addresses of `allow`."""
    if broker.has_password:
        return
    hosts = {broker.host}
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(broker.host)
    with contextlib.suppress(OSError):
        found = socket.getaddrinfo(broker.host, broker.port, type=socket.SOCK_STREAM)
        hosts = {str(one[4][0]) for one in found}
    if not all(allow.has(host) for host in hosts):
        raise InputError(
            f"the broker {broker.host} asks for no password, so everyone there could move the "
            f"robot; give a user and {PASSWORD_VARIABLE}, or add its address to `allow`"
        )


def base_of(stage: str) -> str:
    """Return what all topics of a stage begin with."""
    return f"lss/{_word(stage)}"


def _word(text: str) -> str:
    """Return text as one level of a topic, which `/`, `+` and `#` would divide."""
    return re.sub(r"[/+#\s\x00-\x1f]", "_", text)


def operation_of(
    topic: str, payload: bytes, base: str, cues: AbstractSet[str], levels: Crossings | None = None
) -> m.AnyOperation | None:
    """Return what a message asks for; None: nothing. Raises `InputError` if it is not possible.

    `cues` are the topics that trigger a cue. Of those in `levels` only numbers that cross a
    threshold count; of others all messages but 0, OFF and false, which are a button's release.
    """
    if len(payload) > PAYLOAD_MAX_BYTES:
        raise InputError(f"a message with more than {PAYLOAD_MAX_BYTES} bytes is ignored")
    text = payload.decode("utf-8", "replace").strip()
    if topic in cues:
        value = _number(text)
        if levels is not None and topic in levels:
            is_wanted = value is not None and levels.take(topic, value)
        else:
            is_wanted = text.casefold() not in ("off", "false") and value != 0.0
        return stage.Trigger(kind="mqtt", address=topic, value=value) if is_wanted else None
    own, _, name = topic.removeprefix(f"{base}/").partition("/")
    match own if topic.startswith(f"{base}/") else "":
        case "cue" if name:
            return stage.FireCue(label=name)
        case "enable" if name and text.casefold() in ("on", "off"):
            return stage.Enable(cue=name, is_enabled=text.casefold() == "on")
        case "do" if text in DEEDS:
            return m.parse_operation(json.dumps({"op": DEEDS[text]}))
        case _:
            raise InputError(f"{topic[:80]!r}: {text[:40]!r} is not possible")


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def discovery(stage: str, cues: Iterable[str], version: str) -> tuple[str, str]:
    """Return topic and message that describe a stage to Home Assistant."""
    base, name = base_of(stage), f"lss_{re.sub('[^A-Za-z0-9_-]', '_', stage)}"
    parts: dict[str, dict[str, object]] = {
        "state": {
            "platform": "sensor",
            "name": "State",
            "unique_id": f"{name}_state",
            "state_topic": f"{base}/state",
            "value_template": "{{ value_json.state }}",
            "json_attributes_topic": f"{base}/state",
        }
    }
    for deed, text in (("go", "GO"), ("stop", "Stop"), ("rest", "Rest")):
        parts[deed] = {
            "platform": "button",
            "name": text,
            "unique_id": f"{name}_{deed}",
            "command_topic": f"{base}/do",
            "payload_press": deed,
        }
    for cue in cues:
        key = re.sub("[^A-Za-z0-9_-]", "_", cue)
        parts[f"cue_{key}"] = {
            "platform": "button",
            "name": cue,
            "unique_id": f"{name}_cue_{key}",
            "command_topic": f"{base}/cue/{_word(cue)}",
            "payload_press": "fire",
        }
        parts[f"enable_{key}"] = {
            "platform": "switch",
            "name": f"{cue} enabled",
            "unique_id": f"{name}_enable_{key}",
            "command_topic": f"{base}/enable/{_word(cue)}",
            "state_topic": f"{base}/enabled/{_word(cue)}",
        }
    message = {
        "device": {"identifiers": [name], "name": stage, "model": "stage of lss_motion"},
        "origin": {"name": "lss_motion", "sw_version": version},
        "availability_topic": f"{base}/online",
        "components": parts,
    }
    return DISCOVERY.format(name), json.dumps(message, ensure_ascii=False)


class MqttLink:
    """The link to a broker. Whatever is published before it is connected is published then."""

    def __init__(
        self, broker: Broker, stage: str, gate: Gate, sink: Sink, note: Callable[[str], None]
    ) -> None:
        self.gate = gate
        self.base = base_of(stage)
        self.cues: AbstractSet[str] = frozenset()
        self.levels: Crossings | None = None
        self._broker, self._sink, self._note = broker, sink, note
        self._kept: dict[str, str] = {}
        """What the broker keeps, published again when it comes back."""
        self._client: Any = None
        self._has_reported = False
        self._loop = asyncio.get_running_loop()

    def open(self) -> None:
        """Begin to connect; raises `InputError` where the package is missing."""
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ModuleNotFoundError:
            raise InputError(f"MQTT needs a package: {install_command('stage')}") from None
        broker = self._broker
        client = self._client = Client(CallbackAPIVersion.VERSION2)
        if broker.user is not None:
            client.username_pw_set(broker.user, broker.password)
        if broker.is_tls:
            client.tls_set()
        client.will_set(f"{self.base}/online", "offline", qos=1, retain=True)
        client.reconnect_delay_set(1, 30)
        client.max_queued_messages_set(100)
        client.on_connect = lambda *found: self._call(self._connected, found[3])
        client.on_connect_fail = lambda *_: self._call(self._say, "cannot be reached")
        client.on_disconnect = lambda *_: self._call(self._say, "is gone")
        client.on_message = lambda *found: self._call(self._take, found[2])
        client.connect_async(broker.host, broker.port, KEEP_ALIVE_S)
        client.loop_start()

    def close(self) -> None:
        """Say that the stage is offline, and end the link."""
        if self._client is None:
            return
        with contextlib.suppress(ValueError, RuntimeError):
            self._client.publish(f"{self.base}/online", "offline", qos=1, retain=True)
        self._client.disconnect()
        self._client.loop_stop()

    def watch(self, cues: AbstractSet[str], levels: Crossings | None) -> None:
        """Take these topics as triggers from now on."""
        new = cues - self.cues
        self.cues, self.levels = cues, levels
        if self._client is not None and self._client.is_connected():
            self._subscribe(new)

    def keep(self, topic: str, message: str) -> None:
        """Publish what the broker shall keep, if it has changed."""
        if self._kept.get(topic) != message:
            self._kept[topic] = message
            self._publish(topic, message, is_kept=True)

    def tell(self, topic: str, message: str) -> None:
        """Publish what happened."""
        self._publish(topic, message, is_kept=False)

    def _publish(self, topic: str, message: str, *, is_kept: bool) -> None:
        if self._client is not None and self._client.is_connected():
            self._client.publish(topic, message, qos=1, retain=is_kept)

    def _call(self, do: Callable[..., None], *arguments: object) -> None:
        """Call in the thread of the server, from that of the library."""
        with contextlib.suppress(RuntimeError):  # The loop has ended.
            self._loop.call_soon_threadsafe(do, *arguments)

    def _connected(self, code: Any) -> None:  # noqa: ANN401  (of the library)
        if code.is_failure:
            self._say(f"refuses: {code}")
            return
        self._has_reported = False
        self._note(f"MQTT: connected to {self._broker.host}")
        self._subscribe({f"{self.base}/{own}" for own in ("cue/+", "enable/+", "do")} | self.cues)
        self._publish(f"{self.base}/online", "online", is_kept=True)
        for topic, message in self._kept.items():
            self._publish(topic, message, is_kept=True)

    def _subscribe(self, topics: Iterable[str]) -> None:
        if found := [(topic, 1) for topic in sorted(topics)]:
            self._client.subscribe(found)

    def _say(self, what: str) -> None:
        """Note once that there is no link, until there was one again."""
        if not self._has_reported:
            self._has_reported = True
            host, port = self._broker.host, self._broker.port
            self._note(f"MQTT: {host}:{port} {what}; it is tried again")

    def _take(self, message: Any) -> None:  # noqa: ANN401  (of the library)
        """Obey a message; not one that the broker has kept: it was sent some time ago."""
        now_s = self._loop.time()
        if message.retain or not self.gate.admits("127.0.0.1", now_s):
            return
        try:
            topic, payload = message.topic, bytes(message.payload)  # It decodes the topic here.
            operation = operation_of(topic, payload, self.base, self.cues, self.levels)
        except UnicodeDecodeError:
            self.gate.complaints.add("a topic that is not UTF-8 is ignored", now_s)
            return
        except InputError as error:
            self.gate.complaints.add(str(error), now_s)
            return
        if operation is not None:
            self._sink(operation, f"MQTT {topic}")


WAITING_MAX: Final = 32
TIMEOUT_S: Final = 10.0
ATTEMPTS: Final = 4
PAUSE_S: Final = 2.0
"""Before the second attempt; twice as long before each further one."""


class WebHook:
    """One address that gets alerts."""

    def __init__(self, url: str, note: Callable[[str], None], *, pause_s: float = PAUSE_S) -> None:
        self._url, self._note, self._pause_s = url, note, pause_s
        self._waiting: deque[bytes] = deque(maxlen=WAITING_MAX)
        self._task: asyncio.Task[None] | None = None

    def send(self, alert: Mapping[str, object]) -> None:
        """Send an alert soon; returns at once."""
        self._waiting.append(json.dumps(alert, ensure_ascii=False).encode())
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._send_all())

    async def close(self, wait_s: float = TIMEOUT_S) -> None:
        """Wait a while for what is being sent."""
        if self._task is not None:
            await asyncio.wait({self._task}, timeout=wait_s)
            self._task.cancel()

    async def _send_all(self) -> None:
        while self._waiting:
            body, problem = self._waiting.popleft(), None
            for attempt in range(ATTEMPTS):
                problem = await asyncio.to_thread(post, self._url, body)
                if problem is None:
                    break
                if attempt + 1 < ATTEMPTS:
                    await asyncio.sleep(self._pause_s * 2**attempt)
            else:
                self._note(f"alert: the web hook did not take it: {problem}")


def post(url: str, body: bytes) -> str | None:
    """Send a body; return what went wrong."""
    request = urllib.request.Request(  # noqa: S310  (the stage file names it)
        url, body, {"content-type": "application/json"}, method="POST"
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310
            return None
    except (OSError, ValueError) as error:  # HTTPError is an OSError, too.
        return str(error)
