"""The README's table of sizes: this format and what a laboratory would use otherwise.

python tools/sizes.py [DATA]      simulated scenes, and a folder of recordings if there is one
python tools/sizes.py --write     put the table into README.md

Prints Markdown: how many times smaller than float64 (8 bytes a sample) each whole file is. The
other libraries write their usual layout. Every lossless file is decoded and compared bit for bit;
near-lossless is held against its error bound.
"""

from __future__ import annotations

import io
import json
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import installed  # noqa: F401

import click
import numpy as np
from bench import counts_of, load_all
from measured import DATA, origin, print_table, write_rows
from numpy.typing import NDArray
from peers.exact import flac_decode, flac_encode, narrow, unzstd, zstd
from peers.packages import installed as has
from peers.packages import left_out, module, versions
from results import mean

import hapfmt
from hapfmt.lab.scenes import load_scene, simulate

SCENES = ("sand", "wall", "taps", "grasp", "free")
SECONDS = 60.0
MAX_ERROR = "0.1%"
GZIP_LEVEL = 9
CDR = b"\x00\x01\x00\x00"
"""Encapsulation of little-endian CDR, ahead of each message."""

SCHEMA = b"builtin_interfaces/Time stamp\nfloat64[] values\n"

RECIPES = {
    "FLAC": "flac -8, one mono file a channel, of integer sensor counts (up to 24 bits). Without "
    "counts a recording does not fit: -.",
    "HDF5 + gzip": f"one file, one dataset a channel, shuffle and gzip {GZIP_LEVEL}; counts as the "
    "narrowest integers, else float64.",
    "Parquet + zstd": "one table for each rate: a column of time stamps and one a channel, as "
    "pyarrow writes them with compression zstd; counts as the narrowest integers, else float64.",
    "MAT v7": "one variable a channel, by savemat with do_compression; counts as the narrowest "
    "integers, else float64.",
    "zstd": "level 19, all channels in one stream; counts as the narrowest integers, else float64.",
    "MCAP + zstd": "one message a tick for all channels of a rate: CDR, time stamp and float64[], "
    "in chunks of 1 MiB, as a robot's recorder writes it.",
}
OURS = ("lossless", f"near-lossless {MAX_ERROR}", "perceptual")

Array = NDArray[np.generic]


class WrongError(Exception):
    """A decoded file differs from its recording."""


def arrays_of(recording: hapfmt.Recording) -> list[Array]:
    """As recorded: counts in the fewest bytes, or float64."""
    return [
        narrow(channel.stored.astype(np.int64), 1, 2, 4) if channel.is_counts else channel.stored
        for channel in recording.channels
    ]


def check(coder: str, given: Sequence[Array], found: Sequence[Array]) -> None:
    """Bit for bit: -0.0 differs from 0.0."""
    for place, (x, y) in enumerate(zip(given, found, strict=True)):
        if x.shape != y.shape or x.tobytes() != y.astype(x.dtype).tobytes():
            raise WrongError(f"{coder}: channel {place} differs after decoding")


def flac(recording: hapfmt.Recording) -> int | None:
    size = 0
    search = all(channel.lsb is None for channel in recording.channels)
    for channel in recording.channels:
        counts = counts_of(channel, search=search)
        blob = None if counts is None else flac_encode(counts, float(channel.rate))
        if counts is None or blob is None:
            return None
        check("FLAC", [counts], [flac_decode(blob, counts.size)])
        size += len(blob)
    return size


def hdf5(recording: hapfmt.Recording) -> int:
    h5py, stream = module("h5py"), io.BytesIO()
    arrays = arrays_of(recording)
    with h5py.File(stream, "w") as file:
        for place, (channel, x) in enumerate(zip(recording.channels, arrays, strict=True)):
            data = file.create_dataset(
                f"{place:03d}", data=x, shuffle=True, compression="gzip",
                compression_opts=GZIP_LEVEL,
            )  # fmt: skip
            data.attrs.update(label=channel.label, unit=channel.unit, rate=float(channel.rate))
    with h5py.File(io.BytesIO(stream.getvalue())) as file:
        check("HDF5", arrays, [file[name][()] for name in sorted(file)])
    return len(stream.getvalue())


def tables_of(recording: hapfmt.Recording) -> list[list[int]]:
    """Numbers of the channels that share their times."""
    groups: dict[object, list[int]] = {}
    for place, channel in enumerate(recording.channels):
        groups.setdefault((channel.rate_exact, channel.coverage), []).append(place)
    return list(groups.values())


def times_ns(channel: hapfmt.Channel) -> Array:
    ticks = np.concatenate([np.arange(span.start, span.stop) for span in channel.coverage])
    rate = channel.rate_exact
    return np.array([tick * 10**9 * rate.denominator // rate.numerator for tick in ticks.tolist()])


def parquet(recording: hapfmt.Recording) -> int:
    pyarrow, pq, size = module("pyarrow"), module("pyarrow.parquet"), 0
    arrays = arrays_of(recording)
    for places in tables_of(recording):
        stamps = times_ns(recording.channels[places[0]])
        columns = {"timestamp": pyarrow.array(stamps, pyarrow.timestamp("ns"))}
        columns.update((f"{place:03d}", pyarrow.array(arrays[place])) for place in places)
        labels = {f"{place:03d}": recording.channels[place].label for place in places}
        table = pyarrow.table(columns).replace_schema_metadata({"labels": json.dumps(labels)})
        stream = io.BytesIO()
        pq.write_table(table, stream, compression="zstd")
        back = pq.read_table(io.BytesIO(stream.getvalue()))
        check("Parquet", [stamps], [back["timestamp"].to_numpy().astype(np.int64)])
        found = [back[f"{place:03d}"].to_numpy() for place in places]
        check("Parquet", [arrays[place] for place in places], found)
        size += len(stream.getvalue())
    return size


def mat(recording: hapfmt.Recording) -> int:
    matlab, stream, arrays = module("scipy.io"), io.BytesIO(), arrays_of(recording)
    names = [f"x{place:03d}" for place in range(len(arrays))]
    about = {
        "labels": np.array([channel.label for channel in recording.channels], object),
        "units": np.array([channel.unit for channel in recording.channels], object),
        "rates": np.array([float(channel.rate) for channel in recording.channels]),
    }
    matlab.savemat(
        stream, {**dict(zip(names, arrays, strict=True)), **about}, do_compression=True,
        oned_as="column",
    )  # fmt: skip
    back = matlab.loadmat(io.BytesIO(stream.getvalue()))
    check("MAT", arrays, [back[name].reshape(-1) for name in names])
    return len(stream.getvalue())


def zstandard(recording: hapfmt.Recording) -> int:
    arrays = arrays_of(recording)
    head = json.dumps(
        [(c.label, c.unit, float(c.rate), x.dtype.str, x.size)
         for c, x in zip(recording.channels, arrays, strict=True)]
    ).encode()  # fmt: skip
    blob = zstd(struct.pack("<I", len(head)) + head + b"".join(x.tobytes() for x in arrays))
    data, found = unzstd(blob), []
    (size,) = struct.unpack_from("<I", data)
    at = 4 + size
    for *_, kind, count in json.loads(data[4:at]):
        found.append(np.frombuffer(data, kind, count, at))
        at += found[-1].nbytes
    check("zstd", arrays, found)
    return len(blob)


def mcap(recording: hapfmt.Recording) -> int:
    """As ROS 2 records a topic for each rate; the values are physical."""
    writer_module, stream = module("mcap.writer"), io.BytesIO()
    groups: dict[tuple[object, int, int], list[int]] = {}
    for place, channel in enumerate(recording.channels):
        key = channel.rate_exact, channel.start_tick, channel.stored.size
        groups.setdefault(key, []).append(place)
    tables = [
        np.stack([recording.channels[place].samples() for place in places], axis=1)
        for places in groups.values()
    ]
    writer = writer_module.Writer(stream)
    writer.start(profile="ros2")
    schema = writer.register_schema("lab/Samples", "ros2msg", SCHEMA)
    for number, ((rate, start, _), places) in enumerate(groups.items()):
        labels = json.dumps([recording.channels[place].label for place in places])
        topic = writer.register_channel(f"/touch{number}", "cdr", schema, {"labels": labels})
        for tick, row in enumerate(tables[number]):
            time_ns = int((start + tick) * 1_000_000_000 / rate)
            head = struct.pack("<iII", *divmod(time_ns, 1_000_000_000), row.size)
            writer.add_message(topic, time_ns, CDR + head + row.tobytes(), time_ns)
    writer.finish()
    found: list[list[Array]] = [[] for _ in tables]
    reader = module("mcap.reader").make_reader(io.BytesIO(stream.getvalue()))
    for _, topic, message in reader.iter_messages():
        found[int(topic.topic.removeprefix("/touch"))].append(
            np.frombuffer(message.data, np.float64, offset=len(CDR) + 12)
        )
    check("MCAP", tables, [np.stack(rows) for rows in found])
    return len(stream.getvalue())


def ours(recording: hapfmt.Recording, preset: str) -> int:
    name, _, bound = preset.partition(" ")
    settings = hapfmt.Settings.of(name, **({"max_error": bound} if bound else {}))
    stream = io.BytesIO()
    hapfmt.write(recording, stream, settings)
    back = hapfmt.read(stream.getvalue())
    given = [channel.samples() for channel in recording.channels]
    found = [channel.samples() for channel in back.channels]
    if name == "lossless":
        check(preset, given, found)
    for channel, x, y in zip(recording.channels, given, found, strict=True):
        if bound and x.size:
            most = float(bound.rstrip("%")) / 100 * float(np.ptp(x))
            if float(np.abs(x - y).max()) > most * (1 + 1e-9):
                raise WrongError(f"{preset}: {channel.label} leaves its error bound")
    return len(stream.getvalue())


PEERS: dict[str, tuple[tuple[str, ...], Callable[[hapfmt.Recording], int | None]]] = {
    "FLAC": (("soundfile",), flac),
    "HDF5 + gzip": (("h5py",), hdf5),
    "Parquet + zstd": (("pyarrow", "pyarrow.parquet"), parquet),
    "MAT v7": (("scipy.io",), mat),
    "zstd": (("zstandard",), zstandard),
    "MCAP + zstd": (("mcap", "zstandard"), mcap),
}


class Row(NamedTuple):
    """Sizes in bytes, None where the recording does not fit."""

    name: str
    channels: int
    float64: int
    sizes: dict[str, int | None]


def measure(name: str, recording: hapfmt.Recording) -> Row:
    sizes: dict[str, int | None] = {}
    for coder, (packages, size_of) in PEERS.items():
        if has(*packages):
            sizes[coder] = size_of(recording)
    for preset in OURS:
        sizes[preset] = ours(recording, preset)
    return Row(name, len(recording), 8 * recording.sample_count, sizes)


def scenes(seconds: float) -> Iterator[tuple[str, hapfmt.Recording]]:
    for name in SCENES:
        yield name, simulate(load_scene(name).changed(seconds=seconds))[0]


def by_folder(rows: Sequence[Row]) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(str(Path(row.name).parent) if "/" in row.name else row.name, []).append(
            row
        )
    return groups


def line(name: str, rows: Sequence[Row], coders: Sequence[str]) -> list[str]:
    """Geometric means; - where one of the recordings does not fit."""
    cells = []
    for coder in coders:
        sizes = [row.sizes.get(coder) for row in rows]
        ratios = [row.float64 / size for row, size in zip(rows, sizes, strict=True) if size]
        cells.append(f"{mean(ratios):.1f}" if len(ratios) == len(rows) else "-")
    counts = sorted({row.channels for row in rows})
    channels = f"{counts[0]}-{counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return [name, channels, *cells]


def lines_of(rows: Sequence[Row], coders: Sequence[str]) -> list[list[str]]:
    """One line a folder or scene, and one of all recordings that were not simulated."""
    lines = []
    for name, members in by_folder(rows).items():
        several = f" ({len(members)})" if len(members) > 1 else ""
        lines.append(line(f"{name}{several}", members, coders))
    recorded = [row for row in rows if row.name not in SCENES]
    if len(recorded) > 1:
        lines.append(line(f"{len(recorded)} recordings", recorded, coders))
    return lines


@click.command(help=__doc__)
@click.argument(
    "data", default=DATA if DATA.exists() else None, required=False,
    type=click.Path(exists=True, path_type=Path),
)  # fmt: skip
@click.option("--seconds", default=SECONDS, help="Length of the simulated scenes.")
@click.option("--only", default="", help="Recordings whose name contains this.")
@click.option("--write", "to_readme", is_flag=True, help="Put the table into README.md.")
def main(data: Path | None, seconds: float, only: str, to_readme: bool) -> None:
    on, rows = origin(), []
    for name, recording in chain(scenes(seconds), load_all(data, only, None) if data else ()):
        if only not in name or not recording.sample_count:
            continue
        if not all(isfinite(x.sum()) for x in (c.samples() for c in recording.channels)):
            click.echo(f"left out: {name} has values that are not finite", err=True)
            continue
        click.echo(f"{name} ...", err=True)
        rows.append(measure(name, recording))
    if not rows:
        click.echo("No recording could be measured.", err=True)
        sys.exit(1)
    coders = list(dict.fromkeys(coder for row in rows for coder in row.sizes))
    lines = lines_of(rows, coders)
    print(f"How many times smaller than float64 a whole file is; scenes of {seconds:g} s.\n")
    print_table(["recording", "channels", *coders], lines)
    for coder, recipe in RECIPES.items():
        print(f"* {coder}: {recipe}")
    print("\nBelow 1 a file is larger than float64. Every lossless file was decoded and compared")
    print("bit for bit; near-lossless keeps its bound in every sample.")
    print(f"{on}; {', '.join(f'{name} {version}' for name, version in versions().items())}.")
    if missing := left_out():
        print(f"Not installed: {', '.join(missing)}.")
    if to_readme:
        shown = [x for x in lines if x[0] in SCENES or x[0].endswith(" recordings")]
        write_rows("sizes", shown)


if __name__ == "__main__":
    main()
