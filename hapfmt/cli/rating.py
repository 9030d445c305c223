"""The questions of hapfmt rate, on a terminal or a pipe.

On a terminal r, p and a act at once, as do all keys where the line is empty; a number is a line
that Enter ends. From a pipe everything is a line, and its end is a q.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import Any

from ..lab.study.description import HIGHEST, fifth
from ..lab.study.rating import NotYetError, Rating
from .screen import printable, raw, say

KEYS = {"r": "reference", "p": "this", "a": "again", "b": "back", "q": "quit", "?": "help"}
WORDS = {"": "help", **{word: word for word in KEYS.values()}, "play": "this", "h": "help"}
LONGEST = 40
"""Characters of a line."""
BAR = 60
END, BREAK, ERASE = "\x04", "\x03", "\x7f\b"


def conduct(rating: Rating, subject: str) -> bool:
    """Until all is answered (True) or the subject stops."""
    head = rating.study.head
    with Lines() as lines:
        tell(f"{head.name}: {head.question}" if head.name else head.question)
        if rating.done:
            tell(f"{subject}: {rating.done} of {len(rating.trials)} are answered; on with the rest")
        tell_scale(head.scale)
        tell_keys()
        shown = None
        while rating.trial is not None:
            if shown != rating.number:
                shown = rating.number
                tell_place(rating)
            word = lines.ask("> ")
            if word is None or meaning(word) == "quit":
                return False
            try:
                act(rating, word)
            except NotYetError as error:
                tell(error.message)
    tell("Done. Thank you.")
    return True


def meaning(word: str) -> str:
    word = word.strip().lower()
    return KEYS.get(word) or WORDS.get(word, "")


def act(rating: Rating, word: str) -> None:
    match meaning(word):
        case "help":
            tell_keys()
        case "back":
            rating.back()
        case "reference" | "this" as which:
            tell_play(rating, rating.play(which))
        case "again":
            tell_play(rating, rating.again())
        case _:
            number = number_in(word)
            if number is None:
                raise NotYetError(f"{printable(word.strip()[:LONGEST])!r} is none of r p a b q ?, "
                                  f"nor a number from 0 to {HIGHEST}")  # fmt: skip
            rating.rate(number)
            tell(f"{number:g}: {fifth(number, rating.study.head.scale)}; saved")


def number_in(word: str) -> float | None:
    """85, 85.5 or 85,5."""
    word = word.strip().replace(",", ".", 1)
    if not word.isascii() or not word.replace(".", "", 1).isdigit():
        return None
    return float(word)


def tell_play(rating: Rating, fault: str) -> None:
    if fault:
        tell(f"it was not felt whole, and does not count: {fault}")
        return
    what = "the reference" if rating.last == "reference" else "this one"
    where = {"dry-run": " (dry run: nothing was felt)", "wav": " (written to its WAV file)"}
    tell(f"played {what}{where.get(rating.output.told['kind'], '')}")


def tell_place(rating: Rating) -> None:
    part, parts, question, questions = rating.place
    assert rating.trial is not None
    if question == 1 and part > 1 and not rating.trial.training:
        tell("")
        tell("This session is done. Rest as long as you like.")
    what = "training, does not count" if rating.trial.training else f"session {part} of {parts}"
    tell("")
    tell(f"{what}: question {question} of {questions}")


def tell_keys() -> None:
    tell("r plays the reference, p this one, a the last once more")
    tell(f"a number from 0 to {HIGHEST} and Enter rates this one; b goes back by one, q stops")


def tell_scale(scale: tuple[str, ...]) -> None:
    """A ruler of five labelled fifths."""
    width = max(BAR // len(scale), *(len(each) + 2 for each in scale))
    marks = [f"{round(n * HIGHEST / len(scale))}" for n in range(len(scale) + 1)]
    ruler = "".join(mark.ljust(width, "-") for mark in marks[:-1]) + marks[-1]
    tell("".join(printable(each).center(width) for each in scale).rstrip())
    tell(ruler)


def tell(text: str) -> None:
    say(text)
    sys.stdout.flush()


class Lines:
    """Words of a subject; a terminal gives keys one by one while it is asked, and is as it was
    before while something plays, so that Ctrl-C always works."""

    def __init__(self) -> None:
        self.descriptor: int | None = None
        self.termios: Any = None
        self.before: Any = None

    def __enter__(self) -> Lines:
        with suppress(OSError, ValueError, AttributeError, ImportError):
            descriptor = sys.stdin.fileno()
            if os.isatty(descriptor) and sys.stdout.isatty():
                import termios

                self.before = termios.tcgetattr(descriptor)
                self.descriptor, self.termios = descriptor, termios
        return self

    def __exit__(self, *_: object) -> None:
        self.restore()

    def restore(self) -> None:
        if self.descriptor is not None:
            with suppress(OSError, self.termios.error):
                self.termios.tcsetattr(self.descriptor, self.termios.TCSADRAIN, self.before)

    def ask(self, prompt: str) -> str | None:
        """A word, or None where no more can come."""
        if self.descriptor is None:
            raw(prompt)
            sys.stdout.flush()
            line = sys.stdin.readline()
            if not sys.stdin.isatty():
                say(line.rstrip("\r\n"))
            return line.rstrip("\r\n") if line else None
        keys = self.termios.tcgetattr(self.descriptor)
        keys[3] &= ~(self.termios.ICANON | self.termios.ECHO)
        try:
            self.termios.tcsetattr(self.descriptor, self.termios.TCSADRAIN, keys)
            # Only now: a key that is typed at the prompt must not meet the terminal's own editing.
            raw(prompt)
            sys.stdout.flush()
            return self.typed()
        finally:
            self.restore()
            say()

    def typed(self) -> str | None:
        line = ""
        while True:
            assert self.descriptor is not None
            data = os.read(self.descriptor, 1)
            character = data.decode("latin-1")
            if not data or (character == END and not line):
                return None
            if character in "\r\n":
                if line:
                    return line
            elif character in ERASE:
                if line:
                    line = line[:-1]
                    raw("\b \b")
            elif character.isprintable() and character.isascii() and len(line) < LONGEST:
                line += character
                raw(character)
                if line.lower() in KEYS:
                    return line
            sys.stdout.flush()
