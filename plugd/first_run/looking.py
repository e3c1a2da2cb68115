"""A look at the broker: does it let us in, and which plugs say there that they are present."""

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from plugd import daemon
from plugd.adapters.mqtt import Message, Retained
from plugd.config import Config
from plugd.first_run.answers import nested
from plugd.first_run.interview import PASSWORD_FILE, Draft, Found

PATIENCE_S = 5.0
"""A broker that is there answers in less."""
AGAIN_S = 2.0
"""One that knows only an older MQTT lets us in at the second attempt."""
MOST_PLUGS = 20

Sign = Callable[[list[str], str], str | None]
"""From the levels of a topic and its payload to the plug's own topic, where it is there."""


def _openevse(levels: list[str], payload: str) -> str | None:
    try:
        said = json.loads(payload)
    except ValueError:
        return None
    there = isinstance(said, dict) and said.get("state") == "connected"
    return said["mqtt"] if there and isinstance(said.get("mqtt"), str) else None


SIGNS: tuple[tuple[str, str, Sign], ...] = (
    ("tasmota", "tele/+/LWT", lambda levels, payload: levels[1] if payload == "Online" else None),
    ("shelly2", "+/online", lambda levels, payload: levels[0] if payload == "true" else None),
    ("shelly1", "shellies/+/online", lambda levels, payload: levels[1] if payload == "true" else None),
    ("openevse", "openevse/announce/+", _openevse),
)
"""(kind, where its device keeps a word of its presence, how that word is read). No two filters overlap."""


def look(draft: Draft) -> Found:
    """Connect as the answers say, and collect what the broker has kept. Nothing is published to any plug."""
    with tempfile.TemporaryDirectory(prefix="plugd-") as folder:
        connection = daemon.connect(_config(draft, Path(folder)), client=f"plugd-init-{os.getpid()}")
        kept = connection.subscribe(*((topics, Retained.REPLAYED) for _, topics, _ in SIGNS))
        connection.start()
        try:
            connection.bell.hold(lambda: connection.connected or connection.refusal is not None, PATIENCE_S)
            if not connection.wait_connected(AGAIN_S):
                return Found(refusal=connection.refusal or f"{connection.broker} does not answer")
            connection.flush()
            return Found(plugs=plugs_in(kept.take()))
        finally:
            connection.close()


def plugs_in(messages: tuple[Message, ...]) -> tuple[tuple[str, str], ...]:
    """(kind, topic) of the plugs that these messages tell of, in the order of their kinds."""
    found = []
    for kind, topics, sign in SIGNS:
        for message in messages:
            levels = message.topic.split("/")
            if _fits(topics.split("/"), levels):
                topic = sign(levels, message.payload.decode("utf-8", "replace"))
                found += [(kind, topic)] if topic else []
    return tuple(dict.fromkeys(found))[:MOST_PLUGS]


def _fits(wanted: list[str], levels: list[str]) -> bool:
    same = (one in ("+", other) for one, other in zip(wanted, levels, strict=False))
    return len(wanted) == len(levels) and all(same)


def _config(draft: Draft, folder: Path) -> Config:
    """What is known so far as a configuration; the password in a file of its own, which goes with the folder."""
    answers = {"plug.topic": "not asked yet", **draft.answers}
    if draft.password is not None:
        path = folder / PASSWORD_FILE
        path.touch(mode=0o600)
        path.write_text(draft.password, "utf-8")
        answers["broker.password_file"] = str(path)
    return Config.model_validate(nested(answers))
