"""The secrets that the configuration names the files of, read when they are wanted."""

import stat
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plugd.config.complaint import one_line
from plugd.config.reading import at
from plugd.errors import ConfigError

if TYPE_CHECKING:
    from plugd.config.whole import Config

MAX_BYTES = 4096
SECRET_FILES = ("broker.password_file", "web.token_file")


class Secret:
    """A word that shows in no log and no traceback."""

    __slots__ = ("_word",)

    def __init__(self, word: str) -> None:
        self._word = word

    def get_secret_value(self) -> str:
        """The word."""
        return self._word

    def __repr__(self) -> str:
        return "Secret(***)"


def password(config: "Config") -> Secret | None:
    """What `broker.password_file` holds now. Raises ConfigError."""
    return secret_at(config, "broker.password_file")


def token(config: "Config") -> Secret | None:
    """What `web.token_file` holds now. Raises ConfigError."""
    return secret_at(config, "web.token_file")


def secret_at(config: "Config", key: str) -> Secret | None:
    """What the file under a key holds now, None where none is named. Raises ConfigError."""
    path: Path | None = at(config, key)
    if path is None:
        return None
    content = content_of(key, path, MAX_BYTES)
    said = _said(key, path)
    if path.stat().st_mode & stat.S_IROTH:
        raise ConfigError(f"{said}: everyone may read it; chmod 600 {one_line(str(path), 200)}")
    return secret(content, said)


def secret(content: bytes, said: str) -> Secret:
    """What a secret's file holds. Raises ConfigError, which `said` names."""
    try:
        word = content.decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError:
        raise ConfigError(f"{said}: not UTF-8; write the secret alone, on one line") from None
    if not word or not word.isprintable():
        raise ConfigError(f"{said}: must hold the secret alone, on one line")
    return Secret(word)


def content_of(key: str, path: Path, limit: int) -> bytes:
    """What a file holds that is named under a key. Raises ConfigError."""
    try:
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except OSError as error:
        raise ConfigError(
            f"{_said(key, path)}: cannot be read ({error.strerror}); create it, readable to plugd's user"
        ) from error
    if len(content) > limit:
        raise ConfigError(f"{_said(key, path)}: longer than {limit} bytes; is this the right file?")
    return content


def _said(key: str, path: Any) -> str:
    return f'{key} = "{one_line(str(path), 200)}"'
