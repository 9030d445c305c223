"""hapfmt demo: simulates a stylus on a texture and encodes its force with every preset."""

from __future__ import annotations

import io
import time
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .common import BitsType, FractionType, echo_json, force_option, json_option, refuse_idle
from .screen import Column, Verb, say, table

if TYPE_CHECKING:
    from ..recording import Recording

PRESETS: dict[str, tuple[str, dict[str, Any], str]] = {
    "lossless": ("lossless", {}, "every bit"),
    "near-lossless": ("near-lossless", {"max_error": "0.1%"}, "0.1 % of range"),
    "perceptual": ("perceptual", {}, "what is felt"),
    "perceptual --no-texture": ("perceptual", {"texture": False}, "slow part only"),
    "paper": ("paper", {"smallest": False}, "as in the paper"),
}
"""Name, preset, options, and what is kept; guarantees first, the paper's method last."""


@dataclass(frozen=True)
class Outcome:
    """One setting: the file, and the errors of its decoded force in newtons."""

    name: str
    kept: str
    data: bytes
    payload_size: int
    ratio: float
    snr_hf_db: float
    largest_error: float
    rms_error: float
    outside_share: float
    encode_s: float
    decode_s: float


@click.command(cls=Verb)
@click.option(
    "--texture",
    type=click.Choice(["stone", "sand", "cork", "none"]),
    default="sand",
    show_default=True,
)
@click.option(
    "--seconds", type=click.FloatRange(0.1, 600), metavar="S", default=4.0, show_default=True
)
@click.option("--seed", type=click.IntRange(0), metavar="N", default=1, show_default=True)
@click.option(
    "--k",
    "k",
    type=FractionType(),
    default="0.1",
    show_default=True,
    help="Weber fraction of perceptual and paper.",
)
@click.option(
    "--bits",
    type=BitsType(),
    default=5,
    show_default=True,
    help="Bits of the residual of paper.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="OUT",
    help="Write the lossless .hapf file here.",
)
@click.option("--plot", type=click.Path(path_type=Path), help="Write a picture: .png .svg .pdf.")
@force_option
@json_option
def demo(
    texture: str,
    seconds: float,
    seed: int,
    k: Fraction,
    bits: int,
    output: Path | None,
    plot: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Simulate a stylus that crosses a texture, and write its force with every preset.

    The table shows the size of each file, and how close the decoded force is to the original. No
    file and no device is needed. The stylus has 60 g and is held by a hand.

    \b
    hapfmt demo
    hapfmt demo --texture cork --plot demo.png --output demo.hapf
    """
    from ..files import atomic_write, refuse
    from ..lab.scenes.stylus import simulate

    if output is None and plot is None:
        refuse_idle("requires --output or --plot", force=force)
    for path in (output, plot):
        if path is not None:
            refuse(str(path), force)
    began = time.perf_counter()
    recording = simulate(None if texture == "none" else texture, seconds, seed)
    simulated = time.perf_counter() - began
    own: dict[str, dict[str, Any]] = {
        "perceptual": {"k": k},
        "perceptual --no-texture": {"k": k},
        "paper": {"k": k, "bits": bits},
    }
    outcomes = [run(recording, name, own.get(name, {})) for name in PRESETS]
    if output is not None:
        with atomic_write(output, force=force) as stream:
            stream.write(outcomes[0].data)
    if plot is not None:
        draw(plot, recording, texture, outcomes, k, force)
    if as_json:
        echo_json(
            {
                "texture": texture,
                "sample_count": recording.sample_count,
                "simulate_s": simulated,
                "k": float(k),
                "bits": bits,
                "settings": [as_row(outcome) for outcome in outcomes],
            }
        )
        return 0
    show(recording, texture, simulated, outcomes)
    for path, what in ((output, "lossless file"), (plot, "picture")):
        if path is not None:
            say(f"{what}: {path!s}")
    return 0


def run(recording: Recording, name: str, options: dict[str, Any]) -> Outcome:
    """Encode with one of PRESETS, decode, compare."""
    from ..encoder.settings import Settings
    from ..metrics import max_error, rmse, snr_hf_db
    from ..reading.reader import Reader
    from ..reading.verifier import verify
    from ..writing.writer import write

    preset, given, kept = PRESETS[name]
    stream = io.BytesIO()
    began = time.perf_counter()
    settings = Settings.of(preset, **given, **options)
    summary = write(recording, stream, settings, canonical="content")
    encoded = time.perf_counter()
    data = stream.getvalue()
    with Reader(data) as reader:
        back = reader.read()
    decoded = time.perf_counter()
    checks = verify(data, against=recording).contracts
    f, y = recording.channels[0].samples(), back.channels[0].samples()
    rate = float(recording.channels[0].rate_exact)
    return Outcome(
        name,
        kept,
        data,
        summary.payload_size,
        8 * recording.sample_count / len(data),
        snr_hf_db(f, y, rate),
        max_error(f, y),
        rmse(f, y),
        sum(check.outside for check in checks) / max(sum(check.samples for check in checks), 1),
        encoded - began,
        decoded - encoded,
    )


def as_row(outcome: Outcome) -> dict[str, Any]:
    row = {name: value for name, value in vars(outcome).items() if name != "data"}
    return {**row, "file_size": len(outcome.data)}


def show(recording: Recording, texture: str, simulated: float, outcomes: list[Outcome]) -> None:
    from ..split import split_text

    samples = recording.sample_count
    channel = recording.channels[0]
    say(
        f"{channel.label} of a stylus on {texture}: {samples} samples at {channel.rate:g} Hz, "
        f"{8 * samples} bytes"
    )
    say(f"as float64, simulated in {simulated:.2f} s")
    say()
    rows = [
        [
            o.name,
            str(len(o.data)),
            f"{o.ratio:.1f} x" if o.ratio >= 1 else f"{1 / o.ratio:.1f} x larger",
            f"{1000 * o.largest_error:.3g} mN" if o.largest_error else "none",
            f"{o.snr_hf_db:.0f} dB" if isfinite(o.snr_hf_db) else "exact",
            o.kept,
        ]
        for o in outcomes
    ]
    headers = [
        Column("preset"), Column("bytes"), Column("smaller"), Column("largest error"),
        Column("texture", 1), Column("kept", 2),
    ]  # fmt: skip
    table(headers, rows)
    say()
    say("Each row is the same force, written with another preset of 'hapfmt encode'.")
    say(f"'texture': {split_text()}.")
    say("Next: write the file with 'hapfmt demo -o touch.hapf', and encode your own.")


def draw(
    path: Path,
    recording: Recording,
    texture: str,
    outcomes: list[Outcome],
    k: Fraction,
    force: bool,
) -> None:
    """The two bands of the paper's method, and the size of every preset."""
    import numpy as np

    from ..codecs.knots import parse_knots
    from ..encoder.settings import FORCE_FLOOR_N
    from ..format.cluster import Packet
    from ..lab.plotting.figures import Demonstrated, plot_demo
    from ..reading.reader import Reader

    with Reader(outcomes[-1].data) as reader:
        full = reader.read().channels[0]
        slow = reader.read(band="lf").channels[0]
        base = reader.channels[0]
        packets: list[Packet] = list(reader.packets({base.track.id: (0, 1 << 62)}))
        ticks = [parse_knots(p.data, 1, p.offset)[0] + p.start for p in packets]
    d = slow.samples()
    shown = Demonstrated(
        original=recording.channels[0].samples(),
        lf=d,
        decoded=full.samples(),
        half=np.maximum(float(k) * np.abs(d), float(FORCE_FLOOR_N)),
        knots=np.concatenate(ticks),
        rate_hz=full.rate,
        sizes=[
            ("float64", 8 * recording.sample_count),
            *((f"{o.name}: {o.kept}", len(o.data)) for o in outcomes[:-1]),
        ],
        unit=full.unit,
        quantity=full.quantity,
        title=f"{full.label.capitalize()} of a stylus on {texture}, {full.rate:g} Hz",
    )
    plot_demo(path, shown, force=force)
