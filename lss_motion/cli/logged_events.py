"""The events of a log as a person reads them: the words that they had on the screen."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.play import tell
from lss_motion.player import events
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sequence.model import Cue

if TYPE_CHECKING:
    from collections.abc import Callable

_ENUM: Final = re.compile(r"<(\w+)\.\w+: ('[^']*')>")
"""How Python writes a member of an enumeration of words."""
_MADE: Final[dict[str, Callable[..., Any]]] = {
    kind.__name__: kind
    for kind in (
        events.Checked,
        events.CueReached,
        events.Faulted,
        events.Found,
        events.MarkPassed,
        events.PhaseEntered,
        events.Waited,
        events.Warned,
        events.Phase,
        Cause,
        Cue,
        FaultStep,
    )
}


def event_lines(logged: str) -> list[str]:
    """Return what is to be said of an event of a log, or the event as it stands if it is strange.

    One servo a line would drown the rest: of what was found, only the number is said.
    """
    text = logged.encode("ascii").decode("unicode_escape")
    try:
        event = _made(ast.parse(_ENUM.sub(r"\1(\2)", text), mode="eval").body)
        lines: list[str] = []
        if isinstance(event, events.Checked):
            return [f"checked {len(event.servos)} servos"]
        if isinstance(event, events.MarkPassed) and not event.label:
            return [f"{event.show_s:.2f} s a keyframe"]
        tell(event, lambda line: lines.append(line.strip()))
    except (SyntaxError, ValueError, TypeError, KeyError, AttributeError):
        return [text]
    return lines or [text]


def _made(node: ast.expr) -> Any:  # noqa: ANN401  (an event, or a part of one)
    """Return what was written down, made of nothing but the kinds of events and their parts."""
    match node:
        case ast.Call(func=ast.Name(id=name)):
            fields = {key.arg or "": _made(key.value) for key in node.keywords}
            return _MADE[name](*map(_made, node.args), **fields)
        case ast.Tuple():
            return tuple(map(_made, node.elts))
        case _:
            return ast.literal_eval(node)
