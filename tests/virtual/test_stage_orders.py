"""Every order of an operator or a cue in every phase of the player: none of them ends the night."""

import pytest

from lss_motion.playing.player.events import Phase
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.stage.check import plan_stage
from lss_motion.stage.director import Director
from lss_motion.stage.duty import Reason
from lss_motion.stage.load import load_stage
from lss_motion.stage.running import Options, StageRun
from tests.virtual.test_stage_cues import BEGINS, CUES, STAGE, folder, kinds, press

__all__ = ["folder"]
S = 1_000_000_000
MORE = "on_fault: {attempts: {silent: 3, restarted: 3}, wait_s: 3}\n"
BETWEEN = "between two runs"
LASTS_S = 25.0


def operator(deed):
    return lambda director, now_ns: director.do(deed, now_ns)


ORDERS = {
    "stop": operator("stop"),
    "halt": Director.halt,
    "rest": operator("rest"),
    "play": press("over"),
    "interrupt": press("between"),
    "queue": press("later"),
    "restart": press("again"),
    "add": press("blink"),
}
PHASES = (
    Phase.CONNECT,
    Phase.PREPARE,
    Phase.APPROACH,
    Phase.SHOW,
    Phase.SEEK,
    Phase.STANDING,
    Phase.RECOVER,
    Phase.STOP,
    Phase.RESTORE,
    BETWEEN,
)


class OrderHand:
    """Gives an order when the player is first in a phase, after what leads there."""

    has_stopped, rate = False, 1.0

    def __init__(self, phase, order):
        self._phase, self._order, self.run = phase, order, None
        self.given_ns = None
        leads = {Phase.SEEK: press("over"), Phase.STANDING: Director.halt}
        self._leads = leads.get(phase)

    def filenos(self):
        return ()

    def act(self, player, now_ns):
        run = self.run
        if self._leads is not None and run.now_ns > 3 * S:
            lead, self._leads = self._leads, None
            lead(run.director, run.now_ns)
        phase = BETWEEN if player is None else player.phase
        is_begun = run.director.has_begun or self._phase in (Phase.CONNECT, Phase.PREPARE)
        if self.given_ns is None and phase == self._phase and is_begun and self._leads is None:
            self.given_ns = run.now_ns
            self._order(run.director, run.now_ns)

    def on_event(self, event): ...

    def on_turn(self, player, now_ns): ...

    def note(self, record): ...


def faults_for(phase):
    if phase is Phase.RECOVER:
        return [Fault(kind=FaultKind.RESET, servo_id=2, at_s=6.0, deaf_s=1.25)]
    if phase in (Phase.STOP, Phase.RESTORE, BETWEEN):
        return [Fault(kind=FaultKind.DEAF, servo_id=2, at_s=6.0)]
    return []


def evening_with(folder, phase, order):
    path = folder / "orders.yaml"
    path.write_text(STAGE + CUES + MORE)
    records, hand = [], OrderHand(phase, order)
    options = Options(
        is_virtual=True,
        begins=BEGINS,
        lasts_s=LASTS_S,
        seed=1,
        next_faults=lambda began_ns: faults_for(phase) if began_ns == 0 else [],
    )
    run = hand.run = StageRun(
        plan_stage(load_stage(path)), options, steerer=hand, note=records.append
    )
    end = run.play()
    return run, end, records, hand


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("order", ORDERS)
def test_an_order_in_any_phase_never_gives_the_stage_up(folder, phase, order):
    run, end, records, hand = evening_with(folder, phase, ORDERS[order])
    assert hand.given_ns is not None
    assert end.error is None
    assert not [one for one in records if one.get("alert") == "given_up"], records
    assert Reason.FAULT not in run.director.duty.reasons
    assert end.runs <= 2
    if phase is Phase.STOP:
        return  # The evening ends.
    records = [one for one in records if "kind" in one]
    over = kinds(records, "over")
    if order == "rest":
        assert list(run.director.duty.reasons) == [Reason.OPERATOR]
        assert (phase in PHASES[:3]) == (over == []), "what played was left, also after a recovery"
        assert "stopped" not in " ".join(over)
    elif order != "halt" and phase is not Phase.STANDING:
        assert over[-1] in ("idle stopped", "idle finished"), over
    if order in ("play", "interrupt") and phase in (Phase.SHOW, Phase.APPROACH):
        assert any(one.endswith("finished") for one in over)
