"""What a device gets: rows 18, 19."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from hapfmt import Settings
from hapfmt.reading.reader import Reader
from hapfmt.replay.profile.model import Actuator, FrameBlock, Profile, Timing
from hapfmt.replay.render import Renderer, assign
from hapfmt.replay.schedule import Schedule

from .row import Row, at_least, at_most, compared
from .signals import RATE, Samples, contact, file_of, force, texture

FAST = 10_000
STEP_N = 0.001


def device(rate: int, band: str = "full") -> Profile:
    """One actuator of +-5 N in steps of 1 mN, 500 N/s, ramps of 50 ms."""
    actuator = Actuator(
        "finger",
        "N",
        -5.0,
        5.0,
        500.0,
        STEP_N,
        band=band,
        accepts={"N": 1.0},  # type: ignore[arg-type]
    )
    return Profile("made up", "", "", (), Timing(Fraction(rate)), (actuator,), gain=1.0)


def played(data: bytes, rate: int, band: str = "full") -> Samples:
    """What the renderer makes of the file for a device of this rate and band."""
    with Reader(data) as reader:
        profile = device(rate, band)
        blocks = list(Renderer(reader, profile, assign(reader, profile, by_order=True)).blocks())
    return np.asarray(np.concatenate([block.values for block in blocks])[:, 0])


def images_db(y: Samples) -> float:
    """Power above 500 Hz over that below, where the texture ends at 400 Hz."""
    power = np.abs(np.fft.rfft(y * np.hanning(y.size))) ** 2
    split = 500 * y.size // FAST
    return float(10 * np.log10(power[split:].sum() / power[1:split].sum()))


def upsampling() -> Iterator[Row]:
    fine = texture(4000, 0.3)
    data = file_of(force(fine), settings=Settings.of("paper", step="0.01"))
    with Reader(data) as reader:
        kinds = {track.kind for track in reader.catalogue.tracks.values()}
    ours = played(data, FAST, "hf")
    places = np.arange(fine.size * 10) / 10
    hold = fine[places.astype(int)]
    line = np.interp(places, np.arange(fine.size), fine)
    for case, naive, least in (("held", hold, -15), ("joined by lines", line, -30)):
        yield compared(
            18, f"texture of 1 kHz on a device of 10 kHz, {case}",
            (images_db(naive), at_least(least)), (images_db(ours), at_most(-60)),
            "dB of images above 500 Hz", "HF by the band-limited kernel that SPEC names",
            held=kinds == {"lf", "hf"},
        )  # fmt: skip
    x = contact(2000, 1000)
    spectrum = np.fft.rfft(x)
    sinc = np.fft.irfft(np.concatenate([spectrum, np.zeros(9 * spectrum.size - 9)]), 20_000) * 10
    whole = played(file_of(force(x), settings=Settings.of("lossless")), FAST)
    middle = slice(5000, 9990)  # before the touch, away from the spectrum's own seam
    yield compared(
        18, "stiff contact on a device of 10 kHz, band-limited",
        (1000 * np.abs(sinc[middle]).max(), at_least(100)),
        (1000 * np.abs(whole[middle]).max(), at_most(0)), "mN before the touch",
        "LF and the sum stay within their neighbours: no force before it, none beyond it",
        held=whole.min() >= 0 and whole.max() <= 3.3,
    )  # fmt: skip


def scheduled(x: Samples) -> NDArray[np.int64]:
    """What is sent of 1 kHz of signal: all of it, a seek to its middle, and a stop in the middle of
    that."""
    schedule = Schedule(device(RATE))
    rows: list[int] = []

    def feed(first: int, part: Samples, generation: int) -> None:
        known = np.ones((part.size, 1), np.bool_)
        schedule.feed(FrameBlock(first, part[:, None], known, generation))

    def run(frames: int) -> None:
        for _ in range(frames):
            frame = schedule.frames_due(schedule.next_ns)
            assert frame is not None
            rows.extend(row[0] for row in frame.counts)

    feed(0, x, 0)
    run(1500)
    schedule.seek(1, x.size // 2)
    feed(x.size // 2, x[x.size // 2 :], 1)
    run(1000)
    schedule.stop()
    while schedule.state != "ended":
        run(1)
    return np.array(rows)


def start_seek_stop() -> Row:
    t = np.arange(4000) / RATE
    x = 1.4 * np.cos(2 * np.pi * 0.4 * t)
    half = x.size // 2
    naive = np.concatenate([[0.0], x[:1500], x[half : half + 1000], [0.0]])
    sent = scheduled(x)
    ours = np.diff(sent, prepend=0, append=0) * STEP_N
    return compared(
        19, "start, seek and stop on a stiff device", (np.abs(np.diff(naive)).max(), at_least(1)),
        (np.abs(ours).max(), at_most(0.06)), "N from one tick to the next",
        "raised cosines of 50 ms; the signal itself moves by "
        f"{1000 * np.abs(np.diff(x)).max():.1f} mN a tick, and is played to {sent.max()} mN",
        held=sent[-1] == 0 and int(np.abs(sent).max()) == 1400,
    )  # fmt: skip


def stiff_jump() -> Row:
    """A recording that jumps itself: hard contact, 0 to 4.5 N."""
    x = contact(1200, 600, 4.5)
    sent = scheduled(np.tile(x, 3))
    return compared(
        19, "a contact of 4.5 N in one sample", (np.abs(np.diff(x)).max(), at_least(4)),
        (np.abs(np.diff(sent)).max() * STEP_N, at_most(0.5)), "N from one tick to the next",
        "slew limit of the device, 500 N/s", held=sent.max() == 4500 and sent[-1] == 0,
    )  # fmt: skip


def broken_clock() -> Row:
    """Who waits until a clock that was set back tells the old time again holds the force."""
    schedule = Schedule(device(RATE))
    x = np.full(4000, 2.0)
    schedule.feed(FrameBlock(0, x[:, None], np.ones((x.size, 1), np.bool_), last=True))
    hour = 3600 * 10**9
    sent = []
    for tick in range(4000):
        now = tick * 1_000_000 - (hour if tick >= 1000 else 0)
        frame = schedule.frames_due(now)
        if frame:
            sent += [(tick, row[0]) for row in frame.counts]
    away = [tick for tick, count in sent if count]
    naive = 4000 - 1000
    return compared(
        19, "a clock that runs back by an hour", (naive, at_least(3000)),
        (max(away) - 1000, at_most(100)), "ms under force",
        f"the schedule goes by the time that passes, ramps to rest and stops: {schedule.outcome}",
        held=schedule.state == "ended" and schedule.outcome == "late",
    )  # fmt: skip


ROWS = (upsampling, start_seek_stop, stiff_jump, broken_clock)
