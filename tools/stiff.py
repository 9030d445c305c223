"""Hard contact at replay: how each kernel renders it, and how far the limiter reduces its steps.

python tools/stiff.py [FILE.npz:CHANNEL ...]

A simulated wall of 1e5 N/m, and channels of files as ``hapfmt.read`` reads them. The wall is known
at 10 kHz, recorded at 1 kHz as a sensor averages it, and rendered for 10 kHz again: error, images
above 500 Hz against what is below, how far lowest and highest force go beyond those recorded, and
the force before the touch. Then the largest change per millisecond that devices would be sent: as
rendered, with ramps alone (limits that nothing reaches), and with the limits of a profile; from the
start, and from the largest force on. Forces in the channel's unit, gain 1.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import NamedTuple

import installed  # noqa: F401

import click
import numpy as np
from measured import print_origin, print_table
from numpy.typing import NDArray

import hapfmt
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.reading.reader import Reader
from hapfmt.recording import Channel, Recording
from hapfmt.replay.profile.model import Actuator, FrameBlock, Profile, Timing
from hapfmt.replay.render import Assignment, Renderer, Route
from hapfmt.replay.render.feed import DeviceGrid, Shape, kernel
from hapfmt.replay.schedule import Schedule
from hapfmt.split import low_pass

Values = NDArray[np.float64]
WALL_N_PER_M = 1e5
SECONDS = 2.0
FINE_HZ, COARSE_HZ = 10_000, 1000
CUTOFF_HZ = 20.0
"""Between LF and HF, as an encoder splits by default."""
TOUCH = 0.02
"""Newtons above the noise of the sensor (4 mN)."""
SHAPES: tuple[Shape, ...] = ("linear", "band-limited", "bounded")


class Limits(NamedTuple):
    """Limits of a device: largest force, and change per second."""

    largest: float
    slew: float


DEVICES = {"N": Limits(5.0, 500.0), "N.m": Limits(0.5, 50.0)}
"""As glove5, and a torque of a tenth."""


def at_rate(x: Values, ratio: Fraction, shape: Shape) -> Values:
    """A signal at another rate, ``ratio`` of its ticks to a sample."""
    chosen = kernel(shape, ratio)
    places = DeviceGrid(Fraction(0), ratio, Fraction(1)).places(0, int(len(x) / ratio))
    around = np.pad(x, chosen.half, mode="symmetric")
    return chosen.apply(around, -chosen.half, places.ticks, places.phases)


def rendered_ways(coarse: Values) -> Iterator[tuple[str, Values]]:
    ratio = Fraction(COARSE_HZ, FINE_HZ)
    yield "hold", np.repeat(coarse, FINE_HZ // COARSE_HZ)
    for shape in SHAPES:
        yield shape, at_rate(coarse, ratio, shape)
    low = low_pass(coarse, COARSE_HZ, CUTOFF_HZ)
    yield "linear of LF alone", at_rate(low, ratio, "linear")
    yield (
        "linear of LF + band-limited of HF",
        at_rate(low, ratio, "linear") + at_rate(coarse - low, ratio, "band-limited"),
    )


def kernel_rows(scene: str, fine: Values) -> Iterator[list[str]]:
    step = FINE_HZ // COARSE_HZ
    coarse = fine.reshape(-1, step).mean(axis=1)
    # The mean of ten values lies in their middle.
    truth = np.interp(np.arange(len(fine)) + (step - 1) / 2, np.arange(len(fine)), fine)
    touch = int(np.flatnonzero(coarse > TOUCH)[0])
    inner = slice(200, -200)
    for name, found in rendered_ways(coarse):
        error = (found - truth)[inner]
        spectrum = np.abs(np.fft.rfft(np.hanning(error.size) * found[inner])) ** 2
        hertz = np.fft.rfftfreq(error.size, 1 / FINE_HZ)
        below, above = (hertz > 20) & (hertz <= COARSE_HZ / 2), hertz > COARSE_HZ / 2
        before = found[: (touch - 1) * step]
        yield [
            scene,
            name,
            f"{1e3 * np.sqrt(np.mean(error**2)):.1f}",
            f"{10 * np.log10(spectrum[above].sum() / spectrum[below].sum()):.1f}",
            f"{1e3 * (found.min() - coarse.min()):.0f}",
            f"{1e3 * (found.max() - coarse.max()):.0f}",
            f"{1e3 * np.abs(before - before[:100].mean()).max():.1f}",
        ]


def profile_for(unit: str, rate: int, limits: Limits) -> Profile:
    actuator = Actuator(
        name="tip",
        unit=unit,
        minimum=-limits.largest,
        maximum=limits.largest,
        slew=limits.slew,
        step=limits.largest / 32_000,
        accepts={unit: 1.0},
    )
    return Profile("stiff", "", "", (), Timing(Fraction(rate)), (actuator,))


def sent(profile: Profile, blocks: Sequence[FrameBlock]) -> tuple[Values, Schedule]:
    """The values that the schedule would send, with gain 1."""
    schedule = Schedule(profile, 1.0)
    waiting = iter(blocks)
    values = []
    while schedule.state != "ended":
        while schedule.needs_blocks and (block := next(waiting, None)) is not None:
            schedule.feed(block)
        frame = schedule.frames_due(schedule.next_ns)
        assert frame is not None
        values += [row[0] * profile.actuators[0].step for row in frame.counts]
    return np.array(values), schedule


def steepest(values: Values, rate: int) -> float:
    """Largest change within a millisecond, that from rest to the first value included."""
    stride = max(rate // 1000, 1)
    line = np.concatenate([np.zeros(stride), values])
    return float(np.abs(line[stride:] - line[:-stride]).max())


def replay_rows(name: str, channel: Channel, start: Fraction) -> Iterator[list[str]]:
    stream = io.BytesIO()
    hapfmt.write(Recording((channel,)), stream, hapfmt.Settings.of("lossless"))
    limits = DEVICES[channel.unit]
    for rate in (1000, 4000):
        with Reader(stream.getvalue()) as reader:
            profile = profile_for(channel.unit, rate, limits)
            routes = Assignment((Route(0, 0, Fraction(1)),))
            blocks = list(Renderer(reader, profile, routes, start=start).blocks())
        plain = np.concatenate([block.values[:, 0] for block in blocks])
        wide = Limits(64 * limits.largest, 1e5 * limits.slew)  # which nothing reaches
        ramped, _ = sent(profile_for(channel.unit, rate, wide), blocks)
        limited, schedule = sent(profile, blocks)
        counts = schedule.counts
        yield [
            f"{name}, from {float(start):.4g} s",
            str(rate),
            f"{np.abs(plain).max():.3f}",
            f"{steepest(plain, rate):.3f}",
            f"{steepest(ramped, rate):.3f}",
            f"{steepest(limited, rate):.3f}",
            f"{np.abs(limited).max():.3f}",
            f"{counts.clamped}",
            f"{counts.slew_limited}",
            f"{len(limited)}",
        ]


def pushing(channel: Channel) -> Fraction:
    """The time of the largest force."""
    return (
        Fraction(channel.start_tick + int(np.abs(channel.samples()).argmax())) / channel.rate_exact
    )


def wall(texture: str | None, rate: int) -> Channel:
    scene = simulate(texture, SECONDS, 1, rate, contact_n_per_m=WALL_N_PER_M)
    return scene.channels[0]


@click.command()
@click.argument("places", nargs=-1, metavar="[FILE.npz:CHANNEL]...")
def main(places: tuple[str, ...]) -> None:
    print_origin()
    scenes = {"wall": None, "wall of stone": "stone"}
    rows = [
        row
        for name, texture in scenes.items()
        for row in kernel_rows(name, wall(texture, FINE_HZ).samples())
    ]
    print_table(
        ("scene", "kernel, 1 to 10 kHz", "error rms mN", "images dB", "below lowest mN",
         "above highest mN", "before touch mN"),
        rows,
    )  # fmt: skip
    cases = {name: wall(texture, COARSE_HZ) for name, texture in scenes.items()}
    for place in places:
        file, _, label = place.rpartition(":")
        cases[f"{label}"] = hapfmt.read(file).channel(label)
    rows = [
        row
        for name, channel in cases.items()
        for start in (Fraction(0), pushing(channel))
        for row in replay_rows(name, channel, start)
    ]
    print_table(
        ("recording", "device Hz", "largest", "step/ms rendered", "with ramps", "with limits",
         "largest sent", "clamped", "slew limited", "samples"),
        rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
