"""Wrong recoverers and encoders (docs/spec/recovery.md, clauses 11 and 15)."""

from __future__ import annotations

from .mutant import Edit, Mutant, mutant

WRITER = "writing.filewriter:FileWriter"
COPY = "edit.recover:Copy"
WITHIN = "encoder.bounded:encode_bounded"
FILLED = """import numpy as np
    values, parts, at = read_numbers(folder / one["numbers"], one["format"]), [], 0
    for span in spans:
        gap = span.start - (spans[0].start + sum(map(len, parts)))
        parts += [np.zeros(gap, values.dtype), values[at : at + span.ticks]]
        at += span.ticks
    spans, parts = [Span(spans[0].start, spans[-1].stop)] if spans else [], parts or [values]
    return Channel("""


def recoverer(name: str, about: str, requirements: str, *changes: Edit) -> Mutant:
    return mutant(name, about, requirements, *changes, role="recoverer")


def encoder(name: str, about: str, requirements: str, *changes: Edit) -> Mutant:
    return mutant(name, about, requirements, *changes, role="encoder")


MUTANTS = (
    recoverer(
        "recover-drops-events",
        "Packets of events are not copied.",
        "REC-006",
        Edit(
            f"{COPY}.check",
            "decoder = self.decoders.get(packet.track)",
            'if self.tracks[packet.track].kind == "events":\n'
            "        return False\n"
            "    decoder = self.decoders.get(packet.track)",
        ),
    ),
    recoverer(
        "recover-keeps-bad-packets",
        "Packets that do not decode are copied too.",
        "REC-006",
        Edit(f"{COPY}.check", "if decoder is not None:", "if False:"),
    ),
    recoverer(
        "recover-keeps-digests",
        "Digests are copied, whatever was lost of their tracks.",
        "REC-010",
        Edit(f"{COPY}.copy_digests", "if same and track not in self.outrun:", "if True:"),
    ),
    recoverer(
        "recover-without-places",
        "Nothing is described for tracks whose description is lost.",
        "REC-007 TRK-010 TRK-012",
        Edit(
            "edit.recover:describe",
            "places = placeholders({track.id: track for track in kept}, catalogue)",
            "places: list[Track] = []",
        ),
        Edit(f"{WRITER}.close", "self.describe(silent_tracks(list(self.tracks.values())))", "pass"),
    ),
    recoverer(
        "recover-drops-unknown",
        "Chunks of unknown types are left out.",
        "REC-010",
        Edit(
            "edit.recover:Extras.may_be_copied",
            "return chunk.header.critical or safe or whole",
            "return False",
        ),
    ),
    recoverer(
        "recover-keeps-unsafe",
        "Unknown chunks that are unsafe to copy are kept after loss.",
        "REC-010",
        Edit(
            "edit.recover:Extras.may_be_copied",
            "return chunk.header.critical or safe or whole",
            "return True",
        ),
    ),
    recoverer(
        "recover-drops-metadata",
        "Metadata is not copied.",
        "REC-010",
        Edit("edit.recover:Extras.copy", "if keep:", 'if keep and header.type != "mETa":'),
    ),
    recoverer(
        "recover-says-nothing",
        "The metadata of a recovered file does not say what happened.",
        "REC-010",
        Edit(f"{COPY}.run", "if done.findings or done.exit_code == DAMAGED:", "if False:"),
    ),
    recoverer(
        "recover-exit-0",
        "Recovery ends with 0 whatever was lost.",
        "VRD-001 REC-010",
        Edit(f"{COPY}.run", "done.exit_code = DAMAGED", "done.exit_code = 0"),
    ),
    recoverer(
        "recover-not-closed",
        "A recovered file has no index and no footer.",
        "FIL-003 REC-006",
        Edit(f"{COPY}.run", "self.writer.close()", "pass"),
    ),
    recoverer(
        "recover-loses-epoch",
        "The epoch is not kept.",
        "REC-007",
        Edit(f"{COPY}.__init__", "epoch_ns=head.epoch_ns", "epoch_ns=None"),
    ),
    encoder(
        "index-without-last-cluster",
        "The index leaves out the last DATA chunk.",
        "IDX-002",
        Edit(
            f"{WRITER}.index",
            "tuple(self.entries[first:])))\n    offset",
            "tuple(e for e in self.entries[first:] if e.type != 'DATA' or e is not "
            "[e for e in self.entries if e.type == 'DATA'][-1])))\n    offset",
        ),
    ),
    encoder(
        "index-times-short",
        "The index rounds the end of a cluster down.",
        "IDX-002",
        Edit(f"{WRITER}.data", "ceil_ms(stop)", "floor_ms(stop)"),
    ),
    encoder(
        "footer-distance-from-its-end",
        "The distance of the index counts from the end of the footer.",
        "FOT-002",
        Edit(
            f"{WRITER}.foot",
            "distance = self.offset - self.parts",
            "distance = self.offset + FOOT_SIZE - self.parts",
        ),
    ),
    encoder(
        "footer-rounds-down",
        "The footer rounds the duration down.",
        "FOT-002",
        Edit(
            "format.extras:ceil_ns",
            "-(-seconds.numerator * 10**9 // seconds.denominator)",
            "seconds.numerator * 10**9 // seconds.denominator",
        ),
    ),
    encoder(
        "packet-crc-without-row",
        "The CRC of a packet does not cover its row.",
        "DAT-004",
        Edit(
            "format.cluster:build_cluster",
            "packet_crc(seed, count, row, packet.data)",
            "crc32(packet.data, seed)",
        ),
    ),
    encoder(
        "packet-crc-without-file-id-written",
        "The CRC of a packet does not begin with the file id.",
        "DAT-004",
        Edit(
            "format.cluster:build_cluster",
            "packet_crc(seed, count, row, packet.data)",
            "packet_crc(0, count, row, packet.data)",
        ),
    ),
    encoder(
        "packet-crc-of-another-chunk",
        "The CRCs of all clusters are those of chunk 0.",
        "DAT-004 DAT-011",
        Edit(
            f"{WRITER}.data",
            "cluster_seed(self.file_id, self.sequence)",
            "cluster_seed(self.file_id, 0)",
        ),
    ),
    encoder(
        "overlong-varint-written",
        "Varints of one byte are written with two.",
        "CNV-002",
        Edit("numbers:build_varint", "out.append(value)\n", "out += bytes([value | 0x80, 0])\n"),
    ),
    encoder(
        "random-file-id",
        "The file id is random in canonical mode too.",
        "WRT-002",
        Edit(
            f"{WRITER}.__init__",
            "secrets.randbits(64) if file_id is None else file_id",
            "secrets.randbits(64)",
        ),
    ),
    encoder(
        "level-one-for-all",
        "Every file claims to keep the limits of level 1.",
        "LIM-001 HED-004",
        Edit("encoder.encode:choose_level", "for track in tracks:", "for track in ():"),
    ),
    encoder(
        "gaps-written-as-zeros",
        "Gaps of the source are stored as zeros.",
        "WRT-004 DBC-004",
        Edit("hapfmt_adapter.job:channel_of", "return Channel(", FILLED),
        Edit(
            "hapfmt_adapter.job:channel_of",
            'stored=read_numbers(folder / one["numbers"], one["format"])',
            "stored=np.concatenate(parts)",
        ),
    ),
    encoder(
        "residual-of-unquantised",
        "The residual is formed against the slow part before its quantisation.",
        "WRT-003 DBC-002",
        Edit(
            "encoder.unit:encode_paper",
            "unit = with_residual(source, lf, x - d, step, bound)",
            "unit = with_residual(source, lf, x - slow_part(source, settings), step, bound)",
        ),
    ),
    encoder(
        "deadband-one-too-wide",
        "A sample may lie one count further off than its deadband allows.",
        "DBC-002",
        Edit(
            WITHIN,
            "bound = bound_of(source, promise)",
            "asked = bound_of(source, promise)\n"
            "    floor = tuple(count + 1 for count in asked.band.floor)\n"
            "    band = replace(asked.band, floor=floor)\n"
            "    bound = replace(asked, band=band, slack=asked.slack + 1)",
        ),
        Edit(WITHIN, "contract_for(bound.band)", "contract_for(asked.band)"),
        Edit("encoder.unit:largest_errors", "if contract and contract.guaranteed:", "if False:"),
    ),
    encoder(
        "words-backwards",
        "The words of the entropy coder are stored in the order that it finds them.",
        "RNG-001",
        Edit("codecs.entropy:Encoder.finish", "for word in reversed(words)", "for word in words"),
    ),
    encoder(
        "coder-ends-late",
        "The coded bytes have a byte more than they need.",
        "RNG-001",
        Edit(
            "codecs.entropy:Encoder.finish",
            "return front + self._back()",
            'return front + b"\\0" + self._back()',
        ),
    ),
    encoder(
        "doubles-rounded",
        "Doubles are stored as counts, without what these lack of them.",
        "DBC-004 EXA-007",
        Edit("codecs.exact:Lacking.build", "if not self.corrections.any():", "if True:"),
    ),
)
