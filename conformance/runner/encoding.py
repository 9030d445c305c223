"""The verb encode: the checks of conformance/README.md, by referees and by the bytes."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .chunks import chunks, index_faults
from .compare import Difference, spans_are_canonical
from .jobs import Job, description_differences, read_job, read_raw, sample_differences
from .manifest import Case
from .process import Implementation, Outcome
from .running import SKIPPED, Step, clean, ended, read_json, step

UNSUPPORTED = 4
CUTS = 64
"""Random places at which a file is cut, in addition to every edge of a chunk."""
SEED = 1


def check_encode(
    case: Case, tested: Implementation, referees: Sequence[Implementation], folder: Path
) -> list[Step]:
    target = folder / "encoded.hapf"
    wanted = case.expect["exit"]["encode"]
    outcome = tested.call("encode", case.job, target)
    if outcome.code == UNSUPPORTED and not outcome.why and wanted == 0:
        return [Step("encode", SKIPPED, reason="an encoder that does this job")]
    differences = ended(outcome, wanted)
    if not differences and outcome.code == 0 and not target.exists():
        differences = [Difference("encode", "a file", "none")]
    steps = [step("encode", differences, tested, outcome, "encode", case.job, "OUT.hapf")]
    if differences or outcome.code != 0:
        return steps
    job, data = read_job(case.job), target.read_bytes()
    steps.append(check_index(data))
    if steps[-1].differences:
        return steps
    if "file_id" in job.told:
        steps += [check_identity(job, data), check_stable(case, tested, folder, data)]
    judged = False
    for number, referee in enumerate(referees):
        room = folder / str(number)
        clean(room / "decoded")
        found = judge(case, job, referee, target, room)
        if found and not judged:
            found.append(check_truncation(referee, data, room))
        judged = judged or bool(found)
        steps += found
    if not referees:
        steps.append(Step("encode, by a referee", SKIPPED, reason="a referee"))
    elif not judged:
        missing = Difference("referees", "one that reads the file", "none")
        steps.append(Step("encode, by a referee", differences=[missing]))
    return steps


def judge(case: Case, job: Job, referee: Implementation, target: Path, room: Path) -> list[Step]:
    """Strict verification, what it decodes to, and the contract; nothing where the referee cannot
    read the file."""
    if not (referee.has("decode") and referee.has("verify")):
        return []
    outcome = referee.call("decode", target, room / "decoded")
    if outcome.code == UNSUPPORTED:
        return []
    differences = ended(outcome, 0)
    if not differences:
        differences = decoded_differences(job, room / "decoded")
    kind = "decodes-to-input" if job.lossless else "bounded-error"
    steps = [named(kind, referee, differences, outcome, "decode", target, "OUT")]
    outcome = referee.call("verify", target, room / "report.json", "--original", case.job)
    differences = ended(outcome, 0)
    report, problems = read_json(room / "report.json")
    for row in [*report.get("findings", []), *report.get("damages", [])]:
        told = f"{row.get('requirement')}: {row.get('message')}"
        problems.append(Difference("verify", "nothing to complain about", told))
    for row in report.get("contracts", []):
        if row.get("outside"):
            found = f"{row['outside']} of {row}"
            problems.append(Difference("contract", "no sample outside", found))
    steps.append(
        named("strict-verify", referee, differences + problems, outcome,
              "verify", target, "OUT.json", "--original", case.job)
    )  # fmt: skip
    return steps


def named(
    check: str, referee: Implementation, differences: Sequence[Difference], outcome: Outcome,
    *arguments: object,
) -> Step:  # fmt: skip
    return step(f"encode, {check} by {referee.name}", differences, referee, outcome, *arguments)


def decoded_differences(job: Job, folder: Path) -> list[Difference]:
    decoded, differences = read_json(folder / "decode.json")
    if differences:
        return differences
    try:
        differences = list(description_differences(job, decoded))
        if not differences:
            differences = list(sample_differences(job, decoded, folder))
    except (KeyError, TypeError, ValueError, OSError) as error:
        what = f"what lacks something: {type(error).__name__} {error}"
        differences.append(Difference("decode.json", "the members of README.md", what))
    return differences


def check_index(data: bytes) -> Step:
    faults = [Difference("index", "every chunk, in order", fault) for fault in index_faults(data)]
    return Step("encode, index-complete", differences=faults)


def check_identity(job: Job, data: bytes) -> Step:
    """The file id that canonical mode was given."""
    wanted, found = job.told["file_id"], f"0x{chunks(data)[0].file_id:016x}"
    differences = [Difference("file id", wanted, found)] if wanted != found else []
    return Step("encode, file id", differences=differences)


def check_stable(case: Case, tested: Implementation, folder: Path, data: bytes) -> Step:
    """WRT-002."""
    again = folder / "again.hapf"
    outcome = tested.call("encode", case.job, again)
    differences = ended(outcome, 0)
    if not differences and again.read_bytes() != data:
        other = again.read_bytes()
        pairs = enumerate(zip(data, other, strict=False))
        first = next((i for i, (a, b) in pairs if a != b), min(len(data), len(other)))
        differences = [Difference("a second run", "the same bytes", f"others from {first} on")]
    return step("encode, reencode-stable", differences, tested, outcome, "encode", case.job, "OUT")


def check_truncation(referee: Implementation, data: bytes, room: Path) -> Step:
    """Cut at every edge of a chunk and at random places: what stood in whole chunks is delivered,
    nothing else than what was encoded, and the loss is reported."""
    edges = [chunk.offset for chunk in chunks(data)]
    seeded = random.Random(SEED)
    places = sorted({*edges, *(seeded.randrange(1, len(data)) for _ in range(CUTS))})
    differences: list[Difference] = []
    whole = samples(room / "decoded")
    before: dict[Any, int] = {}
    for place in places:
        path, folder = room / "cut.hapf", room / "cut"
        path.write_bytes(data[:place])
        clean(folder)
        outcome = referee.call("decode", path, folder)
        nothing = len(edges) > 1 and place < edges[1]
        found = ended(outcome, [2, 3] if nothing else 3)
        if not found and outcome.code == 3:
            delivered = samples(folder)
            found = list(cut_differences(delivered, before, whole))
            if place in edges:
                before = delivered
            if place == edges[-1] and delivered != whole and not found:
                found = [Difference("what is delivered", "all", "less")]
        if found:
            where = f"cut at {place}: {found[0].where}"
            differences.append(Difference(where, found[0].wanted, found[0].found))
    return Step(f"encode, truncation-safe by {referee.name}", differences=differences)


def samples(folder: Path) -> dict[tuple[int, int], int]:
    """Numbers by channel and tick; nothing where there is no decode.json."""
    decoded, problems = read_json(folder / "decode.json")
    out: dict[tuple[int, int], int] = {}
    for channel in [] if problems else decoded.get("channels", []):
        numbers = iter(read_raw(folder / Path(channel["numbers"]).name, signed=False))
        for start, stop in channel["spans"] if spans_are_canonical(channel["spans"]) else []:
            for tick in range(start, stop):
                out[channel["channel"], tick] = next(numbers)
    return out


def cut_differences(
    found: dict[Any, int], before: dict[Any, int], whole: dict[Any, int]
) -> Iterator[Difference]:
    for place, number in before.items():
        if place not in found:
            yield Difference(f"channel {place[0]} tick {place[1]}", str(number), "a gap")
            return
    for place, number in found.items():
        if whole.get(place) != number:
            wanted = str(whole.get(place, "a gap"))
            yield Difference(f"channel {place[0]} tick {place[1]}", wanted, str(number))
            return
