"""Wrong codecs: tables, models, codes and predictors (SPEC clause 9)."""

from __future__ import annotations

from .mutant import Edit, Rebind, mutant

HUFFMAN = "codecs.huffman:parse_codebook"
SYMBOLS = "codecs.quantised:Alphabet.expand"
BITS = "codecs.adaptive:BitModel.update"
SCALE = "codecs.adaptive:IntegerModel.learn"
STEP_UP = "codecs.predicted:step_up"
PREDICT = "codecs.predicted:predict"
PREDICTED = "(sum(a * b for a, b in zip(c, history, strict=True)) + (1 << (SHIFT - 1))) >> SHIFT"
TRUNCATED = "int((sum(a * b for a, b in zip(c, history, strict=True)) + 4096) / 8192)"
CROSS = "codecs.components:cross_terms"
TAPS = "codecs.components:taps_of"
RICE = "codecs.rice:RiceReader.code"
GRID = "codecs.grids:deadband_levels"
MODELS = (BITS, "codecs.adaptive:SymbolModel.update")
BUCKETS = tuple(f"codecs.adaptive:{name}" for name in ("IntegerModel.decode", "bucket_of"))

MUTANTS = (
    mutant(
        "zero-run-one-short",
        "A run of level 0 is one level shorter than its symbol says.",
        "QNT-004",
        Edit(SYMBOLS, "+ 1)) + extra[run]", "+ 1)) + extra[run] - 1"),
    ),
    mutant(
        "levels-signs-swapped",
        "Odd symbols are negative levels.",
        "QNT-006",
        Edit(SYMBOLS, "np.where(symbols & 1, half, -half)", "np.where(symbols & 1, -half, half)"),
    ),
    mutant(
        "escape-one-low",
        "The levels of escape symbols begin at M, not above it.",
        "QNT-006",
        Edit(SYMBOLS, "self.direct_levels + base", "self.direct_levels + base - 1"),
    ),
    mutant(
        "codebook-run-one-short",
        "The nibbles 0, n stand for n symbols without a code word.",
        "QNT-003",
        Edit(HUFFMAN, "[0] * (nibbles[position] + 1)", "[0] * nibbles[position]"),
    ),
    mutant(
        "codebook-incomplete",
        "Code words that are not complete are taken.",
        "QNT-003",
        Edit(HUFFMAN, "if not complete and", "if False and"),
    ),
    mutant(
        "filler-unchecked",
        "The bits that fill the last byte of a QUAN packet may be anything.",
        "QNT-004",
        Edit("codecs.quantised:check_end", "if stop % 8 and", "if False and"),
    ),
    mutant(
        "raw-unsigned",
        "Counts of RAWB packets have no sign.",
        "RAW-001 RAW-005",
        Edit(
            "codecs.raw:decode_raw",
            "out >>= 8 * (4 - size)",
            "out = (out.view(np.uint32) >> np.uint32(8 * (4 - size))).astype(np.int32)",
        ),
    ),
    mutant(
        "deflate-end-unchecked",
        "A DEFLATE stream may end before its packet, or not at all.",
        "RAW-003",
        Edit(
            "container.deflate:inflate", "if not unpacker.eof or unpacker.unused_data:", "if False:"
        ),
    ),
    mutant(
        "bit-model-slow",
        "The q of a bit model moves by a 32nd, not by a 16th.",
        "RNG-001",
        Edit(BITS, "(t - q) >> 4", "(t - q) >> 5"),
    ),
    mutant(
        "bit-model-mixed-late",
        "The q of a bit model is mixed in from n = 9 on.",
        "RNG-001",
        Edit("codecs.adaptive:BitModel.probability", "self.n < FAST_FROM", "self.n <= FAST_FROM"),
    ),
    mutant(
        "bit-model-unclamped",
        "The probability of a bit is not clamped to 64 ... 65472.",
        "RNG-001",
        Edit(
            "codecs.adaptive:BitModel.probability",
            "return LEAST if mixed < LEAST else MOST if mixed > MOST else mixed",
            "return max(mixed, 1)",
        ),
    ),
    mutant(
        "models-never-settle",
        "The n of models grows to 255 instead of 250.",
        "RNG-001",
        Rebind("codecs.adaptive:RATES", "tuple(131072 // (2 * n + 3) for n in range(256))", MODELS),
        Rebind("codecs.adaptive:COUNT_LIMIT", "255", MODELS),
    ),
    mutant(
        "models-learn-slowly",
        "R is 131072 // (2n + 4).",
        "RNG-001",
        Rebind("codecs.adaptive:RATES", "tuple(131072 // (2 * n + 4) for n in range(251))", MODELS),
    ),
    mutant(
        "scale-shift",
        "The fast average of the integer model moves by a 16th.",
        "RNG-001",
        Edit(SCALE, "(u - self.f) >> 3", "(u - self.f) >> 4"),
    ),
    mutant(
        "scale-slow-shift",
        "The slow average of the integer model slows down to a 256th.",
        "RNG-001",
        Edit(SCALE, "min(7, (self.t + 1).bit_length())", "min(8, (self.t + 1).bit_length())"),
    ),
    mutant(
        "buckets-off-by-one",
        "The bucket 13 begins at 21.",
        "RNG-001",
        Rebind("codecs.adaptive:EDGES", "EDGES[:13] + (21,) + EDGES[14:]", BUCKETS),
    ),
    mutant(
        "escape-length-limit",
        "Five raw bits follow a length of 14 already.",
        "RNG-001 RNG-003",
        Edit("codecs.adaptive:IntegerModel.decode", "if length == 15:", "if length >= 14:"),
    ),
    mutant(
        "signs-without-context",
        "All signs share one bit model.",
        "RNG-001",
        Edit("codecs.adaptive:IntegerModel.decode", "self.signs[self.g + 1]", "self.signs[1]"),
    ),
    mutant(
        "coder-end-unchecked",
        "What stands behind the last symbol of coded bytes is not looked at.",
        "RNG-001",
        Edit(
            "codecs.adaptive:RangeDecoder.finish", "if not whole or number", "if False and number"
        ),
    ),
    mutant(
        "coder-reads-ones",
        "After the last coded byte the range decoder reads bits that are 1.",
        "RNG-001",
        Edit("codecs.adaptive:RangeDecoder.shift", '.ljust(8, b"\\0")', '.ljust(8, b"\\xff")'),
    ),
    mutant(
        "prediction-truncates",
        "The prediction of LPCR divides by 8192 towards zero.",
        "CNV-001 LPC-005",
        Edit(PREDICT, PREDICTED, TRUNCATED),
    ),
    mutant(
        "prediction-rounds-down",
        "The prediction of LPCR leaves out the 4096.",
        "CNV-001 LPC-005",
        Edit(PREDICT, "+ (1 << (SHIFT - 1))", "+ 0"),
    ),
    mutant(
        "coefficients-truncate",
        "Reflection coefficients become predictors by divisions that truncate.",
        "CNV-001 LPC-005",
        Edit(STEP_UP, "rdiv(k * y, 1 << 15)", "int((2 * k * y + 32768) / 65536)"),
        Edit(STEP_UP, "rdiv(x, 1 << 7)", "int((2 * x + 128) / 256)"),
    ),
    mutant(
        "coefficients-half-even",
        "The last rounding of a predictor coefficient goes to even.",
        "CNV-001 LPC-005",
        Edit(STEP_UP, "rdiv(x, 1 << 7)", "round(x / 128)"),
    ),
    mutant(
        "sine-rounds-down",
        "The sine table is rounded down: about half of its entries are one less.",
        "LPC-005",
        Rebind(
            "codecs.sine:SINES",
            "tuple(int(32768 * __import__('math').sin(__import__('math').pi * k / 256))"
            " for k in range(128))",
            (STEP_UP,),
        ),
    ),
    mutant(
        "sine-entry-off-by-one",
        "One entry of the sine table, that of 126, is off by one.",
        "LPC-005",
        Rebind("codecs.sine:SINES", "SINES[:126] + (SINES[126] + 1,) + SINES[127:]", (STEP_UP,)),
    ),
    mutant(
        "references-unsigned",
        "The weights of references have no sign.",
        "LPC-007",
        Edit("codecs.references:parse_references", "byte - 256 if byte > 127 else byte", "byte"),
    ),
    mutant(
        "references-mirrored",
        "The weights of the ticks before and after are swapped.",
        "LPC-007",
        Edit(TAPS, "around[1 + tap : 1 + tap + d.size]", "around[1 - tap : 1 - tap + d.size]"),
    ),
    mutant(
        "references-from-zero",
        "Of a reference the indices themselves are predicted, not those minus its first.",
        "LPC-007",
        Edit(TAPS, "int(indices[0])", "0"),
    ),
    mutant(
        "references-truncate",
        "What references add is rounded towards zero.",
        "CNV-001 LPC-007",
        Edit(
            CROSS,
            "(total + (1 << (WEIGHT_SHIFT - 1))) >> WEIGHT_SHIFT",
            "np.trunc((total + 32) / 64).astype(np.int64)",
        ),
    ),
    mutant(
        "repeats-context",
        "The models of repeats go by the last bit alone.",
        "LPC-004",
        Edit("codecs.predicted:decode_coded", "2 * same + (recent >> 1)", "2 * same"),
    ),
    mutant(
        "constants-with-flags",
        "A constant component packet may have other flags.",
        "LPC-004",
        Edit(
            "codecs.predicted:parse_header",
            "(constant and (order or flags != CONSTANT))",
            "(constant and order)",
        ),
    ),
    mutant(
        "rice-escape-as-code",
        "The 24 zeros of a Rice code are followed by its low bits like any others.",
        "LPC-012",
        Edit(RICE, "if zeros == ZEROS else", "if zeros > ZEROS else"),
    ),
    mutant(
        "rice-escape-short",
        "Only 34 bits follow the escape of a Rice code.",
        "LPC-012",
        Edit(RICE, "self.bits(RAW_BITS)", "self.bits(RAW_BITS - 1)"),
    ),
    mutant(
        "rice-end-unchecked",
        "What stands behind the last Rice code is not looked at.",
        "LPC-012",
        Edit("codecs.rice:RiceReader.finish", "if -(-self.taken", "if False and -(-self.taken"),
    ),
    mutant(
        "grid-off-by-one",
        "A cell of the deadband grid begins at the top of the one below.",
        "LPC-003",
        Edit(GRID, "c = top + 1", "c = top"),
    ),
    mutant(
        "last-knot-off-by-one",
        "The last knot of a coded line stands at tick span.",
        "KTE-004",
        Edit("codecs.knots_coded:decode_indices", "tick = span - 1", "tick = span"),
    ),
    mutant(
        "knots-line-ends-early",
        "The last knot of a line may stand a tick before the end of its packet.",
        "KNT-003",
        Edit("codecs.knots:check_ticks", "0 < last < span - 1", "0 < last < span - 2"),
    ),
    mutant(
        "knots-without-zero",
        "The grid of knots in varints has no zero and no deadband.",
        "CNV-001",
        Edit("codecs.knots:decode_knots", "grid.counts(indices, bound)", "indices * grid.step"),
    ),
    mutant(
        "flag-5-ignored",
        "Bit 5 of the flags of LPCR may be 1.",
        "LPC-004",
        Edit("codecs.predicted:parse_header", "or flags & UNUSED", "or False"),
    ),
    mutant(
        "hold-a-tick-late",
        "A held count begins a tick after its knot.",
        "KNT-003",
        Edit(
            "codecs.knots:interpolate",
            "np.diff(np.append(ticks, span))",
            "np.diff(np.append(np.minimum(ticks + (ticks > 0), span), span))",
        ),
    ),
    mutant(
        "exact-rounded",
        "The exact values of LPCX are the values of the counts, without corrections.",
        "EXA-006 EXA-007",
        Edit(
            "codecs.exact:decode_moves",
            "return corrections << rest[1]",
            "return 0 * corrections",
        ),
    ),
    mutant(
        "exact-linear-early",
        "Rule 4 of LPCX is used before all lags lie within the packet, with zeros.",
        "EXA-009 EXA-007",
        Edit(
            "codecs.values:linear_values",
            "        if t >= reach:\n",
            "        if True:\n",
        ),
        Edit(
            "codecs.values:linear_values",
            "v += weight * x[t - lag]",
            "v += weight * (x[t - lag] if t >= lag else 0.0)",
        ),
    ),
    mutant(
        "exact-linear-rounded-once",
        "The sum of rule 4 is rounded at the end alone.",
        "EXA-009 EXA-007",
        Edit(
            "codecs.values:linear_values",
            "            v = c0\n"
            "            for x, lag, weight in rows:\n"
            "                v += weight * x[t - lag]",
            "            from fractions import Fraction\n"
            "            row = [(w, x[t - lag]) for x, lag, w in rows]\n"
            "            whole = all(isfinite(x) for _, x in row)\n"
            "            v = sum((Fraction(w) * Fraction(x) for w, x in row), Fraction(c0))"
            " if whole else c0 + float('nan')\n"
            "            v = float(v) if abs(v) < 2**1023 else quotient",
        ),
    ),
    mutant(
        "exact-linear-in-turn",
        "Components of LPCX are decoded in their order, the linear ones too.",
        "EXA-009",
        Edit(
            "codecs.exact:in_order",
            "key=lambda place: parameters[place].rule == LINEAR",
            "key=lambda place: 0",
        ),
    ),
    mutant(
        "exact-rule-1-as-0",
        "Rule 1 of LPCX is worked out like rule 0.",
        "EXA-007",
        Edit(
            "codecs.values:values_of",
            "np.asarray(product + float(b) / float(d))",
            "np.asarray((counts * a + b).astype(np.float64) / float(d))",
        ),
    ),
    mutant(
        "exact-cubic-powers",
        "The polynomial of rule 3 is worked out by powers of the count.",
        "EXA-007",
        Edit(
            "codecs.values:values_of",
            "return np.asarray(v + 0.0)",
            "c0, c1, c2, c3 = coefficients\n"
            "        return np.asarray(c0 + c1 * x + c2 * (x * x) + c3 * (x * x * x) + 0.0)",
        ),
    ),
    mutant(
        "exact-cubic-rounded-once",
        "The polynomial of rule 3 is rounded at the end alone.",
        "EXA-007",
        Edit(
            "codecs.values:values_of",
            "return np.asarray(v + 0.0)",
            "from fractions import Fraction\n"
            "        c0, c1, c2, c3 = map(Fraction, coefficients)\n"
            "        exact = [((c3 * n + c2) * n + c1) * n + c0 for n in counts.tolist()]\n"
            "        return np.array([float(v) for v in exact])",
        ),
    ),
    mutant(
        "exact-recall-kept",
        "A correction coded by its rank stays where it is on its list.",
        "EXA-007",
        Edit(
            "codecs.exact:CorrectionModel.learn",
            "known.insert(0, correction)",
            "known.insert(rank or 0, correction)",
        ),
    ),
    mutant(
        "exact-sign-first",
        "The sign of a correction is read before its low bits.",
        "EXA-007",
        Edit(
            "codecs.exact:decode_loop",
            "magnitude = high << low | coder.raw(low)\n"
            "                c = -magnitude if coder.raw(1) else magnitude",
            "c = coder.raw(1)\n"
            "                magnitude = high << low | coder.raw(low)\n"
            "                c = -magnitude if c else magnitude",
        ),
    ),
)
