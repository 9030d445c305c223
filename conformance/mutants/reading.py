"""Wrong readers: versions, unknown parts, bands, channels, layers and limits (SPEC clauses 5 to 11
and 15)."""

from __future__ import annotations

from .mutant import Edit, mutant

LEARN = "reading.catalogue:Catalogue.learn"
HEAD = "format.wire:parse_head"
SUM = "reading.decoder:add_residual"
PART = "reading.decoder:Assembly.of_part"
DECODE = "reading.decoder:TrackDecoder.decode"
NO_RANGE = (
    "__import__('dataclasses').replace(self.track, count_min=-(1 << 31), count_max=(1 << 31) - 1)"
)

MUTANTS = (
    mutant(
        "channel-numbers-ignored",
        "The components of a track have the numbers after its first channel, whatever TLV 5 says.",
        "TRK-010",
        Edit(
            "format.track:further_of",
            "found = tuple(value[k] + 256 * value[k + 1] for k in range(0, len(value), 2))",
            "pass",
        ),
    ),
    mutant(
        "clamp-missing",
        "Decoded counts are not clamped to the declared range of their track.",
        "DEC-001",
        Edit(
            DECODE,
            "track, parameters = self.track, self.parameters",
            f"parameters, track = self.parameters, {NO_RANGE}",
        ),
    ),
    mutant(
        "hf-not-clamped",
        "Counts of HF tracks are not clamped before they are added.",
        "DEC-001",
        Edit(
            DECODE,
            "track, parameters = self.track, self.parameters",
            f"parameters, track = self.parameters, {NO_RANGE} "
            "if self.track.kind == 'hf' else self.track",
        ),
    ),
    mutant(
        "sum-not-clamped",
        "The sum of LF and HF is not clamped.",
        "DEC-001",
        Edit("reading.decoder:sum_of", "np.clip(both, lf.count_min, lf.count_max)", "both"),
    ),
    mutant(
        "sum-clamped-to-hf",
        "The sum of LF and HF is clamped to the range of the HF track.",
        "DEC-001",
        Edit(SUM, "sum_of(lf.track, ", "sum_of(hf.track, "),
    ),
    mutant(
        "hf-a-tick-late",
        "The residual of a tick is added to the tick after it.",
        "DEC-001 DEC-003",
        Edit(SUM, "e[j : j + span.ticks]", "np.roll(e[j : j + span.ticks], 1, axis=0)"),
    ),
    mutant(
        "lf-alone-delivered",
        "Ticks that the LF track alone covers are delivered in full band.",
        "DEC-003",
        Edit(
            SUM,
            "d, e = lf.numbers(), hf.numbers()",
            "d, rows = lf.numbers(), hf.numbers()\n"
            "    e = np.zeros_like(d)\n"
            "    for (i, j), span in intersect(lf.spans, hf.spans):\n"
            "        e[i : i + span.ticks] = rows[j : j + span.ticks]\n"
            "    hf = Decoded(hf.track, spans=lf.spans)",
        ),
    ),
    mutant(
        "lf-for-full-band",
        "Where the HF track is lost the LF track is played as the full band.",
        "DEC-003",
        Edit(
            PART,
            "# Its HF track is lost: what is left is not the channel (DEC-003).\n"
            "        return Decoded(part.track)",
            "return self.tracks[part.track.id]",
        ),
    ),
    mutant(
        "hf-of-full-band",
        "Asked for HF only, full-band tracks are delivered too.",
        "DEC-005",
        Edit(
            PART,
            "part.residual else Decoded(part.track)",
            "part.residual else self.tracks[part.track.id]",
        ),
        Edit(
            "reading.decoder:wanted_tracks",
            'if band != "hf":',
            'if band != "hf" or part.residual is None:',
        ),
    ),
    mutant(
        "zeros-into-gaps",
        "Gaps are filled with zeros.",
        "DEC-003",
        Edit(
            "reading.decoder:Decoded.add",
            "append_span(self.spans, Span(start, start + len(numbers)))",
            "if self.spans and self.spans[-1].stop < start:\n"
            "        zeros = np.zeros((start - self.spans[-1].stop, *numbers.shape[1:]))\n"
            "        self.pieces.append(zeros.astype(numbers.dtype))\n"
            "        append_span(self.spans, Span(self.spans[-1].stop, start))\n"
            "    append_span(self.spans, Span(start, start + len(numbers)))",
        ),
    ),
    mutant(
        "continued-alone",
        "Of tracks that continue one another the first alone is delivered.",
        "TRK-018",
        Edit("reading.decoder:join", "if len(parts) == 1:", "if True:"),
    ),
    mutant(
        "range-of-the-first",
        "Every track of a chunk has the range of the first.",
        "TRK-005 DEC-001",
        Edit(
            "format.track:parse_description",
            "return list(parse_tracks(plain, first_id, level, base, offset))",
            "tracks = list(parse_tracks(plain, first_id, level, base, offset))\n"
            "        low, high = tracks[0].count_min, tracks[0].count_max\n"
            "        from dataclasses import replace\n"
            "        return [replace(track, count_min=low, count_max=high) for track in tracks]",
        ),
    ),
    mutant(
        "ids-do-not-follow-on",
        "All tracks of a chunk have the id of its header.",
        "TRK-003 TRK-010",
        Edit(
            "format.track:parse_tracks",
            "id_, (raw, tlvs, start) in enumerate(parse_records(plain, base), first_id)",
            "id_, (raw, tlvs, start) in ((first_id, row) for row in parse_records(plain, base))",
        ),
    ),
    mutant(
        "descriptions-longer-than-told",
        "A DEFLATE stream of tracks may give more bytes than the chunk says.",
        "TRK-020",
        Edit(
            "format.track:unpack",
            'inflate(payload[start:], size, "TRK-020", offset + start)',
            "__import__('zlib').decompressobj(-15).decompress(payload[start:])",
        ),
    ),
    mutant(
        "a-byte-after-the-tracks",
        "What follows the last track is skipped.",
        "TLV-001",
        Edit(
            "format.track:parse_records",
            "while position < len(plain) or not components:",
            "while position + 28 <= len(plain) or not components:",
        ),
    ),
    mutant(
        "events-in-file-order",
        "The events of a layer come in the order of the file.",
        "EVT-004",
        Edit(
            "hapfmt_adapter.decode:layer_json",
            "sorted(events, key=lambda event: event.tick)",
            "events",
        ),
    ),
    mutant(
        "event-channel-as-stored",
        "The channel of an event is one too high.",
        "EVT-003",
        Edit(
            "codecs.events:parse_events",
            "channel - 1 if channel else None",
            "channel if channel else None",
        ),
    ),
    mutant(
        "critical-chunk-skipped",
        "An unknown critical chunk is skipped like any other.",
        "CHK-009",
        Edit(LEARN, "if header.critical and self.unsupported is None:", "if False:"),
    ),
    mutant(
        "ancillary-chunk-refused",
        "An unknown ancillary chunk makes a file unsupported.",
        "CHK-010",
        Edit(LEARN, "if header.critical and", "if"),
    ),
    mutant(
        "critical-tlv-skipped",
        "An unknown critical TLV is skipped.",
        "TLV-003",
        Edit(
            "format.track:find_unsupported",
            "if type_ % 2 and type_ not in KNOWN",
            "if False",
        ),
        Edit(HEAD, "if type_ % 2]", "if False]"),
    ),
    mutant(
        "ancillary-tlv-refused",
        "An unknown ancillary TLV makes a track unsupported.",
        "TLV-003",
        Edit(
            "format.track:find_unsupported",
            "if type_ % 2 and type_ not in KNOWN",
            "if type_ > 22",
        ),
    ),
    mutant(
        "minor-version-refused",
        "A minor version other than 0 is refused.",
        "VER-001",
        Edit(
            HEAD,
            "if payload and raw.major != MAJOR:",
            "if (raw.major, raw.minor) != (MAJOR, MINOR):",
        ),
    ),
    mutant(
        "major-version-ignored",
        "Any major version is read.",
        "VER-001",
        Edit(HEAD, "if payload and raw.major != MAJOR:", "if False:"),
    ),
    mutant(
        "uuid-backwards",
        "The UUID that follows from the file id has its digits from the lowest on.",
        "HED-002",
        Edit(
            "format.wire:uuid_of",
            'f"{file_id:016x}"',
            'f"{file_id:016x}"[::-1]',
        ),
    ),
    mutant(
        "epoch-of-uncertainty-0-unknown",
        "An epoch with the uncertainty 0 is taken for none.",
        "HED-002",
        Edit(
            HEAD,
            "epoch_ns, uncertainty_ns = HEAD_EPOCH.read(tlvs[EPOCH][1])",
            "epoch_ns, uncertainty_ns = HEAD_EPOCH.read(tlvs[EPOCH][1])\n"
            "        epoch_ns = epoch_ns if uncertainty_ns else None",
        ),
    ),
    mutant(
        "digests-of-track-0-on",
        "Digests are those of the tracks from 0 on, whatever their first track.",
        "DGS-001 DGS-002",
        Edit("format.extras:parse_digests", "first + place:", "place:"),
        role="verifier",
    ),
    mutant(
        "metadata-first-wins",
        "Members of later metadata do not replace those of earlier ones.",
        "MET-001",
        Edit(
            LEARN,
            "self.metadata.update(parse_metadata(chunk.payload, offset))",
            "self.metadata = parse_metadata(chunk.payload, offset) | self.metadata",
        ),
    ),
    mutant(
        "clock-maps-applied",
        "Samples get the times that a map to another clock gives their ticks.",
        "CLK-006",
        Edit(
            "hapfmt_adapter.decode:decoded",
            "tracks, layers = decode_tracks(reader)",
            "tracks, layers = decode_tracks(reader)\n"
            "    for found in catalogue.clock_maps:\n"
            "        ids = [i for i, t in tracks.items() if found.channel in t.track.channels]\n"
            "        spans = tracks[ids[0]].spans if ids else []\n"
            "        spans[:] = [Span(*map(found.time_ns, (s.start, s.stop))) for s in spans]",
        ),
    ),
    mutant(
        "limits-one-lower",
        "What just keeps a limit is refused.",
        "LIM-001",
        Edit("limits:Level.check", "if value > bound:", "if value >= bound:"),
    ),
    mutant(
        "limits-ignored",
        "The limits of the level are not checked.",
        "LIM-001 LIM-002",
        Edit("limits:Level.check", "if value > bound:", "if False:"),
    ),
    mutant(
        "level-two-for-all",
        "The limits of level 2 hold for every file.",
        "LIM-001",
        Edit(
            "reading.catalogue:Catalogue.level",
            "LEVELS[self.head.level] if self.head else LEVELS[2]",
            "LEVELS[2]",
        ),
    ),
)
