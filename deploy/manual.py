"""The man page and the shell completion, written from the program's own arguments."""

import argparse
from collections.abc import Iterator

FILES = (
    ("/etc/plugd/plugd.toml", "The configuration. Every key is explained where it stands."),
    ("/etc/plugd/mqtt_password, /etc/plugd/web_token", "Secrets, mode 600; the service is handed them by systemd."),
    ("/var/lib/plugd", "The service's state: only root can look into it."),
    ("/usr/share/plugd", "What may be copied: plugd-can.conf for a charger on CAN, DBC files, the broker's."),
)
EXITS = (("0", "done"), ("1", "failed"), ("2", "usage"), ("75", "already running"), ("78", "configuration"))


def commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands of a parser, in its order."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def helps(parser: argparse.ArgumentParser) -> dict[str, str]:
    """What is said of each command."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return {choice.dest: choice.help or "" for choice in action._choices_actions}
    return {}


def plain(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Its arguments but for commands."""
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction) and action.help is not argparse.SUPPRESS:
            yield action


def escaped(text: str) -> str:
    """As roff wants it."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{text}" if text.startswith((".", "'")) else text


def _described(parser: argparse.ArgumentParser, helped: bool = True) -> Iterator[str]:
    for action in plain(parser):
        if isinstance(action, argparse._HelpAction) and not helped:
            continue  # said once, at the top
        value = action.metavar or (action.dest.upper() if action.nargs != 0 else "")
        if action.choices is not None:
            value = "|".join(str(choice) for choice in action.choices)
        names = ", ".join(action.option_strings) or str(value)
        said = f"{names} {value}" if action.option_strings and value else names
        yield f".TP\n.B {escaped(said)}\n{escaped((action.help or '').replace('%%', '%'))}"


def _sections(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
    for command, inner in commands(parser).items():
        whole = f"{name} {command}"
        yield f".SS {escaped(whole)}\n{escaped(helps(parser).get(command, ''))}"
        yield from _described(inner, helped=False)
        yield from _sections(inner, whole)


def man_page(parser: argparse.ArgumentParser, version: str) -> str:
    """plugd(1)."""
    name = parser.prog
    lines = [
        f'.TH {name.upper()} 1 "" "{name} {version}" "User Commands"',
        f".SH NAME\n{name} \\- charges an electric car when the grid is cleanest",
        f".SH SYNOPSIS\n.B {name}\n[\\-c FILE] [\\-v] COMMAND ...",
        f".SH DESCRIPTION\n{escaped(parser.description or '')}",
        ".SH OPTIONS",
        *_described(parser),
        ".SH COMMANDS",
        *_sections(parser, name),
        ".SH FILES",
        *(f".TP\n.I {escaped(path)}\n{escaped(said)}" for path, said in FILES),
        ".SH EXIT STATUS",
        *(f".TP\n.B {code}\n{said}" for code, said in EXITS),
    ]
    return "\n".join(lines) + "\n"


def _words(parser: argparse.ArgumentParser) -> str:
    options = (option for action in plain(parser) for option in action.option_strings)
    return " ".join((*commands(parser), *options))


def _cases(parser: argparse.ArgumentParser, path: str = "") -> Iterator[str]:
    yield f'    "{path}") words="{_words(parser)}" ;;'
    for command, inner in commands(parser).items():
        yield from _cases(inner, f"{path} {command}".strip())


def completion(parser: argparse.ArgumentParser) -> str:
    """For bash: the commands said so far choose the words; where no word fits, files."""
    name = parser.prog
    known = " ".join(sorted({c for p in (parser, *commands(parser).values()) for c in commands(p)}))
    return f"""# Completion of {name} for bash
_{name}() {{
  local word path="" words="" i
  COMPREPLY=()
  for ((i = 1; i < COMP_CWORD; i++)); do
    word="${{COMP_WORDS[i]}}"
    case " {known} " in *" $word "*) path="${{path:+$path }}$word" ;; esac
  done
  case "$path" in
{chr(10).join(_cases(parser))}
  esac
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}")
}}
complete -o default -F _{name} {name}
"""
