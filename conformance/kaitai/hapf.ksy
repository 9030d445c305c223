meta:
  id: hapf
  title: The hapf file format, container
  file-extension: hapf
  license: CC0-1.0
  ks-version: "0.10"
  endian: le
  encoding: UTF-8
doc: |
  A haptic recording: a signature, then chunks. SPEC.md says what is written here in full; where
  the two differ, SPEC.md is right. Checksums, the rules of SPEC.md and damage are not looked at:
  this reads files that keep every rule. Packets stay bytes, but for those of events.
doc-ref: SPEC.md, clauses 2, 5, 6, 8, 9 and 11
seq:
  - id: signature
    contents: [0x8f, 0x48, 0x41, 0x50, 0x0d, 0x0a, 0x1a, 0x0a]
    doc: First bytes of every file.
    doc-ref: SPEC.md FIL-001
  - id: chunks
    type: chunk
    repeat: eos
    doc: One directly after the other, to the end of the file.
types:
  varint:
    doc: An unsigned integer below 2^53 in groups of seven bits, the least significant first.
    doc-ref: SPEC.md clause 2, CNV-002
    seq:
      - id: groups
        type: u1
        repeat: until
        repeat-until: _ < 0x80
        doc: One to eight bytes; all but the last have bit 7 set.
    instances:
      value:
        value: >-
          groups[0] % 128
          + (groups.size > 1 ? groups[1] % 128 * 0x80 : 0)
          + (groups.size > 2 ? groups[2] % 128 * 0x4000 : 0)
          + (groups.size > 3 ? groups[3] % 128 * 0x200000 : 0)
          + (groups.size > 4 ? groups[4] % 128 * 0x10000000 : 0)
          + (groups.size > 5 ? groups[5] % 128 * 0x800000000 : 0)
          + (groups.size > 6 ? groups[6] % 128 * 0x40000000000 : 0)
          + (groups.size > 7 ? groups[7] % 128 * 0x2000000000000 : 0)
        doc: The integer.
  svarint:
    doc: A signed integer as the varint of 2v, or of -2v - 1 where it is negative.
    doc-ref: SPEC.md clause 2
    seq:
      - id: number
        type: varint
        doc: The varint of the integer.
    instances:
      value:
        value: 'number.value % 2 == 0 ? number.value / 2 : -(number.value / 2) - 1'
        doc: The integer.
  string_list:
    doc: Texts to the end of the value; one entry speaks for all components.
    doc-ref: SPEC.md clause 2, TLV-004
    seq:
      - id: entries
        type: string_entry
        repeat: eos
        doc: The texts in order of tracks and components.
  string_entry:
    seq:
      - id: size
        type: u1
        doc: Bytes of the text; 255 means the text of the entry before.
      - id: text
        type: str
        size: 'size == 255 ? 0 : size'
        doc: The text.
    instances:
      same_as_before:
        value: size == 255
        doc: Whether the text of the entry before holds here too.
  chunk:
    doc: Header and payload.
    doc-ref: SPEC.md 5.1
    seq:
      - id: header
        type: chunk_header
        doc: 32 bytes, the same for ever.
      - id: payload
        size: header.payload_size
        type:
          switch-on: header.type
          cases:
            '"HEAD"': head
            '"TRAK"': trak
            '"DATA"': data
            '"iNDX"': indx
            '"fOOT"': foot
            '"mETa"': meta
            '"aTTc"': attc
            '"dGST"': dgst
            '"cLOk"': clok
            '"cMAp"': cmap
        doc: What the type says; bytes where the type is not known.
  chunk_header:
    seq:
      - id: sync
        contents: [0xf9, 0x48, 0x8b, 0x1c]
        doc: Sync word.
      - id: type
        type: str
        size: 4
        encoding: ASCII
        doc: Chunk type; the cases of its letters are the property bits (5.2).
      - id: file_id
        type: u8
        doc: File id, the same in every chunk of the file.
      - id: sequence
        type: u4
        doc: 0 for the first chunk, one more for each next.
      - id: payload_size
        type: u4
        doc: Size of the payload in bytes.
      - id: payload_crc
        type: u4
        doc: File CRC of the payload (clause 2).
      - id: header_crc
        type: u4
        doc: CRC-32 of the 28 bytes before it.
  head:
    doc: Version, level, and what the file says of itself as a whole.
    doc-ref: SPEC.md 6.1
    seq:
      - id: major
        type: u1
        doc: Major version, 1.
      - id: minor
        type: u1
        doc: Minor version, 0.
      - id: level
        type: u1
        doc: Level, 1 or 2 (clause 12).
      - id: tlvs
        type: head_tlv
        repeat: eos
        doc: In strictly increasing order of their types.
  head_tlv:
    doc: A value with its type; odd types are critical.
    doc-ref: SPEC.md 6.1, 6.2
    seq:
      - id: type
        type: varint
        doc: What the value is; without type 2 the UUID follows from the file id.
      - id: size
        type: varint
        doc: Size of the value in bytes.
      - id: value
        size: size.value
        type:
          switch-on: type.value
          cases:
            4: epoch
            6: text
        doc: UUID of the recording in network order (2), or what the type says.
  epoch:
    seq:
      - id: epoch_ns
        type: s8
        doc: UTC of tick 0, nanoseconds since 1970-01-01T00:00:00Z.
      - id: uncertainty_ns
        type: u8
        doc: Its uncertainty.
  trak:
    doc: Tracks; their ids follow on from the first.
    doc-ref: SPEC.md 6.3
    seq:
      - id: first_track
        type: varint
        doc: Id of the first track.
      - id: plain_size
        type: varint
        doc: 0 for tracks that are not compressed, else the size of the inflated tracks.
      - id: tracks
        size-eos: true
        type: tracks
        if: plain_size.value == 0
        doc: The tracks.
      - id: stream
        size-eos: true
        if: plain_size.value != 0
        doc: DEFLATE stream (RFC 1951) of what is to be read as type tracks.
  tracks:
    seq:
      - id: tracks
        type: track
        repeat: eos
        doc: One after the other.
  track:
    doc: The description of a track.
    doc-ref: SPEC.md 6.3
    seq:
      - id: kind
        type: b4le
        enum: kind
        doc: The band of the track, in the lowest four bits.
      - id: number_format
        type: b4le
        enum: number_format
        doc: Counts, or words of a format, in the highest four bits.
      - id: codec
        type: str
        size: 4
        encoding: ASCII
        doc: Codec.
      - id: component_count
        type: u1
        doc: Components.
      - id: rate_num
        type: varint
        doc: Numerator of the rate in ticks per second.
      - id: rate_den
        type: varint
        doc: Denominator of the rate.
      - id: count_min
        type: svarint
        doc: Declared range of a decoded count, lowest.
      - id: count_max
        type: svarint
        doc: Declared range of a decoded count, highest.
      - id: first_channel
        type: varint
        doc: Channel number of the first component; the others follow.
      - id: linked
        type: varint
        doc: For HF 1 + id of its base track; else 1 + id of the track that it continues, or 0.
      - id: tlv_count
        type: u1
        doc: TLVs that follow.
      - id: tlvs
        type: track_tlv
        repeat: expr
        repeat-expr: tlv_count
        doc: In strictly increasing order of their types.
    enums:
      kind:
        0: full_band
        1: lf
        2: hf
        3: events
      number_format:
        0: counts
        1: int64
        2: uint64
        3: binary16
        4: binary32
        5: binary64
  track_tlv:
    seq:
      - id: type
        type: varint
        doc: What the value is (table of 6.2).
      - id: size
        type: varint
        doc: Size of the value in bytes.
      - id: value
        size: size.value
        type:
          switch-on: type.value
          cases:
            1: parameters(_parent.codec)
            2: string_list
            3: calibration_list
            4: string_list
            5: channel_numbers
            6: string_list
            8: string_list
            10: string_list
            12: string_list
            14: string_list
            16: contract(_parent.component_count)
            18: deviation_list
            22: text
        doc: The value; bytes where the type is not known.
  channel_numbers:
    seq:
      - id: further
        type: u2
        repeat: eos
        doc: Channel numbers of the components after the first.
  text:
    seq:
      - id: text
        type: str
        size-eos: true
        doc: One UTF-8 text.
  parameters:
    doc: Codec parameters of the tracks.
    doc-ref: SPEC.md clause 9
    params:
      - id: codec
        type: str
        doc: Codec whose parameters these are.
    seq:
      - id: value
        size-eos: true
        type:
          switch-on: codec
          cases:
            '"KNOT"': knot_parameters
            '"QUAN"': quan_parameters
            '"RAWB"': rawb_parameters
            '"LPCR"': lpcr_parameters
            '"LPCX"': lpcx_components
            '"MDCT"': mdct_parameters
            '"NOIS"': nois_parameters
        doc: The parameters; bytes where the codec is not known.
  knot_parameters:
    doc-ref: SPEC.md 9.1
    seq:
      - id: interpolation
        type: u1
        enum: interpolation
        doc: How knots are joined.
      - id: coding
        type: u1
        enum: knot_coding
        doc: How knots are stored.
      - id: grid
        type: lpcr_parameters
        doc: The count of each index.
  quan_parameters:
    doc-ref: SPEC.md 9.2
    seq:
      - id: step
        type: u4
        doc: Counts per level.
      - id: direct_levels
        type: u2
        doc: M; levels -M to M have symbols of their own.
      - id: run_classes
        type: u1
        doc: R; number of zero-run symbols.
      - id: escape_classes
        type: u1
        doc: C; number of escape symbols.
      - id: codebook
        type: b4
        repeat: eos
        doc: Code word lengths in nibbles; a 0 and the nibble n after it skip n + 1 symbols.
  rawb_parameters:
    doc-ref: SPEC.md 9.3
    seq:
      - id: word_size
        type: u1
        doc: Bytes per word, 1, 2, 3, 4 or 8.
      - id: reserved
        size: 3
        doc: "0."
  lpcr_parameters:
    doc-ref: SPEC.md 9.5
    seq:
      - id: grid
        type: u1
        enum: grid
        doc: Uniform, or a deadband's.
      - id: step
        type: varint
        doc: Counts per index; of a deadband's grid the floor in counts.
      - id: zero
        type: svarint
        doc: Count of index 0.
      - id: kn
        type: varint
        if: grid == grid::deadband
        doc: Numerator of the Weber fraction.
      - id: kd
        type: varint
        if: grid == grid::deadband
        doc: Its denominator.
  lpcx_components:
    doc-ref: SPEC.md 9.7
    seq:
      - id: components
        type: lpcx_parameters
        repeat: eos
        doc: In their order.
  lpcx_parameters:
    doc-ref: SPEC.md 9.7
    seq:
      - id: rule
        type: u1
        enum: rule
        doc: How a count becomes a binary64 number.
      - id: digits
        type: u1
        doc: Significant digits with rule 2; else 0.
      - id: terms
        type: u1
        doc: Number of terms with rule 4; else 0.
      - id: reserved
        type: u1
        doc: "0."
      - id: coefficients
        type: f8
        repeat: expr
        repeat-expr: 4
        if: rule == rule::cubic
        doc: c0 to c3 of rule 3.
      - id: constant
        type: f8
        if: rule == rule::linear
        doc: c0 of rule 4.
      - id: weights
        type: lpcx_term
        repeat: expr
        repeat-expr: terms
        doc: The terms of rule 4.
  nois_parameters:
    doc-ref: SPEC.md 9.10
    seq:
      - id: shift
        type: u1
        doc: An interval has 2^shift ticks.
      - id: intervals
        type: u1
        doc: Intervals of a block.
  lpcx_term:
    doc-ref: SPEC.md 9.7
    seq:
      - id: a
        type: u1
        doc: A component of the track.
      - id: lag
        type: u1
        doc: In ticks.
      - id: w
        type: f8
        doc: Of its exact value.
  mdct_parameters:
    doc-ref: SPEC.md 9.8
    seq:
      - id: m
        type: u1
        doc: A block has 2^m coefficients.
      - id: step
        type: varint
        doc: In 256ths of a count.
      - id: weight_count
        type: u1
        doc: n, number of weights; 0 means none.
      - id: weights
        type: u1
        repeat: expr
        repeat-expr: weight_count
        doc: 32 times the factor on the step of each band.
  calibration_list:
    doc: Physical value = (count * A + B) / D.
    doc-ref: SPEC.md clause 8
    seq:
      - id: entries
        type: calibration
        repeat: eos
        doc: One for all components, or one for each.
  calibration:
    seq:
      - id: a
        type: svarint
        doc: A, not 0.
      - id: b
        type: svarint
        doc: B.
      - id: d
        type: varint
        doc: D, at least 1.
  contract:
    doc: How far a reconstruction may lie from the input.
    doc-ref: SPEC.md clause 11
    params:
      - id: component_count
        type: u1
        doc: Components of the track.
    seq:
      - id: kn
        type: varint
        doc: Numerator of the Weber fraction.
      - id: kd
        type: varint
        doc: Denominator of the Weber fraction.
      - id: flags
        type: u1
        doc: Bit 0 vector form, bit 1 guaranteed; others 0.
      - id: components
        type: contract_component
        repeat: expr
        repeat-expr: component_count
        doc: One for each component of the track.
  contract_component:
    seq:
      - id: floor
        type: varint
        doc: Absolute floor in counts.
      - id: zero
        type: svarint
        doc: Count of the physical value 0.
  deviation_list:
    doc: How far the source was from the grid of its counts.
    doc-ref: SPEC.md 6.2
    seq:
      - id: entries
        type: deviation
        repeat: eos
        doc: One for all components, or one for each.
  deviation:
    seq:
      - id: declared
        type: f4
        doc: Tolerance that the caller declared, in the unit of the channel.
      - id: largest
        type: f4
        doc: Largest deviation found, in the unit of the channel.
  data:
    doc: A cluster, packets of any tracks for one stretch of time.
    doc-ref: SPEC.md 6.4
    seq:
      - id: packet_count
        type: varint
        doc: How many packets.
      - id: widths
        type: u2
        doc: Bytes of each field of a row, four bits each, track in the lowest, then size, start, span.
      - id: least_track
        type: varint
        doc: Least track id of the packets.
      - id: least_size
        type: varint
        doc: Bytes of the smallest packet.
      - id: least_start
        type: varint
        doc: Earliest tick that a packet starts at.
      - id: least_span
        type: varint
        doc: Fewest ticks of a packet.
      - id: rows
        type: row(widths)
        repeat: expr
        repeat-expr: packet_count.value
        doc: One for each packet, in increasing order of (track, start).
      - id: table_crc
        type: u4
        doc: Cluster CRC of all bytes of the payload before it.
      - id: packets
        size: least_size.value + rows[_index].size.value
        repeat: expr
        repeat-expr: packet_count.value
        doc: The packets, whose bytes their codecs read (clause 9); those of EVNT as type event_packet.
  row:
    doc: What the least values of the cluster are to be added to.
    params:
      - id: widths
        type: u2
        doc: Those of the cluster.
    seq:
      - id: track
        type: digits(widths & 15)
        doc: Track id.
      - id: size
        type: digits((widths >> 4) & 15)
        doc: Bytes of the packet.
      - id: start
        type: digits((widths >> 8) & 15)
        doc: Tick of the first sample.
      - id: span
        type: digits((widths >> 12) & 15)
        doc: Number of ticks.
      - id: packet_crc
        type: u4
        doc: Cluster CRC of packet_count, track, size, start and span, then the packet.
  digits:
    doc: A number in as many bytes as the cluster says, least significant first.
    params:
      - id: width
        type: u1
        doc: How many bytes.
    seq:
      - id: digits
        type: u1
        repeat: expr
        repeat-expr: width
        doc: At most six.
    instances:
      value:
        value: >-
          (width > 0 ? digits[0] : 0)
          + (width > 1 ? digits[1] * 0x100 : 0)
          + (width > 2 ? digits[2] * 0x10000 : 0)
          + (width > 3 ? digits[3] * 0x1000000 : 0)
          + (width > 4 ? digits[4] * 0x100000000 : 0)
          + (width > 5 ? digits[5] * 0x10000000000 : 0)
  event_packet:
    doc: Packet of codec EVNT; which packets these are says the description of their track.
    doc-ref: SPEC.md 9.9
    seq:
      - id: events
        type: event
        repeat: eos
        doc: In order of their ticks.
  event:
    seq:
      - id: tick
        type: varint
        doc: Tick minus that of the event before; of the first, minus the start of the packet.
      - id: duration
        type: varint
        doc: In ticks; 0 for a moment.
      - id: channel
        type: varint
        doc: 0 for the whole recording, else 1 + the channel number.
      - id: size
        type: varint
        doc: Bytes of the text.
      - id: text
        type: str
        size: size.value
        doc: The text.
  indx:
    doc: A list of chunks, with the times of clusters.
    doc-ref: SPEC.md 11.1
    seq:
      - id: previous
        type: u8
        doc: Offset of the iNDX chunk that the list begins with; 0 means none.
      - id: first_sequence
        type: u4
        doc: Sequence number of the first chunk that is listed.
      - id: entry_count
        type: u4
        doc: Number of entries.
      - id: entries
        type: index_entry
        repeat: expr
        repeat-expr: entry_count
        doc: One for each chunk, in the order of the file.
  index_entry:
    seq:
      - id: type
        type: str
        size: 4
        encoding: ASCII
        doc: Type of the chunk.
      - id: distance
        type: varint
        doc: Offset of its header minus that of the entry before; of the first, minus previous.
      - id: start_ms
        type: varint
        if: type == "DATA"
        doc: Start of the earliest packet in milliseconds, rounded down.
      - id: length_ms
        type: varint
        if: type == "DATA"
        doc: End of the latest packet, rounded up, minus start_ms.
  foot:
    doc: Where the index is; the file was closed.
    doc-ref: SPEC.md 11.2
    seq:
      - id: index_distance
        type: u4
        doc: Offset of this chunk minus that of the last iNDX chunk before it; 0 means none.
      - id: duration_ns
        type: u8
        doc: End of the latest packet, rounded up.
  meta:
    doc-ref: SPEC.md 11.3
    seq:
      - id: json
        type: str
        size-eos: true
        doc: One JSON object.
  attc:
    doc: An attachment.
    doc-ref: SPEC.md 11.4
    seq:
      - id: name_size
        type: u1
        doc: Bytes of the name.
      - id: name
        type: str
        size: name_size
        doc: Name.
      - id: media_type_size
        type: u1
        doc: Bytes of the media type.
      - id: media_type
        type: str
        size: media_type_size
        doc: Media type; may be empty.
      - id: content
        size-eos: true
        doc: The attached file.
  dgst:
    doc: Digests of a track and of those that follow it.
    doc-ref: SPEC.md 11.5
    seq:
      - id: track
        type: varint
        doc: Id of the first track.
      - id: digests
        size: 32
        repeat: eos
        doc: SHA-256 of the canonical decode of one track.
  clok:
    doc: Observations of another clock.
    doc-ref: SPEC.md 11.6
    seq:
      - id: track
        type: varint
        doc: 1 + id of the track whose ticks these are; 0 means none.
      - id: name_size
        type: u1
        doc: Bytes of the name.
      - id: name
        type: str
        size: name_size
        doc: Name of the other clock.
      - id: observation_count
        type: varint
        doc: How many observations.
      - id: observations
        type: observation(_index)
        repeat: expr
        repeat-expr: observation_count.value
        doc: As they were made.
  observation:
    params:
      - id: number
        type: s4
        doc: Place of the observation in the chunk.
    seq:
      - id: tick
        type: svarint
        doc: Minus that of the observation before; of the first, the tick itself.
      - id: first_time_ns
        type: s8
        if: number == 0
        doc: What the clock showed at the first observation.
      - id: later_ns
        type: svarint
        if: number > 0
        doc: The same at a later observation, minus that of the one before.
      - id: uncertainty_ns
        type: varint
        doc: At most so much too early or too late; 0 means not known.
  cmap:
    doc: A map from ticks to the time of another clock.
    doc-ref: SPEC.md 11.6
    seq:
      - id: track
        type: varint
        doc: 1 + id of the track whose ticks these are; 0 means none.
      - id: name_size
        type: u1
        doc: Bytes of the name.
      - id: name
        type: str
        size: name_size
        doc: Name of the other clock.
      - id: point_count
        type: varint
        doc: How many points, at least two.
      - id: points
        type: point(_index)
        repeat: expr
        repeat-expr: point_count.value
        doc: Ticks and times grow from point to point.
  point:
    params:
      - id: number
        type: s4
        doc: Place of the point in the chunk.
    seq:
      - id: first_tick
        type: svarint
        if: number == 0
        doc: Tick of the first point.
      - id: first_time_ns
        type: s8
        if: number == 0
        doc: Time of the first point.
      - id: tick
        type: varint
        if: number > 0
        doc: Tick minus that of the point before.
      - id: later_ns
        type: varint
        if: number > 0
        doc: Time minus that of the point before.
enums:
  interpolation:
    0: hold
    1: linear
  knot_coding:
    0: varints
    1: entropy
  grid:
    0: uniform
    1: deadband
  rule:
    0: quotient
    1: product
    2: significant_digits
    3: cubic
    4: linear
