"""Codecs: size against error, and time against error, of every preset, setting and peer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from statistics import median
from typing import Any

from peers.packages import left_out
from results import mean
from simulated import drift

from report.codec_figures import pictures
from report.section import CannotRunError, Options, Section, Table
from report.subjects import LISTED, SAMPLES, Listed, prepared, subjects
from report.trials import (
    PEER_ERROR,
    PEER_K,
    REPEATS,
    SIMILAR_CHANNELS,
    SIMILAR_HZ,
    SIMILAR_S,
    Trial,
    trials,
)

TASKS = {
    "lossless": ("lossless", "without loss"),
    f"within {PEER_ERROR:.2%}": (
        "near-lossless",
        f"every sample within {PEER_ERROR:.1%} of the range",
    ),
    f"deadband k={PEER_K:g}": ("deadband", f"within a deadband of {PEER_K:.0%}"),
}
"""Promises that peers give too: our preset, and its words."""


def section(options: Options) -> Section:
    list(trials(next(prepared("", True, drift(0.5))), True, lambda _line: None))  # first calls
    found: list[Trial] = []
    listed: list[Listed] = []
    for subject in subjects(options, listed):
        found += trials(subject, options.quick, options.progress)
    if not found:
        raise CannotRunError("neither a scene nor a recording could be measured")
    good = [trial for trial in found if not trial.failed]
    duels = [duel for task in TASKS for duel in duels_of(good, task)]
    summary = summary_rows(good)
    return Section(
        "Codecs: size, error and time",
        text_of(found, duels, summary),
        [
            Table("Each setting over all recordings and scenes", SUMMARY, summary),
            *([Table("Best peer under the same promise", DUEL, duels)] if duels else []),
            Table("What was measured, and what was skipped", LISTED, listed),
            Table("Every measurement", HEADERS, rows_of(found)),
        ],
        pictures(good),
        [{**trial._asdict(), "encode": trial.encode and trial.encode._asdict(),
          "decode": trial.decode and trial.decode._asdict()} for trial in found],
    )  # fmt: skip


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Places of the points that no other beats in one and equals in the other, least first."""
    best: list[int] = []
    for place in sorted(range(len(points)), key=lambda i: points[i]):
        if not best or points[place][1] < points[best[-1]][1]:
            best.append(place)
    return best


def fronts(found: Sequence[Trial]) -> dict[int, tuple[bool, bool]]:
    """By id of a trial: is it on the front of error against size, and of error against the time of
    encoding and decoding, among all trials of its recording?"""
    marks: dict[int, tuple[bool, bool]] = {}
    for name in {trial.subject for trial in found}:
        members = [trial for trial in found if trial.subject == name and not trial.failed]
        sizes = {id(members[i]) for i in front([(t.coded_bits, t.rms_percent) for t in members])}
        times = {
            id(members[i])
            for i in front([(t.encode.median + t.decode.median, t.rms_percent) for t in members])
        }
        marks |= {id(trial): (id(trial) in sizes, id(trial) in times) for trial in members}
    return marks


SUMMARY = ["setting", "promise", "recordings", "size relative to lossless",
           "rms error, % of range: median", "largest error, % of range: largest",
           "SNR of texture, dB: median", "SNR of texture, dB: least",
           "encode µs/sample", "decode µs/sample", "smallest at its error",
           "fastest at its error"]  # fmt: skip


def summary_rows(found: Sequence[Trial]) -> list[list[Any]]:
    """One line for each setting. Sizes and times are geometric means over the recordings, errors
    the median over recordings of the median of channels, or the largest of all."""
    lossless = {t.subject: t for t in found if t.label == "lossless"}
    marks = fronts(found)
    rows = []
    for label, task in dict.fromkeys((trial.label, trial.task) for trial in found):
        members = [trial for trial in found if (trial.label, trial.task) == (label, task)]
        sizes = [
            t.coded_bits / lossless[t.subject].coded_bits
            for t in members
            if t.subject in lossless and t.coded_bits and lossless[t.subject].coded_bits
        ]
        snr = [t.snr_hf_db for t in members if t.snr_hf_db is not None]
        rows.append(
            [label, task or "none", len(members), mean(sizes) if sizes else None,
             median(t.rms_percent for t in members), max(t.largest_percent for t in members),
             *(decibels(of(snr)) if snr else None for of in (median, min)),
             gathered(members, lambda t: t.microseconds(t.encode)),
             gathered(members, lambda t: t.microseconds(t.decode)),
             sum(marks[id(t)][0] for t in members), sum(marks[id(t)][1] for t in members)]
        )  # fmt: skip
    return rows


def decibels(value: float) -> float | str:
    return value if isfinite(value) else "exact"


def gathered(members: Sequence[Trial], value: Callable[[Trial], float | None]) -> float | None:
    known = [each for t in members if (each := value(t))]
    return mean(known) if known else None


DUEL = ["recording", "promise", "ours", "b/s", "best peer", "its b/s", "ratio of sizes",
        "ratio of encode times", "ratio of decode times"]  # fmt: skip


def duels_of(found: Sequence[Trial], task: str) -> list[list[Any]]:
    """Ours and the smallest peer that kept the same promise, one line for each recording."""
    family, _ = TASKS[task]
    rows = []
    for ours in found:
        if (ours.task, ours.family) != (task, family) or ours.label.endswith("fast"):
            continue
        peers = [
            t for t in found
            if (t.subject, t.task, t.ours, t.outside) == (ours.subject, task, False, 0)
        ]  # fmt: skip
        if not peers:
            continue
        best = min(peers, key=lambda t: t.coded_bits)
        ratios = [
            a / b if b else None
            for a, b in (
                (ours.coded_bits, best.coded_bits),
                (ours.encode.median, best.encode.median),
                (ours.decode.median, best.decode.median),
            )
        ]
        rows.append([ours.subject, task, ours.label, ours.coded_bits, best.setting,
                     best.coded_bits, *ratios])  # fmt: skip
    return rows


def text_of(
    found: Sequence[Trial], duels: Sequence[Sequence[Any]], summary: Sequence[Sequence[Any]]
) -> str:
    """Findings, from the rows."""
    told = []
    for task, (family, words) in TASKS.items():
        ratios = [row[6] for row in duels if row[1] == task and row[6]]
        if ratios:
            won = sum(ratio < 1 for ratio in ratios)
            told.append(
                f"{words} `{family}` takes {mean(ratios):.2f} times the bits of the best peer "
                f"(smaller on {won} of {len(ratios)})"
            )
    many = len({trial.subject for trial in found})
    bits = median(t.coded_bits for t in found if t.label == "lossless" and not t.failed)
    first = (
        f"{told[0][0].upper()}{'; '.join(told)[1:]}. Geometric means over {many} recordings and "
        "scenes, each against the smallest peer that keeps the same promise on it; a ratio below 1 "
        "is in our favour."
        if told
        else f"No peer is installed; `lossless` takes {bits:.2g} bits per sample at the median of "
        f"{many} recordings and scenes."
    )
    ours = [row for row in summary if not row[0].startswith("peer")]
    lossless = next(row for row in ours if row[0] == "lossless")
    fast = next((row for row in ours if row[0] == "lossless fast"), None)
    quick = (
        f"; `lossless --fast` takes {fast[8] / lossless[8]:.2f} and {fast[9] / lossless[9]:.2f} "
        f"times that, for {fast[3] - 1:+.1%} of size"
        if fast
        else ""
    )
    lines = [
        first,
        f"* **Time.** `lossless` takes {lossless[8]:.2g} µs per sample to encode and "
        f"{lossless[9]:.2g} to decode{quick}.{slower(duels)}",
        "* **Pareto front.** "
        + ", ".join(
            f"`{row[0]}` ({row[10]})" for row in sorted(ours, key=lambda r: -r[10])[:6] if row[10]
        )
        + f" are most often the smallest at their error (of {many} recordings and scenes). Fastest "
        "at their error: "
        + ", ".join(
            f"{row[0]}{f' ({row[1]})' if row[1] != 'none' else ''}, {row[11]}"
            for row in sorted(summary, key=lambda r: -r[11])[:4]
            if row[11]
        )
        + ".",
        f"* **Promises.** {broken(found)}",
        f"* **Peers.** {absent(found)}",
        "Errors are shares of each channel's range, so that newtons and degrees can be compared. "
        "Those of a recording are the median of its channels, or the largest of them; a median of "
        "0 says that more than half are lossless. Where no unit says that a channel is felt, "
        "`perceptual` treats all as felt; recordings without any texture are left out of it. "
        "Bits count packets with all their tables; for a peer, its blobs and 4 bytes a channel. "
        "All coders get the same integers where a recording holds sensor counts. At most "
        f"{SAMPLES} samples of a recording are measured, from its middle, with {REPEATS} runs for "
        "each time; the table lists every recording and what was skipped. ST-SIM is computed for "
        f"the first {SIMILAR_CHANNELS} channels of at least {SIMILAR_HZ} Hz, over their first "
        f"{SIMILAR_S} s. `tools/bench.py` measures whole recordings and every k.",
    ]
    return "\n\n".join([lines[0], "\n".join(lines[1:5]), lines[5]])


def slower(duels: Sequence[Sequence[Any]]) -> str:
    """How much faster the best peer is."""
    pairs = [(row[7], row[8]) for row in duels if row[7] and row[8]]
    if not pairs:
        return ""
    encode, decode = (mean(list(column)) for column in zip(*pairs, strict=True))
    return (
        f" It encodes in {encode:.1f} and decodes in {decode:.1f} times the time of the smallest "
        "peer. Our times include writing and reading a whole file; the peer's do not."
    )


def broken(found: Sequence[Trial]) -> str:
    """Settings that broke their promise."""
    bound = [trial for trial in found if trial.outside is not None]
    ours = [trial for trial in bound if trial.ours]
    bad = [trial for trial in bound if trial.outside]
    if not bad:
        return f"All {len(bound)} measurements with a promise kept it in every sample."
    names = "; ".join(
        f"{t.label} on {t.subject}: {t.outside} of {t.samples} samples outside" for t in bad[:6]
    )
    kept = len(ours) - sum(t.ours for t in bad)
    return f"Ours kept it in every sample in {kept} of {len(ours)} measurements. Broken: {names}."


def absent(found: Sequence[Trial]) -> str:
    """Peers that are not installed, and settings that failed, by name."""
    here = sorted({trial.setting for trial in found if not trial.ours})
    missing = left_out()
    text = f"{len(here)} recipes were measured." if here else "None is installed."
    if missing:
        text += f" Not installed: {', '.join(missing)} (`pip install {' '.join(missing)}`)."
    if failed := [trial for trial in found if trial.failed]:
        text += " Failed: " + "; ".join(
            f"{t.label} on {t.subject}: {t.failed[:120]}" for t in failed[:6]
        )
        text += f" and {len(failed) - 6} more." if len(failed) > 6 else "."
    return text


HEADERS = ["recording", "setting", "promise", "channels", "samples", "b/s", "file b/s",
           "rms %: median", "largest %: largest", "SNR of texture, dB: median",
           "band energy, dB: median", "ST-SIM: median", "outside",
           "encode µs/sample", "from", "to", "decode µs/sample", "from", "to", "runs",
           "size front", "time front", "failed"]  # fmt: skip


def rows_of(found: Sequence[Trial]) -> list[list[Any]]:
    """One line for each measurement; times with their quartiles."""
    marks = fronts(found)
    rows = []
    for t in found:
        times: list[float | None] = []
        for each in (t.encode, t.decode):
            times += (
                [1e6 * s / t.samples for s in (each.median, each.low, each.high)]
                if each
                else [None] * 3
            )
        snr = None if t.snr_hf_db in (float("inf"), float("-inf")) else t.snr_hf_db
        rows.append(
            [t.subject, t.label, t.task, t.channels, t.samples, t.coded_bits, t.file_bits,
             t.rms_percent, t.largest_percent, snr, t.band_db, t.st_sim, t.outside, *times,
             t.encode.runs if t.encode else None, *marks.get(id(t), (None, None)), t.failed]
        )  # fmt: skip
    return rows
