"""Small files: packets are cut so that a damaged byte takes few samples."""

from __future__ import annotations

import io

import numpy as np
import pytest

import hapfmt
from hapfmt.codecs.exact import FOUR_STATES, RECALL, split_packet
from hapfmt.encoder.encode import encode
from hapfmt.encoder.lengths import LARGE_PRICE, PRICE, SHARES
from hapfmt.recording import Calibration, Channel, Recording

RATE = 1000


def noise(seed, size=20_000, width=900):
    return np.random.default_rng(seed).integers(-width, width + 1, size).astype(np.int32)


def held(recording, **options):
    out = io.BytesIO()
    hapfmt.write(recording, out, canonical=1, **options)
    back = hapfmt.read(out.getvalue())
    if options.get("preset", "lossless") == "lossless":
        for x, y in zip(recording.channels, back.channels, strict=True):
            assert x.samples().tobytes() == y.samples().tobytes()
    assert hapfmt.verify(out.getvalue(), against=recording).verdict == "intact"
    return out.getvalue()


def counts(columns):
    return Recording(
        tuple(
            Channel(x, RATE, calibration=Calibration(), label=f"c{i}")
            for i, x in enumerate(columns)
        )
    )


def doubles(columns):
    return Recording(
        tuple(Channel(np.asarray(x, float), RATE, label=f"c{i}") for i, x in enumerate(columns))
    )


def whole(recording):
    """Bytes with packets as long as clusters are."""
    return len(held(recording, cluster=120))


@pytest.mark.parametrize(
    ("recording", "price"),
    [
        (counts([noise(1), noise(2)]), PRICE),
        (
            doubles([np.random.default_rng(seed).normal(size=20_000) for seed in (3, 4)]),
            LARGE_PRICE,
        ),
    ],
    ids=["counts", "doubles"],
)
def test_a_packet_holds_few_samples_where_that_is_cheap(recording, price):
    encoded = encode(recording)
    assert max(packet.span for packet in encoded.packets) * SHARES <= 5 * recording.sample_count
    # The index lists more clusters, where there are more.
    assert len(held(recording)) < (1 + price) * whole(recording) + 100


def test_what_would_cost_too_much_stays_whole():
    slow = np.rint(300 * np.sin(np.arange(3000) / 90)).astype(np.int32)
    recording = counts([slow])
    assert len(encode(recording).packets) == 1
    assert len(held(recording)) < (1 + PRICE) * whole(recording) + 20


def test_tracks_of_several_channels():
    base = np.cumsum(noise(5, 60_000, 300))
    recording = counts([base + noise(seed, 60_000, 30) for seed in (6, 7, 8)])
    encoded = encode(recording)
    assert [len(track.components) for track in encoded.tracks] == [3]
    assert len(encoded.packets) > 1
    held(recording)


def test_linear_doubles_start_anew_in_each_part():
    x = np.random.default_rng(9).normal(size=20_000)
    y = np.zeros(x.size)
    for t in range(1, x.size):
        y[t] = 0.7 * y[t - 1] + 0.3 * x[t]
    recording = doubles([x, y, -2.5 * x])
    encoded = encode(recording)
    assert [track.codec for track in encoded.tracks] == ["LPCX"]
    assert len(encoded.packets) > 3
    size = sum(len(packet.data) for packet in encoded.packets)
    assert abs(sum(decision.size for decision in encoded.decisions) - size) < size / 400
    held(recording)


@pytest.mark.filterwarnings("ignore:no channel is known to be felt")
@pytest.mark.parametrize("preset", ["near-lossless", "perceptual"])
def test_presets_with_loss_keep_their_bound(preset):
    held(counts([noise(1), noise(2)]), preset=preset)


def test_given_clusters_are_left_alone():
    assert len(encode(counts([noise(1)]), hapfmt.Settings(cluster=20)).packets) == 1


def test_one_changed_byte_takes_little():
    recording = doubles([np.random.default_rng(seed).normal(size=10_000) for seed in range(4)])
    data = held(recording)
    rng = np.random.default_rng(2)
    lost = []
    for at in rng.integers(len(data) // 10, len(data) - len(data) // 10, 20).tolist():
        broken = bytearray(data)
        broken[at] ^= 0x55
        with hapfmt.Reader(bytes(broken)) as reader:
            read = reader.read()
        lost.append(1 - sum(c.stored.size for c in read.channels) / recording.sample_count)
    assert 0 < max(lost) <= 1 / 32
    assert np.mean(lost) < 0.03


def test_parts_recall_corrections_as_the_whole_does():
    columns = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        # Each count has a double of its own, a few steps beside that of the rule.
        table = (np.arange(1, 501) / 10).view(np.int64) + rng.integers(-9, 10, 500)
        columns.append(table[rng.integers(0, 500, 20_000)].view(np.float64))
    encoded = encode(doubles(columns))
    assert [track.codec for track in encoded.tracks] == ["LPCX"] * 4
    assert len(encoded.packets) > 4
    flags = {split_packet(packet.data, 0)[1][0] for packet in encoded.packets}
    assert flags == {RECALL | FOUR_STATES}
