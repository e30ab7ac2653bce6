"""What all phases of a show share: lines, what the servos had, who is driven, where they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.player import settings, setup
from lss_motion.player.agenda import Agenda
from lss_motion.player.approach import approach
from lss_motion.player.dialogue import Dialogue
from lss_motion.player.line import Line
from lss_motion.player.queries import Questioner
from lss_motion.player.recovery import changing_orders, telling_orders
from lss_motion.player.settling import Settling, is_answered, read_back, untaken
from lss_motion.player.streamer import Streamer
from lss_motion.program.predict import profiles

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.dialogue import Item
    from lss_motion.player.settings import Answers
    from lss_motion.player.track import Track
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Joint, Robot

UNRESTORED_TEXT: Final = (
    "stopped at once, so the servos were not given back their settings: {} stay as this show "
    "needed them until their power is off, and the next show takes them for the servos' own. "
    "Switch their power off and on, or RESET them; hold the robot, it goes limp"
)


class Session:
    """One robot during one show. It knows no phase."""

    def __init__(
        self, program: Program, robot: Robot, *, has_feedback: bool, start_s: float | None
    ) -> None:
        self.program = program
        self.robot = robot
        self.joints = [robot.joints[name] for name in program.start_deg]
        self.lines = {name: Line(robot.buses[name]) for name in robot.buses}
        self.questioners = {name: Questioner(line) for name, line in self.lines.items()}
        self.agenda = Agenda(program, robot)
        self.agenda.begin_at(start_s)
        self.has_feedback = has_feedback
        self.start_s = start_s
        self.had: Answers = {}
        """What every servo answered before anything was changed."""
        self.standing_deg: dict[str, float] = {}
        """Servo angles by joint, as last asked for while nothing moved."""
        self.left_out: set[str] = set()
        """Joints that are sent no move until the end."""
        self.limp: list[Joint] = []
        self._tracks: dict[str, Track] = {}
        """Of each joint the last one, for what it learnt."""

    @property
    def driven(self) -> list[Joint]:
        return [joint for joint in self.joints if joint.name not in self.left_out]

    def ask(self, items: Iterable[Item]) -> Dialogue:
        return Dialogue(items, self.lines, self.questioners)

    def settle(self) -> Settling:
        """Return what gives the servos their settings, and asks where they are."""
        orders = settings.session_orders(self.driven, self.had)
        unsure = settings.unsure_orders(self.driven, self.had)
        places = setup.place_questions(self.driven)
        return Settling(orders, places, unsure, self.lines, self.questioners)

    def arrival(self) -> Dialogue:
        """Return what asks the servos where they are, and whether one has restarted meanwhile."""
        telling = telling_orders(self.driven, self.had)
        return self.ask([*read_back(telling), *setup.place_questions(self.driven)])

    def restarted(self, answers: Answers) -> list[Joint]:
        """Return the driven servos that no longer have what they were given."""
        return self._telling_otherwise(answers, has_said=True)

    def untold(self, answers: Answers) -> list[Joint]:
        """Return the driven servos that did not say whether they still have it."""
        return self._telling_otherwise(answers, has_said=False)

    def _telling_otherwise(self, answers: Answers, *, has_said: bool) -> list[Joint]:
        others = {
            (order.bus, order.command.servo_id)
            for order in untaken(telling_orders(self.driven, self.had), answers)
            if is_answered(order, answers) is has_said
        }
        return [joint for joint in self.driven if (joint.bus, joint.servo_id) in others]

    def restoring_orders(self) -> list[Item]:
        return settings.restoring_orders(self.joints, self.had, self.agenda.lit)

    def unrestored_text(self) -> str:
        """Return what to say of settings that are not given back; nothing if none was changed."""
        orders = changing_orders(self.joints, self.had)
        words = ", ".join(sorted({order.command.keyword for order in orders}))
        return UNRESTORED_TEXT.format(words) if words else ""

    def note_places(self, answers: Answers) -> list[Joint]:
        """Take in where the driven servos stand; return those who did not say."""
        standing = setup.standing_deg(self.driven, answers)
        self.standing_deg |= standing
        return [joint for joint in self.driven if joint.name not in standing]

    def learn_loads(self, now_ns: int) -> None:
        """Take in what pulls at every joint that rests where it was sent, or nearly."""
        for joint in self.driven:
            if joint.name in self._tracks:
                track = self._tracks[joint.name]
                pulled_deg = track.place(now_ns)[0] - self.standing_deg[joint.name]
                if abs(pulled_deg) <= setup.ARRIVED_DEG:
                    track.following.rest(pulled_deg)

    def start_deg(self) -> dict[str, float]:
        """Return the joint angles at which the show begins, also in its middle."""
        if self.start_s is None:
            return dict(self.program.start_deg)
        start_s = self.program.within(self.start_s)
        return {
            name: self.robot.joints[name].joint_deg(plan.at(start_s)[0])
            for name, plan in profiles(self.program, self.robot).items()
        }

    def place_deg(self, show: Streamer | None, now_ns: int) -> dict[str, float]:
        """Return the joint angles from which the show is to begin, or to go on."""
        place = self.start_deg() if show is None else show.pose_deg(now_ns)
        return {joint.name: place[joint.name] for joint in self.driven}

    def furthest(self, place_deg: Mapping[str, float]) -> tuple[str, float]:
        """Return which driven joint stands furthest from `place_deg`, and by how many degrees."""
        return max(
            (
                (name, abs(self.robot.joints[name].servo_deg(angle) - self.standing_deg[name]))
                for name, angle in place_deg.items()
            ),
            key=lambda far: far[1],
            default=("", 0.0),
        )

    def approach(self, place_deg: Mapping[str, float], now_ns: int) -> Streamer:
        """Return what takes every driven joint from where it stands to `place_deg`."""
        program = approach(self.robot, self.standing_deg, place_deg)
        return self._stream(program, self.standing_deg, now_ns, None)

    def begin(self, start_ns: int) -> Streamer:
        """Return the show, which starts at `start_ns` with every joint at its start.

        Corrected for what pulls at it: servos stand where they were sent.
        """
        standing = {n: self.robot.joints[n].servo_deg(deg) for n, deg in self.start_deg().items()}
        standing |= self._places_deg(start_ns)
        return self._stream(self.program, standing, start_ns, self.start_s)

    def resume(self, show: Streamer, now_ns: int) -> None:
        """Go on with `show` from where the approach sent the servos, and with what it learnt."""
        show.resume(self._places_deg(now_ns), self.left_out)
        self._learn(show)

    def _places_deg(self, now_ns: int) -> dict[str, float]:
        """Return where the last moves sent the servos: servo angles."""
        return {name: track.place(now_ns)[0] for name, track in self._tracks.items()}

    def _stream(
        self,
        program: Program,
        standing_deg: Mapping[str, float],
        now_ns: int,
        start_s: float | None,
    ) -> Streamer:
        streamer = Streamer(
            program,
            self.robot,
            lines=self.lines,
            questioners=self.questioners,
            standing_deg=standing_deg,
            has_feedback=self.has_feedback,
            start_ns=now_ns,
            start_s=start_s,
        )
        streamer.leave_out(self.left_out)
        self._learn(streamer)
        return streamer

    def _learn(self, streamer: Streamer) -> None:
        for name, track in streamer.tracks.items():
            if name in self._tracks:
                track.learn(self._tracks[name])
            self._tracks[name] = track

    def let_go(self, joint: Joint, now_ns: int) -> None:
        """Take the power from one motor, until the end."""
        self.limp.append(joint)
        self.lines[joint.bus].send(setup.let_go(joint), now_ns)

    def safe_bytes(self, *, is_limp: bool) -> Mapping[str, bytes]:
        return setup.safe_bytes(self.robot, is_limp=is_limp, limp=self.limp)
