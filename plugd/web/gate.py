"""Who may come in: the page's own names, its own origin, the token. What is refused is counted by its reason."""

import hmac
import ipaddress
from collections import Counter
from dataclasses import dataclass, field

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
READING = ("GET", "HEAD")
TOKEN_HEADER = "X-Plugd-Token"  # nosec B105 # its name, no token


@dataclass(slots=True)
class Gate:
    """ASGI middleware. A name that only an attacker's DNS gives to this machine is not one of `names`."""

    app: ASGIApp
    names: frozenset[str]
    refused: Counter[str] = field(default_factory=Counter)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let in, or refuse."""
        if scope["type"] != "http":
            return

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        why = self._refusal(scope["method"], Headers(scope=scope))
        if why is None:
            await self.app(scope, receive, sealed)
            return
        status, reason, message = why
        self.refused[reason] += 1
        await JSONResponse({"ok": False, "message": message}, status)(scope, receive, sealed)

    def _refusal(self, method: str, headers: Headers) -> tuple[int, str, str] | None:
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or not self._known(hosts[0]):
            return 421, "host", "this page does not go by that name; add it to hosts under [web] if it is yours"
        if method in READING:
            return None
        if origins not in ([f"http://{hosts[0]}"], [f"https://{hosts[0]}"]):
            return 403, "origin", "only this page itself may set things"
        return None

    def _known(self, host: str) -> bool:
        """An address, or one of our names: an address cannot be pointed here by somebody else's DNS."""
        name = _name(host)
        if name in self.names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def _name(host: str) -> str:
    """The name in a Host header, without its port and brackets."""
    if host.startswith("["):
        inside, closed, port = host[1:].partition("]")
        return inside if closed and (not port or (port[0] == ":" and port[1:].isdigit())) else host
    name, _, port = host.rpartition(":")
    return (name if name and port.isdigit() else host).lower().rstrip(".")


def same(token: str, given: str | None) -> bool:
    """Whether that is the token, in a time that tells nothing."""
    return given is not None and hmac.compare_digest(token.encode(), given.encode())
