"""hapfmt demo"""

from __future__ import annotations

import io
import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .common import BitsType, FractionType, echo_json, force_option, json_option
from .screen import say
from .tables import table

if TYPE_CHECKING:
    from ..recording import Recording

BITS = (0, 2, 5, 8)
"""The paper's Fig. 4: deadband alone, and residuals of 2, 5 and 8 bits."""


@dataclass(frozen=True)
class Outcome:
    """One setting: the file, and how far what comes back is from the original (in newtons)."""

    bits: int
    data: bytes
    payload_size: int
    ratio: float
    snr_db: float
    largest_error: float
    rms_error: float
    outside_share: float
    encode_s: float
    decode_s: float


@click.command(short_help="Simulate a stylus on a texture, encode it, show what it costs.")
@click.option(
    "--texture",
    type=click.Choice(["stone", "sand", "cork", "none"]),
    default="sand",
    show_default=True,
)
@click.option("--seconds", type=click.FloatRange(0.1, 600), default=4.0, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--k", "k", type=FractionType(), default="0.1", show_default=True)
@click.option("--bits", type=BitsType(), default=5, show_default=True)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="OUT",
    help="Keep the .hapf file of --bits here.",
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
    """A simulated stylus (60 g, held by a hand) crosses a texture for a few seconds; the force is
    encoded with the paper's method and comes back. Needs no file and no device.

    \b
    hapfmt demo
    hapfmt demo --texture cork --bits 8 --plot demo.png --output demo.hapf
    """
    from ..atomic import atomic_write, refuse
    from ..scenes.stylus import simulate

    for path in (output, plot):
        if path is not None:
            refuse(str(path), force)
    began = time.perf_counter()
    recording = simulate(None if texture == "none" else texture, seconds, seed)
    simulated = time.perf_counter() - began
    outcomes = [run(recording, k, each) for each in sorted({*BITS, bits})]
    chosen = next(outcome for outcome in outcomes if outcome.bits == bits)
    if output is not None:
        with atomic_write(output, force=force) as stream:
            stream.write(chosen.data)
    if plot is not None:
        draw(plot, recording, chosen, k, force)
    if as_json:
        echo_json(
            {
                "texture": texture,
                "sample_count": recording.sample_count,
                "simulate_s": simulated,
                "k": float(k),
                "settings": [as_row(outcome) for outcome in outcomes],
            }
        )
        return 0
    show(recording, texture, simulated, k, outcomes)
    for path, what in ((output, "file"), (plot, "picture")):
        if path is not None:
            say(f"{what}: {path!s}")
    return 0


def run(recording: Recording, k: Fraction, bits: int) -> Outcome:
    """Encode with the paper's method, decode, compare."""
    from ..encoder.settings import Settings
    from ..metrics import max_error, rmse, snr_hf_db
    from ..reading.reader import Reader
    from ..verifier import verify
    from ..writer import write

    stream = io.BytesIO()
    began = time.perf_counter()
    summary = write(recording, stream, Settings.of("paper", k=k, bits=bits), canonical=0)
    encoded = time.perf_counter()
    data = stream.getvalue()
    with Reader(data) as reader:
        back = reader.read()
    decoded = time.perf_counter()
    checks = verify(data, against=recording).contracts
    f, y = recording.channels[0].samples(), back.channels[0].samples()
    rate = float(recording.channels[0].rate_exact)
    return Outcome(
        bits,
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


def show(
    recording: Recording,
    texture: str,
    simulated: float,
    k: Fraction,
    outcomes: list[Outcome],
) -> None:
    samples = recording.sample_count
    channel = recording.channels[0]
    say(
        f"{channel.label} of a stylus on {texture}: {samples} samples at {channel.rate_exact} Hz, "
        f"simulated in {simulated:.2f} s; deadband k = {float(k):.3g}, floor 10 mN"
    )
    rows = [
        [
            str(o.bits) if o.bits else "none",
            str(len(o.data)),
            str(o.payload_size),
            f"{8 * len(o.data) / samples:.3f}",
            f"{o.ratio:.1f}",
            f"{o.snr_db:.1f}",
            f"{1000 * o.largest_error:.1f}",
            f"{1000 * o.rms_error:.2f}",
            f"{100 * o.outside_share:.2f}",
        ]
        for o in outcomes
    ]
    headers = ["bits", "file B", "packets B", "b/sample", "ratio", "HF SNR dB", "max mN",
               "rms mN", "outside %"]  # fmt: skip
    table(headers, rows)
    say(
        "bits: of the residual; ratio: against doubles; HF SNR: texture above 20 Hz against all "
        "error;\noutside: samples beyond the deadband. 'none' is the deadband alone: small, and "
        "without texture."
    )


def draw(path: Path, recording: Recording, chosen: Outcome, k: Fraction, force: bool) -> None:
    """Original, d with its deadband, reconstruction, errors."""
    import numpy as np

    from ..codecs.knots import parse_knots
    from ..codecs.quantised import QuanParameters
    from ..container.cluster import Packet
    from ..encoder.perception import FORCE_FLOOR_N
    from ..limits import LEVELS
    from ..plotting import plot_demo
    from ..reading.reader import Reader

    with Reader(chosen.data) as reader:
        full = reader.read().channels[0]
        slow = reader.read(band="lf").channels[0]
        base = reader.channels[0]
        packets: list[Packet] = list(reader.packets({base.track.id: (0, 1 << 62)}))
        ticks = [parse_knots(p.data, 1, p.offset)[0] + p.start for p in packets]
        last = (base.residual or base.track).contract
    d = slow.samples()
    half = np.maximum(float(k) * np.abs(d), float(FORCE_FLOOR_N))
    step = None
    if base.residual is not None and full.calibration is not None and last is not None:
        step = QuanParameters.parse(base.residual.parameters, LEVELS[2], 0).step
    plot_demo(
        path,
        original=recording.channels[0].samples(),
        lf=d,
        reconstruction=full.samples(),
        lower=d - half,
        upper=d + half,
        rate_hz=float(full.rate_exact),
        knots=np.concatenate(ticks),
        error_bound=step * float(abs(full.calibration.step)) / 2
        if step and full.calibration
        else None,
        unit=full.unit,
        quantity=full.quantity,
        title=f"{full.label}: {len(chosen.data)} bytes, {chosen.ratio:.1f} times smaller",
        force=force,
    )
