"""hapfmt study: asks one subject for ratings, on a terminal or through a pipe.

On a terminal, r, p and a act at once, and so does any key on an empty line. A number is a line,
ended by Enter. Through a pipe every input is a line, and the end of the input counts as q.
"""

from __future__ import annotations

import csv
import io
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from ..lab.study.description import HIGHEST, fifth
from ..lab.study.rating import NotYetError, Rating
from ..numbers import counted
from .common import echo_json, force_option, json_option, progress, refuse_idle
from .screen import Column, Verb, complain, document, note, printable, raw, say, table

if TYPE_CHECKING:
    from ..lab.study.description import Study
    from ..lab.study.outputs import ChannelMap, StudyOutput
    from ..lab.study.prepare import Prepared
    from ..lab.study.summary import Mean, StudySummary, SummaryRow

KEYS = {"r": "reference", "p": "this", "a": "again", "b": "back", "q": "quit", "?": "help"}
WORDS = {"": "help", **{word: word for word in KEYS.values()}, "play": "this", "h": "help"}
LONGEST = 40
"""Most characters of a line."""
BAR = 60
END, ERASE = "\x04", "\x7f\b"


def conduct(rating: Rating, subject: str) -> bool:
    """Asks until all is answered (True) or the subject stops (False)."""
    head = rating.study.head
    with AnswerLines() as lines:
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
    tell(f"played {what}{where.get(rating.output.description['kind'], '')}")


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
    tell("r plays the reference, p this one, a the last again")
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


class AnswerLines:
    """Words of a subject; a terminal gives keys one by one while it is asked, and is as it was
    before while something plays, so that Ctrl-C always works."""

    def __init__(self) -> None:
        self.descriptor: int | None = None
        self.termios: Any = None
        self.before: Any = None

    def __enter__(self) -> AnswerLines:
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
        """The next word, or None at the end of the input."""
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


MODES = ("new", "prepare", "summary")
LEAST_FREE = 1 << 20
"""Bytes on the disk of the answers: a full one is found before the first question."""
INTERRUPTED = 130
"""128 + SIGINT, as in hapfmt replay."""


@click.command(cls=Verb)
@click.argument("files", metavar="STUDY.toml|ANSWERS...", nargs=-1, required=True)
@click.option("--subject", metavar="S07", help="Whose answers: a code, not a name.")
@click.option("--device", metavar="PROFILE", help="Feel it on a haptic device: see hapfmt profile.")
@click.option("--path", metavar="DEVICE_PATH", help="The device to use if several fit the profile.")
@click.option(
    "--gain",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="GAIN",
    help="Scale all outputs of a device, above 0 and at most 1 [default: of the profile].",
)
@click.option(
    "--map",
    "channels",
    multiple=True,
    metavar="A=1,B=2",
    help="Play these channels alone: CHANNEL=ACTUATOR, as in hapfmt replay.",
)
@click.option("--ignore", multiple=True, metavar="A,B", help="Leave these channels out.")
@click.option(
    "--map-by-order",
    is_flag=True,
    help="Assign channels to actuators by unit and order, whatever their names.",
)
@click.option(
    "--no-watchdog", is_flag=True, help="Run without the watchdog, for devices that open only once."
)
@click.option(
    "--sound",
    metavar="CHANNEL[/DEVICE]",
    help="Feel it on a channel of a sound card, from 1: 1, 2/USB.",
)
@click.option(
    "--wav",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Write what would be felt as WAV files, for another player.",
)
@click.option("--dry-run", is_flag=True, help="Ask, and play nothing; with --device render it all.")
@click.option(
    "--answers",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="File for the answers; an existing one is continued [STUDY-answers/SUBJECT.jsonl].",
)
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Where the conditions are kept, made once [STUDY-conditions].",
)
@click.option("--new", is_flag=True, help="Write STUDY.toml, to edit; recordings follow it.")
@click.option("--prepare", "prepare_only", is_flag=True, help="Make the conditions, and list them.")
@click.option("--summary", is_flag=True, help="What all of ANSWERS say together.")
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="OUT",
    help="With --summary: a picture, .png .svg .pdf.",
)
@click.option("--csv", "as_csv", is_flag=True, help="With --summary: print CSV.")
@force_option
@json_option
def study(
    files: tuple[str, ...],
    subject: str | None,
    new: bool,
    prepare_only: bool,
    summary: bool,
    folder: Path | None,
    answers: Path | None,
    plot: Path | None,
    as_csv: bool,
    force: bool,
    as_json: bool,
    **felt: Any,
) -> int:
    """Play the conditions of a study in random order, each with its reference, and store how
    SUBJECT rates them, from 0 to 100. Then summarise all subjects. docs/studies.md explains how to
    write and run a study, docs/safety.md what a device can do to a hand.

    \b
    hapfmt study --new study.toml sand.hapf cork.hapf
    hapfmt study study.toml --prepare
    hapfmt study study.toml --subject S07 --device glove5
    hapfmt study --summary study-answers/*.jsonl --plot opinions.png

    Every answer is on the disk before the next question. After Ctrl-C, the same command continues
    where it stopped.
    """
    chosen = [
        name for name, given in zip(MODES, (new, prepare_only, summary), strict=True) if given
    ]
    if len(chosen) > 1:
        raise ParameterError(f"choose one of --{' and --'.join(chosen)}")
    if not summary:
        refuse_idle("requires --summary", plot=plot, csv=as_csv)
    if as_csv and as_json:
        raise ParameterError("choose one of --csv and --json")
    if not new and plot is None:
        refuse_idle("requires --new or --plot", force=force)
    if not chosen:
        refuse_idle("requires --new, --prepare or --summary", json=as_json)
    else:
        asked = {**felt, "map": felt["channels"], "channels": None}
        refuse_idle(f"does not go with --{chosen[0]}", subject=subject, answers=answers, **asked)
    if new or summary:
        refuse_idle(f"does not go with --{chosen[0]}", folder=folder)
    if summary:
        return print_summary(files, plot, as_csv, as_json, force)
    if new:
        return create_study(files, force, as_json)
    if len(files) != 1:
        raise ParameterError("one study at a time (--new and --summary take several files)")
    from ..lab.study.description import load_study

    study = load_study(files[0])
    if prepare_only:
        return tell_prepared(study, prepare_conditions(study, folder), as_json)
    if subject is None:
        raise ParameterError("whose answers? give --subject, a code such as S07")
    return run_questions(study, subject, folder, answers, felt)


def create_study(files: tuple[str, ...], force: bool, as_json: bool) -> int:
    from ..files import atomic_write
    from ..lab.study.description import new_study, parse_study

    path = Path(files[0])
    text = new_study(path, files[1:])
    study = parse_study(text.encode(), path)
    with atomic_write(path, force=force) as stream:
        stream.write(text.encode())
    if as_json:
        sessions = [each.name for each in study.sessions]
        echo_json({"study": str(path), "sessions": sessions,
                   "conditions": [each.name for each in study.conditions]})  # fmt: skip
    else:
        say(
            f"{path!s}: {counted(len(study.sessions), 'session')} of "
            f"{counted(len(study.conditions), 'condition')}; edit it, then --prepare"
        )
    return 0


def prepare_conditions(study: Study, folder: Path | None) -> Prepared:
    from ..lab.study.prepare import prepare

    with progress("preparing") as advance:
        return prepare(study, folder or study.folder("conditions"), advance)


def tell_prepared(study: Study, prepared: Prepared, as_json: bool) -> int:
    from ..encoder.settings import alias_note

    for each in study.conditions:
        if text := alias_note(each.preset or ""):
            note(f"condition {each.name!r}: {text}")
    if as_json:
        rows = [{**s._asdict(), "path": str(s.path), "bits_per_sample": s.bits_per_sample}
                for s in prepared.stimuli]  # fmt: skip
        echo_json({"study_sha256": study.digest, "stimuli": rows})
        return 0
    rows_shown = [
        [s.session, s.condition, study.condition(s.condition).role, str(s.file_size),
         f"{s.bits_per_sample:.3f}", s.path.name]
        for s in prepared.stimuli
    ]  # fmt: skip
    table(["session", "condition", "role", "bytes", "b/sample", "file"], rows_shown)
    if not any(each.role == "anchor" for each in study.conditions):
        note("no condition is an anchor, so nothing holds the low end of the scale")
    return 0


def run_questions(
    study: Study, subject: str, folder: Path | None, answers: Path | None, felt: dict[str, Any]
) -> int:
    """Asks the questions; answers are on the disk even after an error."""
    from ..lab.study.outputs import SignalError
    from ..lab.study.rating import AnswerFile, Rating, heading, refuse_subject

    refuse_subject(subject)
    choose_output(felt)
    prepared = prepare_conditions(study, folder)
    output = output_of(felt, study, prepared)
    path = answers or study.folder("answers") / f"{subject}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    if shutil.disk_usage(path.parent).free < LEAST_FREE:
        raise ParameterError("the disk is full: answers could not be kept", path=str(path))
    head = heading(study, prepared, subject, output.description)
    with AnswerFile(path, head, complain) as file:
        rating = Rating(study, prepared, file, output)
        code = 0
        try:
            finished = conduct(rating, subject)
        except KeyboardInterrupt as stopped:
            finished, code = False, INTERRUPTED
            if isinstance(stopped, SignalError):
                code = 128 + stopped.number
            say()
        finally:
            say(f"{rating.done} of {len(rating.trials)} answers are in {path!s}")
        if not finished:
            say("the same command goes on from here")
    return code


def choose_output(felt: dict[str, Any]) -> None:
    """Refuses options of the output that exclude each other, before any work."""
    ways = [name for name in ("device", "sound", "wav") if felt[name] is not None]
    if felt["dry_run"] and ways == ["device"]:
        ways = ["dry_run"]
    elif felt["dry_run"]:
        ways.append("dry_run")
    if len(ways) != 1:
        raise ParameterError(
            "say where it is felt: --device PROFILE, --sound CHANNEL, --wav FOLDER, or --dry-run"
            + (", one of them" if ways else "")
        )
    opened = {"path": felt["path"], "no_watchdog": felt["no_watchdog"]}
    played = {"map": felt["channels"], **{x: felt[x] for x in ("gain", "ignore", "map_by_order")}}
    if felt["device"] is None:
        refuse_idle("requires --device", **opened, **played)
    if felt["dry_run"]:
        refuse_idle("is for a device, and --dry-run opens none", **opened)


def output_of(felt: dict[str, Any], study: Study, prepared: Prepared) -> StudyOutput:
    from ..lab.study import outputs

    if felt["device"] is not None:
        from ..replay.profile.parse import load_profile

        profile = load_profile(felt["device"])
        mapping = mapping_of(felt, prepared)
        plans = [outputs.plan(each.path, profile, mapping) for each in prepared.stimuli]
        for line in dict.fromkeys(line for plan in plans for line in plan):
            say(line, err=True)
        if felt["dry_run"]:
            return outputs.Nowhere(profile, felt["gain"], mapping)
        config = outputs.find_device(profile, felt["path"])
        return outputs.DeviceOutput(profile, config, felt["gain"], mapping, not felt["no_watchdog"])
    if felt["sound"] is not None:
        from ..lab.study.outputs import Card, parse_card

        return outputs.SoundCard(study, prepared, Card(*parse_card(felt["sound"])))
    if felt["wav"] is not None:
        return outputs.WavFiles(study, prepared, felt["wav"])
    return outputs.Nowhere()


def mapping_of(felt: dict[str, Any], prepared: Prepared) -> ChannelMap:
    """The map of channels, as in hapfmt replay; a label may contain a comma."""
    from ..lab.study.outputs import ChannelMap
    from ..reading.reader import Reader
    from .replay import parts

    with Reader(str(prepared.stimuli[0].path)) as reader:
        labels = [each.label for each in reader.channels]
    given, ignored = (tuple(parts(felt[name], labels)) for name in ("channels", "ignore"))
    return ChannelMap(given, ignored, felt["map_by_order"])


def print_summary(
    files: tuple[str, ...], plot: Path | None, as_csv: bool, as_json: bool, force: bool
) -> int:
    from ..lab.study.rating import load_answers
    from ..lab.study.summary import summarise, summary_json

    if plot is not None:
        from ..files import refuse

        refuse(str(plot), force)
    summary = summarise([load_answers(each) for each in files])
    if plot is not None:
        draw(summary, plot, force)
    if as_json:
        echo_json(summary_json(summary))
    elif as_csv:
        document(csv_of(summary))
    else:
        show(summary)
    if not as_json:
        for each in (*summary.notes, *unfinished(summary)):
            note(each)
    return 0


def draw(summary: StudySummary, path: Path, force: bool) -> None:
    from ..lab.plotting.figures import plot_opinions

    rows = [row for row in summary.kept or summary.rows if row.session is None]
    plot_opinions(
        path,
        rows,
        scale=summary.study["scale"],
        title=f"{summary.study['name']}: {people(rows[0].rating.n)}, mean and 95 % interval",
        force=force,
    )


def csv_of(summary: StudySummary) -> str:
    from ..lab.study.summary import HEADERS, table_rows

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEADERS)
    writer.writerows(table_rows(summary))
    return stream.getvalue()


def show(summary: StudySummary) -> None:
    out = summary.screened_out
    study = summary.study
    missed = f"rated the hidden reference below {study['screen_below']:g} too often"
    show_rows(f"{study['name']}: {people(len(summary.subjects))}", summary.rows)
    if not out:
        say(f"no subject {missed}")
        return
    say(f"{len(out)} {missed}: {', '.join(out)}")
    if summary.kept:
        show_rows(f"without them: {people(len(summary.subjects) - len(out))}", summary.kept)


def people(count: int) -> str:
    return counted(count, "subject")


def show_rows(title: str, rows: tuple[SummaryRow, ...]) -> None:
    many = any(row.session is not None for row in rows)
    headers = [
        Column("condition"), Column("role", 6), Column("b/sample", 2), Column("n", 3),
        Column("mean"), Column("+-", 1), Column("to reference", 4), Column("+-", 5),
    ]  # fmt: skip
    shown = [
        [
            *([row.session or "all"] if many else []),
            row.condition,
            row.role,
            "-" if row.bits_per_sample is None else f"{row.bits_per_sample:.3f}",
            str(row.rating.n),
            f"{row.rating.mean:.1f}",
            half_of(row.rating),
            f"{row.difference.mean:+.1f}",
            half_of(row.difference),
        ]
        for row in rows
    ]
    say(title)
    table([*([Column("session")] if many else []), *headers], shown)


def half_of(mean: Mean) -> str:
    return "-" if mean.half is None else f"{mean.half:.1f}"


def unfinished(summary: StudySummary) -> list[str]:
    return [
        f"{each.name} is left out: {each.open} questions are open" for each in summary.unfinished
    ]
