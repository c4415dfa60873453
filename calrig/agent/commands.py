"""Stop, abort, pause, resume, look as the centre asks for them: each carried out at most once, and answered.

A command is claimed by one statement, which finds none that was withdrawn, or is older than `STALE_S` by the
server's clock: whoever asked has been told by then that the bench cannot be.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from typing import Any

from calrig.agent.link import NOW, Centre, Link, LinkDown, json_of
from calrig.analysis.errors import RunsError, Unknown
from calrig.runs.service import RunService
from calrig.store import StoreError

log = logging.getLogger(__name__)

STALE_S = 5
LOOK_S = 0.5
"""How often the centre is asked though no notification came."""
ANSWER_AGAIN_S = 0.25
LONGEST_ANSWER_S = 60.0
"""An answer that cannot be sent for so long interests nobody any more."""
_OLDEST = NOW.replace("clock_timestamp()", f"(clock_timestamp() - interval '{STALE_S} s')")
_CLAIM = f"""
UPDATE bench_command SET taken_at = {NOW}
WHERE bench = %s AND taken_at IS NULL AND withdrawn_at IS NULL AND asked_at >= {_OLDEST}
RETURNING id, kind, rig, run_uid
"""  # noqa: S608 (no text of anybody's)
_ANSWER = f"UPDATE bench_command SET answered_at = {NOW}, answer = %s WHERE id = %s AND bench = %s"  # noqa: S608


@dataclass(frozen=True, slots=True)
class Command:
    """What is asked: of a rig, or of a run."""

    id: int
    kind: str
    rig: str | None
    run_uid: str | None


class Commands:
    """In a thread of its own, until `closing` is set; each command is carried out in another.

    Args:
        heard: a link that does nothing but wait for commands.
        answers: a link for what is short.
        service: does what is asked.
        closing: ends it.
    """

    def __init__(self, heard: Link, answers: Link, service: RunService, closing: threading.Event) -> None:
        self._heard, self._answers = heard, answers
        self._service, self._closing = service, closing

    def run(self) -> None:
        """Listens until the agent is closed."""
        while not self._closing.is_set():
            try:
                with self._heard.centre() as centre:
                    self._listen(centre)
            except LinkDown:
                self._closing.wait(LOOK_S)

    def _listen(self, centre: Centre) -> None:
        centre.connection.execute("LISTEN calrig_command")
        while not self._closing.is_set():
            for row in centre.connection.execute(_CLAIM, (centre.bench,)).fetchall():
                self._carry_out(Command(*row))
            for _told in centre.connection.notifies(timeout=LOOK_S, stop_after=1):
                pass  # of whichever bench: the table says whether there is anything

    def _carry_out(self, command: Command) -> None:
        level = logging.DEBUG if command.kind == "look" else logging.INFO
        log.log(level, "command %d: %s of %s", command.id, command.kind, command.rig or command.run_uid)
        work = threading.Thread(target=self._work, args=(command,), name=f"command {command.id}", daemon=True)
        work.start()

    def _work(self, command: Command) -> None:
        answer = json_of(self.answer_to(command))
        give_up_s = time.monotonic() + LONGEST_ANSWER_S
        while time.monotonic() < give_up_s:
            try:
                with self._answers.centre() as centre:
                    centre.connection.execute(_ANSWER, (answer, command.id, centre.bench))
                return
            except LinkDown:
                if self._closing.wait(ANSWER_AGAIN_S):
                    return

    def answer_to(self, command: Command) -> dict[str, Any]:
        """Does what is asked; says what came of it, in HTTP's terms."""
        try:
            return {"status": 200, "detail": self._do(command)}
        except Unknown as error:
            return {"status": 404, "detail": str(error)}
        except (RunsError, StoreError) as error:
            return {"status": 409, "detail": str(error)}
        except Exception as error:
            log.exception("command %d failed inside calrig", command.id)
            return {"status": 409, "detail": f"the bench failed inside ({error!r}); its log says where"}

    def _do(self, command: Command) -> str:
        service, run_id = self._service, command.run_uid or ""
        match command.kind:
            case "stop":
                state = service.begin_stop(command.rig or "").result()
                return f"the stage of rig {state.name} stands"
            case "abort":
                return service.abort(run_id).status
            case "pause":
                return service.pause(run_id).status
            case "resume":
                return service.resume(run_id).status
            case "look":
                service.look(command.rig or "")
                return "what is seen comes with the heartbeat"
        raise Unknown(f"this bench knows no command {command.kind!r}")
