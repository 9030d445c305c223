"""Wrong readers of damaged files: checksums, the walk, salvage, what was lost, verdicts (SPEC
clauses 5, 14 and 13)."""

from __future__ import annotations

from .mutant import Edit, mutant

HEADER = "format.walk:header_at"
FIND = "format.walk:find_header"
WALK = "format.walk:walk"
LEARN = "reading.catalogue:Catalogue.learn"
RUN = "format.cluster:salvage_cluster"
EXIT = "errors:verdict_of"
PAYLOAD_HOLDS = "crc32(payload, header.seed) == header.payload_crc"
IDENTIFY = "format.walk:identify"
STRANGERS = "format.walk:Strangers.within"

MUTANTS = (
    mutant(
        "header-crc-ignored",
        "The CRC of a chunk header is not looked at.",
        "CHK-002 REC-001",
        Edit(HEADER, " or data[CRC_OFFSET:] != crc", ""),
        Edit(
            "format.wire:parse_header",
            "if raw.header_crc != crc32(data[:CRC_OFFSET]):",
            "if False:",
        ),
    ),
    mutant(
        "payload-crc-ignored",
        "The CRC of a payload is not looked at.",
        "CHK-003 REC-001",
        Edit("format.walk:holds", f" and {PAYLOAD_HOLDS}", ""),
    ),
    mutant(
        "packet-crc-ignored",
        "The CRC of a packet is not looked at.",
        "DAT-004 REC-001",
        Edit(
            "format.cluster:Salvage.holds",
            "return packet_crc(self.seed, self.head.packet_count, row, data) == row.crc",
            "return True",
        ),
        Edit(
            "format.cluster:parse_cluster",
            "if packet_crc(seed, head.packet_count, row, data) != row.crc:",
            "if False:",
        ),
    ),
    mutant(
        "exact-values-broken-leave-counts",
        "Of a packet whose exact values break a rule the counts are delivered.",
        "EXA-006",
        Edit(
            "reading.decoder:PieceDecoder.decode",
            "doubles = decoder.decode_exact(packet, numbers) if self.exact else None",
            "doubles = None",
        ),
    ),
    mutant(
        "taken-channel-kept",
        "In a damaged file two tracks may have the same channel number.",
        "TRK-010",
        Edit(
            "format.track:TrackTable.place",
            "elif not numbers.isdisjoint(track.channels):",
            "elif False:",
        ),
    ),
    mutant(
        "file-id-ignored",
        "Headers with the file id of another file are taken for chunks of this one.",
        "CHK-004 REC-002",
        Edit(
            HEADER,
            "return header if file_id is None or header.file_id == file_id else None",
            "return header",
        ),
    ),
    mutant(
        "packet-crc-without-file-id",
        "The CRC of a packet is a plain CRC-32: packets of other files pass.",
        "DAT-004 CHK-004",
        Edit("format.wire:cluster_seed", ", seed_of(file_id))", ")"),
    ),
    mutant(
        "packet-crc-without-sequence",
        "The CRC of a packet leaves out the number of its chunk: packets of other chunks pass.",
        "DAT-004",
        Edit(
            "format.wire:cluster_seed",
            'crc32(sequence.to_bytes(8, "little"), seed_of(file_id))',
            "seed_of(file_id)",
        ),
    ),
    mutant(
        "packet-crc-without-count",
        "The CRC of a packet leaves out how many packets there are.",
        "DAT-004",
        Edit("format.cluster:packet_crc", "FIELDS.pack(count, ", "FIELDS.pack(0, "),
    ),
    mutant(
        "table-crc-ignored",
        "The CRC of a table is not looked at.",
        "DAT-011",
        Edit(
            "format.cluster:parse_table",
            "if crc32(part[: head.rows_stop], seed) != stored:",
            "if False:",
        ),
    ),
    mutant(
        "least-values-ignored",
        "The fields of a row are taken without their least values.",
        "DAT-004",
        Edit(
            "format.cluster:parse_rows",
            "track, size, start, span = head.least",
            "track = size = start = span = 0",
        ),
    ),
    mutant(
        "payload-crc-without-file-id",
        "The CRC of a payload is a plain CRC-32.",
        "CHK-003",
        Edit("format.walk:holds", "crc32(payload, header.seed)", "crc32(payload)"),
    ),
    mutant(
        "file-id-of-first-header",
        "The file id is that of the first header, whatever follows.",
        "REC-013",
        Edit(IDENTIFY, "max(chosen, key=votes.__getitem__, default=None)", "next(iter(votes))"),
    ),
    mutant(
        "file-id-by-number-of-chunks",
        "Each chunk has one vote for the file id, however long it is.",
        "REC-013",
        Edit(
            IDENTIFY,
            "held = HEADER_SIZE + header.payload_size if chunk.intact else 0",
            "held = int(chunk.intact)",
        ),
        Edit(IDENTIFY, "held = held_size(chunk.payload, header.cluster_seed)", "held = 0"),
    ),
    mutant(
        "file-id-by-bytes-alone",
        "Most bytes choose the file id, whatever HEAD and the footer say.",
        "REC-013",
        Edit(IDENTIFY, "if first and last and begun", "if False and first and last"),
    ),
    mutant(
        "file-id-without-description",
        "A file id of which no track is described may be chosen.",
        "REC-013",
        Edit(IDENTIFY, " if file_id in described", ""),
    ),
    mutant(
        "left-out-lost-whole",
        "A packet that is left out has lost the ticks of other packets too.",
        "REC-012",
        Edit(
            "reading.packets:PacketPass.packets",
            "self.lines[track][0].uncovered(low, high or low)",
            "[(low, high or low)]",
        ),
    ),
    mutant(
        "file-id-from-within",
        "Chunks within a damaged payload always choose the file id too.",
        "REC-013",
        Edit(IDENTIFY, " or follows(source, header, stop)", ""),
    ),
    mutant(
        "other-files-not-told",
        "The ids of other files are not reported.",
        "REC-013",
        Edit(STRANGERS, "if header.file_id not in self.known:", "if False:"),
    ),
    mutant(
        "resync-skips-edges",
        "A sync word across the edge of a block of 4096 bytes is not seen.",
        "REC-002",
        Edit(
            FIND,
            "position, size = start, FIRST_BLOCK",
            "position, size = start, 4096 - start % 4096",
        ),
        Edit(FIND, "size + len(SYNC) - 1", "size"),
        Edit(FIND, "size = min(2 * size, BLOCK_SIZE)", "size = 4096"),
    ),
    mutant(
        "resync-behind-payload",
        "After a damaged payload the search begins behind it, not within.",
        "REC-002 REC-003",
        Edit(
            WALK, "start = position if suspect_from is None else suspect_from", "start = position"
        ),
    ),
    mutant(
        "resync-by-words",
        "The search for headers looks at every fourth offset.",
        "REC-002",
        Edit(
            FIND,
            "if header_at(source, position + at, file_id) is not None:",
            "if (position + at - start) % 4 == 0 and header_at(source, position + at, file_id):",
        ),
    ),
    mutant(
        "nested-chunks-taken",
        "Headers within the payload of an intact chunk are taken for chunks.",
        "FIL-002 REC-002",
        Edit(
            WALK,
            "position = min(payload_offset + header.payload_size, source.size)",
            "after = payload_offset + header.payload_size\n"
            "        nested = find_header(source, payload_offset, file_id) or source.size\n"
            "        position = min(after, nested, source.size)",
        ),
    ),
    mutant(
        "duplicates-used",
        "A chunk whose sequence number was met before is used again.",
        "CHK-005 REC-003",
        Edit(WALK, "if header.sequence in seen:", "if False:"),
    ),
    mutant(
        "duplicates-of-damaged",
        "The good copy of a chunk that was damaged is left out as a duplicate.",
        "REC-002",
        Edit(
            WALK,
            "findings.append(payload_finding(header, offset, position - offset, whole))",
            "seen.add(header.sequence) or "
            "findings.append(payload_finding(header, offset, position - offset, whole))",
        ),
    ),
    mutant(
        "holes-unreported",
        "Missing sequence numbers are not reported.",
        "CHK-005 REC-003",
        Edit(WALK, "if header.sequence != last + 1:", "if header.sequence <= last:"),
    ),
    mutant(
        "order-of-the-file",
        "Chunks that changed places are delivered in the order of the file.",
        "REC-002 DAT-006",
        Edit("reading.catalogue:Catalogue.data", "if not self.indexed:", "if False:"),
    ),
    mutant(
        "ends-at-first-footer",
        "Where there are several footers the first one ends the file.",
        "FOT-002 FIL-003",
        Edit(
            WALK,
            "yield chunk",
            'yield chunk\n        if header.type == "fOOT" and intact:\n            return',
        ),
    ),
    mutant(
        "signature-ignored",
        "A bad signature is not reported.",
        "FIL-001",
        Edit(WALK, "source.read_at(0, len(SIGNATURE)) != SIGNATURE", "False"),
    ),
    mutant(
        "salvage-nothing",
        "Of a damaged DATA payload nothing is delivered.",
        "REC-002",
        Edit(RUN, "if salvage.head is None or not salvage.kept:", "if True:"),
    ),
    mutant(
        "salvage-forwards-only",
        "Packets of a damaged payload are placed from the front alone.",
        "REC-002",
        Edit(RUN, "salvage.place_backwards(size)", "pass"),
    ),
    mutant(
        "salvage-backwards-only",
        "Packets of a damaged payload are placed from the end alone.",
        "REC-002",
        Edit(RUN, "salvage.place_forwards()", "pass"),
    ),
    mutant(
        "salvage-header-size-only",
        "A damaged payload ends where its header says, wherever the next header is.",
        "REC-002",
        Edit("reading.packets:PacketPass.region", "if size != sizes[0] and", "if False and"),
    ),
    mutant(
        "overlap-delivered",
        "Packets that start before the end of one delivered before are delivered too.",
        "DAT-006",
        Edit(
            "reading.packets:PacketPass.settle",
            "if packet.start < last or place < line.place:",
            "if False:",
        ),
    ),
    mutant(
        "lost-times-ignored",
        "The times of the indexes do not bound the loss.",
        "REC-003 REC-012",
        Edit(
            "reading.damage:Timeline.missing",
            "if len(gone) < count:",
            "if True:",
        ),
    ),
    mutant(
        "lost-times-by-place",
        "The first entry of every index is taken for chunk 0.",
        "IDX-002 REC-012",
        Edit(
            "reading.damage:Timeline.__init__",
            "enumerate(index.entries, index.first_sequence)",
            "enumerate(index.entries)",
        ),
    ),
    mutant(
        "lost-times-of-neighbours",
        "What a damaged chunk lost is not bounded by its own entry.",
        "REC-003 REC-012",
        Edit("reading.damage:Timeline.of", "return UNKNOWN if", "return UNKNOWN if True or"),
    ),
    mutant(
        "lost-end-unreported",
        "Loss behind the last packet of a track is not reported.",
        "REC-003 REC-012",
        Edit("reading.damage:Losses.end", "if hole is not None:", "if False:"),
    ),
    mutant(
        "lost-holes-unreported",
        "Loss between two packets is not reported.",
        "REC-003 REC-012",
        Edit("reading.damage:Losses.settle", "if low < high:", "if False:"),
    ),
    mutant(
        "exit-0-on-loss",
        "A file with damage ends with code 0.",
        "VRD-001",
        Edit(
            EXIT,
            "found = set(codes)",
            "found, lost = set(), False",
        ),
    ),
    mutant(
        "exit-0-not-closed",
        "A file that was not closed ends with code 0.",
        "VRD-001",
        Edit(EXIT, "if found and not broken:", "if found and False:"),
    ),
    mutant(
        "unsupported-before-damage",
        "A damaged file with an unknown critical chunk ends with code 4.",
        "VRD-001",
        Edit(
            EXIT,
            "found = set(codes)",
            "found, lost = (set(), False) if unknown else (set(codes), lost)",
        ),
    ),
    mutant(
        "digests-never-compared",
        "Digests are read and never compared.",
        "DGS-002",
        Edit("reading.reader:DigestCheck.compare", "self.running[id_].digest() != digest", "False"),
        role="verifier",
    ),
    mutant(
        "digests-of-all-packets",
        "A digest is compared with all packets, also those behind it.",
        "DGS-003",
        Edit(
            "reading.reader:DigestCheck.add",
            "if piece.offset < offset:",
            "if piece.track.id in self.running:",
        ),
        role="verifier",
    ),
    mutant(
        "index-unchecked",
        "What an index lists is not compared with the chunks.",
        "IDX-002",
        Edit(
            "reading.verifier:check_structure",
            "check_listing(index, ref.offset, listing, chunk.payload_offset)",
            "pass",
        ),
        role="verifier",
    ),
    mutant(
        "index-number-unchecked",
        "The number of the first chunk that an index lists is not compared.",
        "IDX-002",
        Edit("format.extras:check_listing", "if index.first_sequence != start:", "if False:"),
        role="verifier",
    ),
    mutant(
        "footer-unchecked",
        "The duration of a footer is not compared with the file.",
        "FOT-002",
        Edit(
            "reading.verifier:check_structure",
            "if foot.duration_ns != int(catalogue.duration * 10**9):",
            "if False:",
        ),
        role="verifier",
    ),
    mutant(
        "footer-distance-unchecked",
        "The distance of the index in a footer is not compared with the file.",
        "FOT-002",
        Edit(
            "reading.verifier:check_foot",
            "parse_foot(chunk.payload, 0).index_distance != distance",
            "parse_foot(chunk.payload, 0) is None",
        ),
        role="verifier",
    ),
    mutant(
        "closed-file-without-end",
        "In a closed file too a loss whose end no index tells has no end.",
        "REC-003 REC-012",
        Edit(
            "reading.damage:Losses.suspect",
            "if stop is None and self.duration_ns is not None:",
            "if False:",
        ),
        role="verifier",
    ),
    mutant(
        "index-trusted",
        "What the index does not list is not there, and what it lists is not checked.",
        "IDX-003",
        Edit("reading.opening:open_catalogue", "if not scan:", "if True:"),
    ),
)
