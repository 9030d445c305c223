"""A stream of any kind -> a recorder (docs/streams.md): the first bytes tell which it is."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import ParameterError
from .frames import MAGIC, Frames
from .lines import Lines, Table
from .recorder import Recorder
from .session import Header, Session


class Stream:
    """Takes bytes in pieces of any size. ``begin`` makes the recorder once the channels are known.

    Errors of the stream say where: a line, or the byte where a frame begins. What came before is
    with the recorder.
    """

    def __init__(self, begin: Callable[[Header], Recorder], table: Table | None = None) -> None:
        self.session = Session(begin)
        self.table = table or Table()
        self.first = b""
        self.parser: Lines | Frames | None = None

    @property
    def recorder(self) -> Recorder | None:
        return self.session.recorder

    def feed(self, data: bytes) -> None:
        if self.parser is None:
            self.first += data
            if len(self.first) < len(MAGIC) and MAGIC.startswith(self.first):
                return
            self.choose()
            data, self.first = self.first, b""
        assert self.parser is not None
        self.work(lambda parser: parser.feed(data))

    def choose(self) -> None:
        binary = self.first.startswith(MAGIC)
        self.parser = Frames(self.session) if binary else Lines(self.session, self.table)

    def finish(self) -> None:
        """The stream has ended."""
        if self.parser is None:
            self.choose()
            first = self.first
            self.work(lambda parser: parser.feed(first))
        self.work(lambda parser: parser.finish())
        if self.recorder is None:
            raise ParameterError("the stream ended before any channel was named")

    def work(self, step: Callable[[Lines | Frames], None]) -> None:
        assert self.parser is not None
        try:
            step(self.parser)
        except ParameterError as error:
            if error.path is not None:
                # Of the file that is written.
                raise
            raise StreamError(f"{self.parser.place}: {error.message}") from error


class StreamError(ParameterError):
    """What a stream says makes no sense."""
