"""The answers as a file that a person can read, and that is there whole or not at all."""

import json
import os
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

from plugd.config import known_keys, parse
from plugd.config.complaint import one_line
from plugd.errors import PlugdError
from plugd.first_run.answers import Answers, Value
from plugd.first_run.interview import Draft
from plugd.first_run.places import REGIONS
from plugd.first_run.questions import COMMENTS

HEADER = """\
# plugd's configuration, as answered to `plugd init`. `plugd check` says what to mend.
# Every other key is at its default; etc/plugd.toml of plugd explains them all.
"""
PUBLIC, SECRET = 0o644, 0o600


def toml(answers: Answers) -> str:
    """The file's text: tables and keys in the order of the example, each with its reason."""
    return "\n".join([HEADER, *_tables(answers)])


def _tables(answers: Answers) -> Iterator[str]:
    keys = [key for key in known_keys() if key in answers]
    for table in dict.fromkeys(key.partition(".")[0] for key in keys):
        lines = [f"[{table}]"]
        for key in keys:
            if key.startswith(f"{table}."):
                lines += [f"# {COMMENTS[key]}"] if key in COMMENTS else []
                name = f"  # {REGIONS[int(answers[key])]}" if key == "home.region_id" else ""
                lines.append(f"{key.partition('.')[2]} = {_value(answers[key])}{name}")
        yield "".join(f"{line}\n" for line in lines)


def _value(value: Value) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case _:
            return repr(value)


def writable(path: Path) -> None:
    """Whether a file can be there. Raises PlugdError, before anybody answers questions for nothing."""
    parent = next((folder for folder in path.parents if folder.exists()), path.parent)
    try:
        if path.is_dir():
            raise PlugdError(f"{_shown(path)}: is a folder; name the file with --out")
        if not parent.is_dir():
            raise PlugdError(f"{_shown(parent)}: is no folder; name another file with --out")
    except (OSError, ValueError) as error:
        raise _unwritable(path, error) from error
    if not os.access(parent, os.W_OK | os.X_OK):
        raise PlugdError(f"{_shown(parent)}: this user may not write there; use sudo, or name another file with --out")


def write(path: Path, draft: Draft, replace: bool) -> None:
    """Write the configuration, and its password's file where there is a password.

    `replace`: the file may be there already; else it must not. Raises PlugdError, and leaves nothing then.
    """
    text = toml(draft.answers)
    parse(text, str(path), path.parent)
    files = [(path, text, PUBLIC)]
    if draft.password is not None:
        files.insert(0, (Path(str(draft.answers["broker.password_file"])), f"{draft.password}\n", SECRET))
    try:
        _make(path.parent)
        with ExitStack() as left:
            drafts = []
            for target, content, mode in files:
                drafts.append((_drafted(target, content, mode), target))
                left.callback(drafts[-1][0].unlink, missing_ok=True)
            if path.exists() and not replace:
                raise PlugdError(f"{_shown(path)}: has come meanwhile, and is left as it is")
            for written, target in drafts:
                written.replace(target)
    except OSError as error:
        raise _unwritable(path, error) from error


def _make(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)


def _drafted(target: Path, content: str, mode: int) -> Path:
    """The content beside its target, for nobody else until it is whole."""
    draft = target.with_name(f".{target.name}.{os.getpid()}")
    with suppress(FileNotFoundError):
        draft.unlink()
    try:
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, SECRET), "w", encoding="utf-8") as file:
            file.write(content)
            file.flush()
            os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    return draft


def _unwritable(path: Path, error: Exception) -> PlugdError:
    reason = getattr(error, "strerror", None) or "not a file name"
    return PlugdError(f"{_shown(path)}: cannot be written ({reason}); name another with --out")


def _shown(path: Path) -> str:
    return one_line(str(path), 200)
