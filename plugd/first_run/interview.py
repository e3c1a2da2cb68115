"""Asking: one question after the other, until each has an answer that the configuration takes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Protocol

from plugd.config import doubts
from plugd.config.complaint import one_line
from plugd.config.secret_files import secret
from plugd.errors import ConfigError, UsageError
from plugd.first_run.answers import Answers, configured, refusal, written, yes_no
from plugd.first_run.questions import BROKER, CAR, CHARGING, PLACE, PLUG, Question, state

PASSWORD_FILE = "mqtt_password"  # nosec B105 # its name, not what is in it


class Person(Protocol):
    """Who answers: somebody at a terminal, or lines on stdin."""

    @property
    def present(self) -> bool:
        """Whether they can be asked what depends on what is found. Lines on stdin know nothing of that."""
        ...

    def say(self, text: str) -> None:
        """Tell them something."""
        ...

    def ask(self, prompt: str) -> str:
        """A line of theirs. Raises EOFError when there is none."""
        ...

    def ask_secret(self, prompt: str) -> str:
        """A line that is not shown. Raises EOFError when there is none."""
        ...


@dataclass(frozen=True, slots=True)
class Found:
    """What a look at the broker gave."""

    refusal: str | None = None
    """Why it does not let us in."""
    plugs: tuple[tuple[str, str], ...] = ()
    """(kind, topic) of those that say that they are there."""


@dataclass(frozen=True, slots=True)
class Draft:
    """What the person has answered: the configuration's keys, and the secret that is kept apart from them."""

    answers: Answers
    password: str | None = None


Look = Callable[[Draft], Found]


def interview(person: Person, folder: Path, state_folder: str, look: Look) -> Draft:
    """Ask everything. `folder`: where the file will be. Raises UsageError when the answers end too early."""
    try:
        return _asked(person, folder, state_folder, look)
    except EOFError:
        raise UsageError(
            "init: the answers ended before the questions; give one a line (empty for the default), "
            "or answer at a terminal; nothing was written"
        ) from None


def confirmed(person: Person, question: str, default: bool) -> bool:
    """Yes or no; EOFError stands for no."""
    key = "answer"
    while True:
        try:
            text = person.ask(f"{question} [{'Y/n' if default else 'y/N'}]: ").strip()
            return bool(yes_no(key)(text)[key]) if text else default
        except ValueError as error:
            person.say(f"  {error}")
        except EOFError:
            return False


def _asked(person: Person, folder: Path, state_folder: str, look: Look) -> Draft:
    rest = (*CAR, state(state_folder))
    asking = Asking(person, folder, (*PLACE, *BROKER, *PLUG, *CHARGING, *rest))
    draft, found = _broker(asking, asking.all(PLACE, {}), look)
    return Draft(asking.all(rest, _charging(asking, _plug(asking, draft.answers, found))), draft.password)


@dataclass(frozen=True, slots=True)
class Asking:
    """How questions are put, and which there are."""

    person: Person
    folder: Path
    every: tuple[Question, ...]

    def all(self, questions: Sequence[Question], answers: Answers) -> Answers:
        """Answers, and those to the questions that apply."""
        for question in questions:
            others = {key: value for key, value in answers.items() if key not in question.keys}
            answers = {**others, **self._one(question, answers)} if question.when(answers) else others
        return answers

    def _one(self, question: Question, answers: Answers) -> Answers:
        default = question.default(answers)
        if default and self._refused(question, question.read(default), answers):
            default = ""
        shown = f" [{default}]" if default else f" [Enter: {question.blank}]" if question.blank else ""
        if before := question.before(answers):
            self.person.say(before)
        while True:
            text = _bare(self.person.ask(f"{question.text}{shown}: ")) or default
            try:
                given = self._given(question, text)
                refused = self._refused(question, given, answers)
            except ValueError as error:
                refused = str(error)
            if refused is None:
                self._understood(text, given)
                return given
            self.person.say(f"  {refused}")

    def _understood(self, text: str, given: Answers) -> None:
        """Show what was made of an answer that was not taken as it stands."""
        if given and text not in map(written, given.values()):
            self.person.say(f"  {', '.join(f'{key} = {written(value)}' for key, value in given.items())}")

    def _given(self, question: Question, text: str) -> Answers:
        if text:
            return question.read(text)
        if not question.blank:
            raise ValueError("this has no default; an answer is needed")
        return {}

    def _refused(self, question: Question, given: Answers, answers: Answers) -> str | None:
        after = self.every[self.every.index(question) + 1 :]
        later = frozenset(chain.from_iterable(one.keys for one in after))
        return refusal({**answers, **given}, question.keys, later, self.folder)


def _bare(line: str) -> str:
    """An answer without the quotes that the file would have."""
    text = line.strip()
    return text[1:-1].strip() if len(text) > 1 and text[0] == text[-1] == '"' else text


# -- the broker, and what is found there ----------------------------------------------------------


def _broker(asking: Asking, answers: Answers, look: Look) -> tuple[Draft, Found]:
    """Where the broker is. A person may think again when it does not let us in."""
    person, draft = asking.person, Draft(answers)
    while True:
        answers = asking.all(BROKER, answers)
        draft = _with_password(asking, answers, draft) if "broker.username" in answers else Draft(answers)
        if not person.present:
            return draft, Found()
        person.say("Looking at the broker ...")
        found = look(draft)
        if found.refusal is None:
            return draft, found
        person.say(f"  {found.refusal}")
        if not confirmed(person, "Tell me about the broker again?", default=True):
            return draft, found


def _with_password(asking: Asking, answers: Answers, before: Draft) -> Draft:
    """The password of its user, which is kept in a file beside the configuration. `before`: what was told last time."""
    path, name = asking.folder / PASSWORD_FILE, str(answers["broker.username"])
    told = before.password if name == before.answers.get("broker.username") else None
    blank = "as before" if told else f"the one in {path}" if path.exists() else "it needs none"
    others = {key: value for key, value in answers.items() if key != "broker.password_file"}
    while True:
        text = asking.person.ask_secret(f"Password of {one_line(name)} [Enter: {blank}]: ") or told
        if not text:
            return Draft({**others, "broker.password_file": str(path)} if path.exists() else others)
        try:
            secret(text.encode("utf-8", "surrogateescape"), "the password")
        except ConfigError as error:
            asking.person.say(f"  {error}")
        else:
            return Draft({**others, "broker.password_file": str(path)}, text)


def _plug(asking: Asking, answers: Answers, found: Found) -> Answers:
    """The plug: one of those found, else in the person's words."""
    later = frozenset(chain.from_iterable(one.keys for one in asking.every))
    plugs = [
        chosen
        for chosen in ({"plug.kind": kind, "plug.topic": topic} for kind, topic in found.plugs)
        if refusal({**answers, **chosen}, tuple(chosen), later, asking.folder) is None
    ]
    if not plugs:
        return asking.all(PLUG, answers)
    person, numbered = asking.person, {str(place): chosen for place, chosen in enumerate(plugs, start=1)}
    person.say("These plugs are on the broker:")
    for place, chosen in numbered.items():
        person.say(f"  {place} {chosen['plug.kind']:<12} {one_line(chosen['plug.topic'])}")
    while True:
        text = person.ask("Which of them, by number, or 0 for another [1]: ").strip() or "1"
        if text == "0":
            return asking.all(PLUG, answers)
        if text in numbered:
            return {**answers, **numbered[text]}
        person.say(f"  a number from 0 to {len(plugs)} is wanted")


# -- what flows -----------------------------------------------------------------------------------


def _charging(asking: Asking, answers: Answers) -> Answers:
    """Power and current. Asked again where each is possible and the plug would cut the car off at once."""
    while True:
        answers = asking.all(CHARGING, answers)
        doubted = doubts(configured(answers, asking.folder))
        if not doubted:
            return answers
        for doubt in doubted:
            asking.person.say(f"  {doubt}")
