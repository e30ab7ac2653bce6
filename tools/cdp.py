"""A small client of the Chrome DevTools Protocol, for tests, bench and pictures of the pages.

    with Browser() as browser, browser.page(1366, 768) as page:
        page.go("http://127.0.0.1:8000/")
        page.wait("document.querySelector('h1')")
        page.click("#stop")

One browser serves many pages; each has cookies and storage of its own. Everything waits for what it
asked for; nothing sleeps for a time that was guessed.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from websockets.sync.client import connect

if TYPE_CHECKING:
    from collections.abc import Iterator

NAMES: Final = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
START_S: Final = 30.0
ANSWER_S: Final = 30.0
FLAGS: Final = (
    "--headless",
    "--no-sandbox",  # In containers there is none; only pages of our own are opened.
    "--disable-gpu-sandbox",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--no-first-run",
    "--no-default-browser-check",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
)
KEY_CODES: Final = {"Escape": 27, "Enter": 13, "Tab": 9, " ": 32, "Home": 36, "End": 35}
KEY_CODES_ARROWS: Final = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}
MODIFIERS: Final = {"Alt": 1, "Control": 2, "Shift": 8}


def found_browser() -> str | None:
    """Return the program of a browser: that of `LSS_BROWSER`, or one of `NAMES`; None: none."""
    chosen = os.environ.get("LSS_BROWSER")
    if chosen:
        return shutil.which(chosen)
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class CdpError(Exception):
    """What the browser, or a script in it, refused."""


class Browser:
    """A headless browser with a profile of its own. A context manager."""

    def __init__(self, program: str | None = None, *flags: str) -> None:
        """Start it; raises `FileNotFoundError` if there is none."""
        program = program or found_browser()
        if program is None:
            raise FileNotFoundError("no browser; run tools/browser")
        self._profile = tempfile.TemporaryDirectory(
            prefix="lss-browser-", ignore_cleanup_errors=True
        )
        words = [program, *FLAGS, *flags, f"--user-data-dir={self._profile.name}", "about:blank"]
        self._process = subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self._ids = count(1)
        self._pages: dict[str, Page] = {}
        self._stack = contextlib.ExitStack()
        # No pings: their thread takes from the global random numbers, which Hypothesis notices in
        # tests of the same process. A browser that is gone closes the socket.
        linked = connect(self._address(), max_size=None, compression=None, ping_interval=None)
        self._socket = self._stack.enter_context(linked)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """The process of the browser itself; its parts are in the same process group."""
        return self._process.pid

    @property
    def cpu_s(self) -> float:
        """CPU time of the browser and all its parts so far (Linux)."""
        ticks = sum(int(fields[11]) + int(fields[12]) for _, fields in self._parts())
        return ticks / os.sysconf("SC_CLK_TCK")

    @property
    def memory_mb(self) -> float:
        """Memory of the browser and all its parts; what they share counts once (Linux)."""
        total_kb = 0
        for place, _ in self._parts():
            with contextlib.suppress(OSError):
                text = (place / "smaps_rollup").read_text()
                total_kb += int(text.partition("\nPss:")[2].split()[0])
        return total_kb * 1024 / 1e6

    def _parts(self) -> Iterator[tuple[Path, list[str]]]:
        """Yield each process of the browser: its folder, and its `stat` from the state on."""
        for place in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                fields = (place / "stat").read_text().rpartition(")")[2].split()
                if int(fields[2]) == self.pid:
                    yield place, fields

    def close(self) -> None:
        """End the browser and all its parts."""
        with contextlib.suppress(Exception):
            self._stack.close()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(ANSWER_S)
        self._profile.cleanup()

    @contextlib.contextmanager
    def page(self, width: int = 1366, height: int = 768, *, touch: bool = False) -> Iterator[Page]:
        """Open a page with cookies of its own; it is closed at the end."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        made = {"url": "about:blank", "browserContextId": context}
        target = self.call("Target.createTarget", **made)["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self._pages[session] = Page(self, session)
        for domain in ("Page", "Runtime", "Network"):
            page.call(f"{domain}.enable")
        page.resize(width, height)
        if touch:
            page.call("Emulation.setTouchEmulationEnabled", enabled=True)
        try:
            yield page
        finally:
            del self._pages[session]
            self.call("Target.disposeBrowserContext", browserContextId=context)

    def call(self, method: str, session: str | None = None, **params: Any) -> dict[str, Any]:  # noqa: ANN401
        """Return the answer to a command; events that come meanwhile go to their pages."""
        number = next(self._ids)
        message: dict[str, Any] = {"id": number, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = session
        self._socket.send(json.dumps(message))
        until_s = time.monotonic() + ANSWER_S
        while True:
            answer = self._receive(until_s - time.monotonic())
            if answer is None:
                raise CdpError(f"{method}: no answer")
            if answer.get("id") == number:
                if "error" in answer:
                    raise CdpError(f"{method}: {answer['error']['message']}")
                result: dict[str, Any] = answer["result"]
                return result

    def pump(self, wait_s: float) -> None:
        """Take the events that come within this time."""
        until_s = time.monotonic() + wait_s
        while (left_s := until_s - time.monotonic()) > 0.0:
            if self._receive(left_s) is None:
                return

    def _receive(self, wait_s: float) -> dict[str, Any] | None:
        try:
            message: dict[str, Any] = json.loads(self._socket.recv(timeout=max(wait_s, 0.0)))
        except TimeoutError:
            return None
        page = self._pages.get(message.get("sessionId", ""))
        if page is not None and "method" in message:
            page.note(message["method"], message["params"])
        return message

    def _address(self) -> str:
        """Return where the browser listens, when it does."""
        file = Path(self._profile.name) / "DevToolsActivePort"
        until_s = time.monotonic() + START_S
        while time.monotonic() < until_s:
            lines = file.read_text().splitlines() if file.exists() else []
            if len(lines) == 2:
                return f"ws://127.0.0.1:{lines[0]}{lines[1]}"
            if self._process.poll() is not None:
                break
            time.sleep(0.02)
        self._process.kill()
        raise CdpError(f"the browser does not start (exit code {self._process.poll()})")


class Page:
    """A page of a browser: addresses, scripts, input, pictures, and its requests."""

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.log: list[str] = []

    def call(self, method: str, **params: Any) -> dict[str, Any]:  # noqa: ANN401
        """Return the answer to a command about this page."""
        return self._browser.call(method, self._session, **params)

    def note(self, method: str, params: dict[str, Any]) -> None:
        """Take an event."""
        match method:
            case "Network.requestWillBeSent":
                self.requests.append(f"{params['request']['method']} {params['request']['url']}")
            case "Network.webSocketCreated":
                self.requests.append(f"WS {params['url']}")
            case "Runtime.exceptionThrown":
                details = params["exceptionDetails"]
                thrown = details.get("exception", {}).get("description", details["text"])
                self.errors.append(thrown)
            case "Runtime.consoleAPICalled":
                texts = [str(arg.get("value", arg.get("description"))) for arg in params["args"]]
                self.log.append(" ".join([params["type"], *texts]))

    def resize(self, width: int, height: int) -> None:
        """Set the size of the window."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def go(self, url: str) -> None:
        """Open an address."""
        answer = self.call("Page.navigate", url=url)
        if "errorText" in answer:
            raise CdpError(f"{url}: {answer['errorText']}")

    def run(self, script: str) -> Any:  # noqa: ANN401
        """Return the value of a script, awaited; raises `CdpError` for what it throws."""
        answer = self.call(
            "Runtime.evaluate",
            expression=script,
            awaitPromise=True,
            returnByValue=True,
            userGesture=True,
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            thrown = details.get("exception", {}).get("description", details["text"])
            raise CdpError(f"{script}: {thrown}")
        return answer["result"].get("value")

    def wait(self, script: str, seconds: float = 60.0) -> Any:  # noqa: ANN401
        """Return the value of a script when it is true; raises `CdpError` after so long."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            try:
                # An element has no value of its own.
                value = self.run(
                    f"(async () => {{ const own = await ({script});"
                    " return own instanceof Node ? true : own; })()"
                )
                if value:
                    return value
            except CdpError as error:  # A page that is being loaded has no body yet.
                last: object = error
            else:
                last = value
            self._browser.pump(0.02)
        text = self.run("document.body?.innerText")
        raise CdpError(
            f"not true within {seconds:g} s: {script} ({last}); errors: {self.errors}; page: {text}"
        )

    def place(self, selector: str) -> tuple[float, float]:
        """Return the middle of an element."""
        box = self.run(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); "
            "e.scrollIntoView({block: 'nearest'}); const b = e.getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        return float(box[0]), float(box[1])

    def press_pointer(self, x: float, y: float) -> None:
        """Move the pointer there and press its left button."""
        self.pointer("mouseMoved", x, y)
        self.pointer("mousePressed", x, y)

    def pointer(self, kind: str, x: float, y: float, **more: Any) -> None:  # noqa: ANN401
        """Send one event of the pointer."""
        button = "none" if kind == "mouseMoved" and not more.get("buttons") else "left"
        found = {"button": button, "clickCount": 1, "pointerType": "mouse", **more}
        if kind == "mouseWheel":
            found = {"deltaX": 0, "deltaY": 0, **more}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **found)

    def click(self, selector: str) -> None:
        """Click the middle of an element, as a person does."""
        x, y = self.place(selector)
        self.press_pointer(x, y)
        self.pointer("mouseReleased", x, y)

    def touch(self, *point: float) -> None:
        """Put a finger there; without a place: take it away."""
        kind = "touchStart" if point else "touchEnd"
        points = [{"x": point[0], "y": point[1]}] if point else []
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    def pinch(self, x: float, y: float, from_px: float, to_px: float) -> None:
        """Put two fingers so far from that place, left and right of it, and move both evenly."""
        for step in range(6):
            half_px = from_px + step / 5 * (to_px - from_px)
            points = [{"x": x - half_px, "y": y, "id": 1}, {"x": x + half_px, "y": y, "id": 2}]
            kind = "touchMove" if step else "touchStart"
            self.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def key(self, name: str) -> None:
        """Press and release a key, such as `Shift+ArrowLeft`."""
        *held, key = name.split("+") if name != "+" else ["+"]
        text = key if len(key) == 1 else "\r" if key == "Enter" else ""
        code = "Space" if key == " " else key
        event = {
            "key": key,
            "code": code,
            "modifiers": sum(MODIFIERS[one] for one in held),
            "windowsVirtualKeyCode": (KEY_CODES | KEY_CODES_ARROWS).get(key, ord(key[0].upper())),
        }
        shown = {"text": text} if text else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", **event, **shown)
        self.call("Input.dispatchKeyEvent", type="keyUp", **event)

    def idle(self) -> None:
        """Wait until the page has drawn everything that it was asked for."""
        self.run("import('/static/frames.js').then((frames) => frames.idle())")

    def picture(self, path: Path | None = None) -> bytes:
        """Return a picture of the window as PNG; write it, too."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        return data

    def names(self) -> list[tuple[str, str]]:
        """Return role and name of each control that assistive technology sees."""
        nodes = self.call("Accessibility.getFullAXTree")["nodes"]
        return [
            (node["role"]["value"], node.get("name", {}).get("value", ""))
            for node in nodes
            if not node.get("ignored")
        ]
