"""What systemd is told: ready, what goes on, and that the loop still looks after itself (sd_notify, Type=notify)."""

import logging
import socket

log = logging.getLogger(__name__)


class Supervisor:
    """Speaks to the socket that systemd named in $NOTIFY_SOCKET; without one it says nothing.

    A word that cannot be sent is dropped: what is lost is only systemd's trust, and with it the process, as it should.
    """

    def __init__(self, address: str = "") -> None:
        """`address`: a path, or `@` and a name (an abstract socket)."""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._ready = False
        self._status = ""
        self._ailing: str | None = None

    def beat(self, ailment: str | None, status: str) -> None:
        """The loop has gone round: in health it is ready and feeds the watchdog, with an `ailment` it does not."""
        if ailment is not None and ailment != self._ailing:
            log.error("%s; systemd is not told that all is well, and restarts plugd", ailment)
        self._ailing = ailment
        words = [] if ailment else ["WATCHDOG=1"] if self._ready else ["READY=1", "WATCHDOG=1"]
        said = " ".join((ailment or status).split())
        if said != self._status:
            words.append(f"STATUS={said}")
        if words and self._tell(*words):
            self._ready = self._ready or ailment is None
            self._status = said

    def stopping(self) -> None:
        """The end is wanted, and on its way."""
        self._tell("STOPPING=1")

    def _tell(self, *words: str) -> bool:
        if not self._address:
            return False
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
                line.setblocking(False)
                line.sendto("\n".join(words).encode(), self._address)
        except OSError as error:
            log.debug("systemd does not hear us: %s", error)
            return False
        return True
