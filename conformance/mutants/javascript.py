"""Mistakes that JavaScript invites: one number type, 32 bits in its operators, truncation, sorting
as texts. Each is a line of the decoder in hapfmt/viewer/decoder."""

from __future__ import annotations

from .mutant import Edit, Mutant, mutant


def javascript(
    name: str, about: str, requirements: str, *changes: Edit, role: str = "decoder"
) -> Mutant:
    return mutant(f"js-{name}", about, requirements, *changes, role=role, language="javascript")


MUTANTS = (
    javascript(
        "linked-to-itself-less-one",
        "The track that another one is linked to is taken as it is stored, 1 too high.",
        "TRK-007 TRK-016",
        Edit("trak.js", "track.linked = reader.varint() - 1;", "track.linked = reader.varint();"),
    ),
    javascript(
        "tlv-types-of-any-size",
        "A TLV may have a type above 65535.",
        "TLV-001",
        Edit("head.js", "if (type >= TYPE_BOUND)", "if (false)"),
    ),
    javascript(
        "rdiv-truncates",
        "The quotient rdiv truncates.",
        "CNV-001 LPC-005",
        Edit(
            "integers.js",
            "return Math.floor((2 * n + d) / (2 * d));",
            "return Math.trunc((2 * n + d) / (2 * d));",
        ),
    ),
    javascript(
        "varint-of-32-bits",
        "The groups of a varint are put together by shifts, which keep 32 bits.",
        "CNV-002 DAT-003",
        Edit("bytes.js", "value += (byte & 127) * scale;", "value |= (byte & 127) * scale;"),
    ),
    javascript(
        "svarint-halves",
        "An svarint is halved by a shift, which keeps 32 bits.",
        "CNV-001 VAL-001",
        Edit("bytes.js", "return u % 2 === 0 ? u / 2", "return u % 2 === 0 ? u >> 1"),
    ),
    javascript(
        "lines-half-down",
        "A line that is added up rounds a half down.",
        "CNV-001",
        Edit("lines.js", "if (rest >= full) {", "if (rest > full) {"),
    ),
    javascript(
        "scale-of-32-bits",
        "The averages are those of 32 bits, whatever their size.",
        "RNG-003",
        Edit("entropy.js", "const m = 32 * sum;", "const m = (32 * sum) | 0;"),
    ),
    javascript(
        "raw-unsigned",
        "Counts of RAWB are shifted back without their sign.",
        "RAW-001 RAW-005",
        Edit("rawb.js", "(word << shift) >> shift", "(word << shift) >>> shift"),
    ),
    javascript(
        "channels-as-texts",
        "Channels are sorted as texts: 10 before 9.",
        "TRK-010",
        Edit(
            "channels.js",
            "[...list.values()].sort((a, b) => a.channel - b.channel)",
            "[...list.values()].sort((a, b) => (`${a.channel}` < `${b.channel}` ? -1 : 1))",
        ),
    ),
    javascript(
        "lf-for-full-band",
        "Where the HF track is lost the LF track is played as the full band.",
        "DEC-003",
        Edit(
            "channels.js",
            "track.kind === 'full' || residual ? new Part",
            "track.kind !== 'hf' ? new Part",
        ),
    ),
    javascript(
        "sum-not-clamped",
        "The sum of LF and HF is not clamped from above.",
        "DEC-001",
        Edit(
            "channels.js",
            "sum < countMin ? countMin : sum > countMax ? countMax : sum",
            "sum < countMin ? countMin : sum",
        ),
    ),
    javascript(
        "resync-behind-payload",
        "After a damaged payload the search begins behind it.",
        "REC-002 REC-003",
        Edit("walk.js", "suspectFrom ?? position", "position"),
    ),
    javascript(
        "file-id-ignored",
        "Headers of other files are taken for chunks.",
        "CHK-004 REC-002",
        Edit("walk.js", "if (header && header.fileId !== fileId) header = null;", ""),
        Edit("walk.js", "(h) => h.fileId === fileId)", "() => true)"),
    ),
    javascript(
        "file-id-of-53-bits",
        "A file id is kept as a Number, whose last bits are lost.",
        "CHK-004",
        Edit(
            "chunk.js",
            "idText(u32(bytes, p + 12), u32(bytes, p + 8))",
            "`0x${(u32(bytes, p + 12) * 2 ** 32 + u32(bytes, p + 8)).toString(16)"
            ".padStart(16, '0')}`",
        ),
    ),
    javascript(
        "header-crc-ignored",
        "The CRC of a chunk header is not looked at.",
        "CHK-002 REC-001",
        Edit(
            "chunk.js",
            "if (u32(bytes, p + CRC_AT) !== crc32(bytes, p, p + CRC_AT)) return null;",
            "",
        ),
    ),
    javascript(
        "order-of-the-file",
        "Chunks that changed places are delivered in the order of the file.",
        "REC-002 DAT-006",
        Edit(
            "deliver.js",
            "a.chunk.sequence - b.chunk.sequence || a.chunk.position - b.chunk.position",
            "a.chunk.position - b.chunk.position",
        ),
    ),
    javascript(
        "exact-lower-half",
        "Negative corrections of LPCX lose their borrow from the lower half.",
        "EXA-007 EXA-006",
        Edit(
            "entropy.js",
            "upper[i] = (high ^ minus) - (sum === 0 ? minus : 0);",
            "upper[i] = (high ^ minus) - minus;",
        ),
    ),
    javascript(
        "unsupported-before-damage",
        "A damaged file with an unknown critical chunk is called unsupported.",
        "VRD-001",
        Edit(
            "report.js",
            "} else if (file.damages.length && ",
            "} else if (!file.criticalUnknown && file.damages.length && ",
        ),
    ),
    javascript(
        "digest-without-coverage",
        "The digest leaves out the coverage.",
        "DGS-002 DGS-003",
        Edit("digest.js", "this.spans.forEach(([start, stop], i)", "[].forEach(([start, stop], i)"),
        role="verifier",
    ),
    javascript(
        "state-of-a-negative",
        "The remainder of a negative integer chooses the next state.",
        "MDC-003 CNV-001",
        Edit("mdct.js", "this.state + (magnitude % 2)", "this.state + (integer % 2)"),
    ),
    javascript(
        "sums-of-32-bits",
        "The sums of a block are cut to 32 bits.",
        "CNV-001 MDC-003",
        Edit("mdct.js", "v[j] += x * wave[j];", "v[j] = (v[j] + x * wave[j]) | 0;"),
    ),
    javascript(
        "averages-of-32-bits",
        "The averages of coefficients move by 32 bits.",
        "RNG-001 RNG-003",
        Edit("mdct.js", "Math.floor((P[k] - E[k]) / 4)", "(P[k] - E[k]) >> 2"),
    ),
    javascript(
        "mixed-in-place",
        "Where two blocks meet, the second sample is mixed from the first one as it is by then.",
        "CNV-001",
        Edit(
            "mdct.js",
            "rdiv(w[i] * right - z[i] * left, 8388608)",
            "rdiv(w[i] * right - z[i] * before[M - 1 - i], 8388608)",
        ),
    ),
    javascript(
        "sums-not-cleared",
        "The sums of a block are added to what is left of an earlier one.",
        "CNV-001",
        Edit("mdct.js", "v.fill(0);", ""),
    ),
    javascript(
        "noise-products-rounded",
        "The products of the noise are those of doubles, not of 32 bits.",
        "CNV-001",
        Edit(
            "nois.js",
            "w = Math.imul(w ^ (w >>> 16), 2246822507);",
            "w = ((w ^ (w >>> 16)) * 2246822507) | 0;",
        ),
    ),
)
