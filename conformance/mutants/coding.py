"""Wrong codecs: tables, models, codes and predictors (SPEC clause 9)."""

from __future__ import annotations

from .mutant import Edit, Rebind, mutant

HUFFMAN = "codecs.quantised:parse_codebook"
SYMBOLS = "codecs.quantised:Alphabet.expand"
CODER = "codecs.entropy:Decoder"
ENDS = "codecs.entropy:ends_of"
AVERAGES = "codecs.entropy:Averages"
MODEL = "codecs.entropy:FlagModel"
MODELS = "codecs.entropy:Models"
LEARN = "codecs.entropy:learn_flag"
STEP_UP = "codecs.predicted:step_up"
PREDICT = "codecs.predicted:predict"
PREDICTED = "(sum(a * b for a, b in zip(c, history, strict=True)) + (1 << (SHIFT - 1))) >> SHIFT"
TRUNCATED = "int((sum(a * b for a, b in zip(c, history, strict=True)) + 4096) / 8192)"
CODING = "codecs.predicted:parse_coding"
CROSS = "codecs.predicted:cross_terms"
TAPS = "codecs.predicted:taps_of"
GRID = "codecs.grids:deadband_levels"
LAPPED = "codecs.transform:inverse"
COEFFICIENTS = "codecs.transform:decode_coefficients"
NEIGHBOURS = "codecs.transform:Neighbours"
STEPS = "codecs.transform:TransformParameters.steps"
NOISE = "codecs.noise:noise"
TEXTURE = "codecs.noise:synthesise"
LATTICE = "codecs.noise:step_lattice"
BUCKETS = (f"{CODER}.magnitude", ENDS)

MUTANTS = (
    mutant(
        "decimals-as-digits",
        "Rule 2 takes a number of decimals for one of significant digits.",
        "EXA-002",
        Edit("codecs.exact:values_of", "if digits >= DECIMALS:", "if digits > 99:"),
    ),
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
        "The nibbles 0, n mean n symbols without a code word.",
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
        Edit("format.deflate:inflate", "if not unpacker.eof or unpacker.unused_data:", "if False:"),
    ),
    mutant(
        "averages-slow",
        "The fast average moves by a quarter, not by a half.",
        "RNG-001",
        Edit(f"{AVERAGES}.learn", "(mean - self.f) // 2", "(mean - self.f) // 4"),
    ),
    mutant(
        "averages-slow-fast",
        "The slow average moves by a quarter.",
        "RNG-001",
        Edit(f"{AVERAGES}.learn", "3 * (mean - self.s) // 16", "(mean - self.s) // 4"),
    ),
    mutant(
        "averages-truncate",
        "What the slow average moves by is rounded towards zero.",
        "RNG-001",
        Edit(f"{AVERAGES}.learn", "3 * (mean - self.s) // 16", "int(3 * (mean - self.s) / 16)"),
    ),
    mutant(
        "averages-start",
        "Averages begin at 32, whatever the start byte.",
        "RNG-004",
        Edit(f"{AVERAGES}.start", "(4 + start % 4) << (start // 4)", "32"),
    ),
    mutant(
        "blocks-of-four",
        "Four integers share a context.",
        "RNG-001",
        Rebind("codecs.entropy:BLOCK", "4", (f"{CODER}.integers",)),
    ),
    mutant(
        "buckets-off-by-one",
        "The bucket 13 begins at 21.",
        "RNG-001",
        Rebind("codecs.entropy:EDGES", "EDGES[:13] + (21,) + EDGES[14:]", BUCKETS),
    ),
    mutant(
        "classes-without-half",
        "No class begins with half a step.",
        "RNG-001",
        Edit(ENDS, "if w == 1 and half else", "if False else"),
    ),
    mutant(
        "classes-with-all-zeros",
        "No class has more zeros than its shape gives.",
        "RNG-001",
        Edit(ENDS, "tail * (64 - zeros) // 64", "tail"),
    ),
    mutant(
        "escape-length-short",
        "The length of an escape has five bits.",
        "RNG-001 RNG-003",
        Edit(f"{CODER}.magnitude", "self.raw(6)", "self.raw(5)"),
    ),
    mutant(
        "signs-without-context",
        "All signs of their own share one probability.",
        "RNG-004",
        Edit(f"{CODER}.signed", "probabilities[last + 1]", "probabilities[1]"),
    ),
    mutant(
        "coder-end-unchecked",
        "What the states are after the last symbol is not looked at.",
        "RNG-001",
        Edit(f"{CODER}.finish", "any(x != LEAST for x in self.states)", "False"),
    ),
    mutant(
        "coder-padding-unchecked",
        "Bits left over behind the last raw bit may be anything.",
        "RNG-001",
        Edit(f"{CODER}.finish", "padding = self.raw(-self.raw_bits % 8)", "padding = 0"),
    ),
    mutant(
        "coder-words-swapped",
        "Words have their lowest byte first.",
        "RNG-001",
        Edit(f"{CODER}._word", '"big"', '"little"'),
    ),
    mutant(
        "sections-go-on",
        "A section does not begin with the first state, but with the next one in turn.",
        "RNG-001",
        Edit(f"{CODER}.section", "self.lane = 0", "pass"),
    ),
    mutant(
        "lengths-without-least",
        "The symbols of lengths have no least share.",
        "RNG-004",
        Edit(
            "codecs.entropy:Lengths.ends",
            "i + 1 + (SCALE - n) * sums // total",
            "max(i + 1, SCALE * sums // total)",
        ),
    ),
    mutant(
        "models-fast-slower",
        "The fast models learn by a 64th at most, not by a 32nd.",
        "RNG-001",
        Rebind("codecs.entropy:FAST", "6", (LEARN,)),
    ),
    mutant(
        "models-slow-slower",
        "The slow models learn by a 256th at most, not by a 128th.",
        "RNG-001",
        Rebind("codecs.entropy:SLOW", "8", (LEARN,)),
    ),
    mutant(
        "models-limits-swapped",
        "The models of both magnitudes before learn slowly, those of the average fast.",
        "RNG-001",
        Edit(LEARN, "(SLOW, FAST)", "(FAST, SLOW)"),
    ),
    mutant(
        "models-learn-all-at-first",
        "What a model learns first is all it knows.",
        "RNG-001",
        Edit(f"{MODEL}.learn", "self.n + 2", "self.n + 1"),
    ),
    mutant(
        "models-reach-65536",
        "A model that learns a 1 moves towards 65536, not 65535.",
        "RNG-001",
        Edit(f"{MODEL}.learn", "65535 - self.p", "65536 - self.p"),
    ),
    mutant(
        "models-begin-even",
        "All models begin with an even chance, those of small integers after large ones too.",
        "RNG-001",
        Edit(f"{MODEL}.of", "cls(8192, 2) if rare else cls()", "cls()"),
    ),
    mutant(
        "models-begin-eager",
        "Models that begin with 8192 have learnt nothing yet: n is 0.",
        "RNG-001",
        Edit(f"{MODEL}.of", "cls(8192, 2)", "cls(8192, 0)"),
    ),
    mutant(
        "models-rounded-each",
        "Of two models each probability is rounded before their mean is taken.",
        "RNG-001",
        Edit(
            "codecs.entropy:flag_width",
            "sum(model.p for model in models) // (16 * len(models))",
            "sum(model.p // 16 for model in models) // len(models)",
        ),
    ),
    mutant(
        "models-context-before-last",
        "The context weighs the magnitude before the last one more than the last.",
        "RNG-001",
        Edit(f"{MODELS}.size", "2 * self.a + self.b", "self.a + 2 * self.b"),
    ),
    mutant(
        "models-context-8-missing",
        "Contexts by the two magnitudes before end with 7.",
        "RNG-001",
        Edit(f"{MODELS}.size", "NEAR - 1", "NEAR - 2"),
    ),
    mutant(
        "models-context-11-missing",
        "Contexts by the average end with 10.",
        "RNG-001",
        Edit(f"{MODELS}.size", "LOUD - 1", "LOUD - 2"),
    ),
    mutant(
        "models-average-truncates",
        "What the average moves by is rounded towards zero.",
        "RNG-001 CNV-001",
        Edit(f"{MODELS}.learn", "(64 * u - self.s) // 8", "int((64 * u - self.s) / 8)"),
    ),
    mutant(
        "models-one-half",
        "The highest bit below the first one has one model for all k.",
        "RNG-001",
        Edit(f"{MODELS}.half", "self.halves[kind]", "self.halves[0]"),
    ),
    mutant(
        "models-signs-forget",
        "After a zero the sign has the context of no sign before it.",
        "RNG-001",
        Edit(
            f"{MODELS}.learn",
            "if number:\n        self.d = 1 + (number < 0)",
            "self.d = 1 + (number < 0) if number else 0",
        ),
    ),
    mutant(
        "by-bits-unbounded",
        "A magnitude by bits may be 2^34.",
        "RNG-003",
        Edit(f"{CODER}.by_bits", "if u >> ERROR_BITS", "if False"),
    ),
    mutant(
        "by-bits-with-start",
        "A start byte follows the coding of sections by bits too.",
        "RNG-004",
        Edit(CODING, "first = 1 if coding == BY_BITS else 2", "first = 2"),
    ),
    mutant(
        "by-bits-and-more",
        "Beside bit 6 of the coding others may be 1.",
        "RNG-004",
        Edit(CODING, "data[0] if data", "(data[0] & BY_BITS or data[0]) if data"),
    ),
    mutant(
        "gaps-with-signs",
        "The gaps of coded knots have signs.",
        "KTE-004",
        Edit("codecs.knots:decode_numbers", "signs=False", "signs=True"),
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
            "codecs.predicted:SINES",
            "tuple(int(32768 * __import__('math').sin(__import__('math').pi * k / 256))"
            " for k in range(128))",
            (STEP_UP,),
        ),
    ),
    mutant(
        "sine-entry-off-by-one",
        "One entry of the sine table, that of 126, is off by one.",
        "LPC-005",
        Rebind(
            "codecs.predicted:SINES", "SINES[:126] + (SINES[126] + 1,) + SINES[127:]", (STEP_UP,)
        ),
    ),
    mutant(
        "references-unsigned",
        "The weights of references have no sign.",
        "LPC-007",
        Edit("codecs.predicted:parse_references", "byte - 256 if byte > 127 else byte", "byte"),
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
        "The probability of a repeat goes by the last bit alone.",
        "LPC-004",
        Edit(f"{CODER}.bits", "2 * found[-1] + (recent >> 1)", "2 * found[-1]"),
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
        "grid-off-by-one",
        "A cell of the deadband grid begins at the top of the one below.",
        "LPC-003",
        Edit(GRID, "c = top + 1", "c = top"),
    ),
    mutant(
        "last-knot-off-by-one",
        "The last knot of a coded line is at tick span.",
        "KTE-004",
        Edit("codecs.knots:decode_indices", "ticks[-1] = span - 1", "ticks[-1] = span"),
    ),
    mutant(
        "knots-line-ends-early",
        "The last knot of a line may be a tick before the end of its packet.",
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
            "return loop(rest, ids, counts.size, at) << rest[1]",
            "return np.zeros(counts.size, np.int64)",
        ),
    ),
    mutant(
        "exact-linear-early",
        "Rule 4 of LPCX is used before all lags lie within the packet, with zeros.",
        "EXA-002 EXA-007",
        Edit(
            "codecs.exact:linear_values",
            "        if t >= reach:\n",
            "        if True:\n",
        ),
        Edit(
            "codecs.exact:linear_values",
            "v += weight * x[t - lag]",
            "v += weight * (x[t - lag] if t >= lag else 0.0)",
        ),
    ),
    mutant(
        "exact-linear-rounded-once",
        "The sum of rule 4 is rounded at the end alone.",
        "EXA-002 EXA-007",
        Edit(
            "codecs.exact:linear_values",
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
        "EXA-002",
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
            "codecs.exact:values_of",
            "np.asarray(product + float(b) / float(d))",
            "np.asarray((counts * a + b).astype(np.float64) / float(d))",
        ),
    ),
    mutant(
        "exact-cubic-powers",
        "The polynomial of rule 3 is worked out by powers of the count.",
        "EXA-007",
        Edit(
            "codecs.exact:values_of",
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
            "codecs.exact:values_of",
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
            "codecs.exact:Lists.learn",
            "first = places.pop(rank)",
            "return",
        ),
    ),
    mutant(
        "exact-sign-first",
        "The sign of a correction is read before its low bits.",
        "EXA-007",
        Edit(
            "codecs.entropy:Decoder.by_length",
            "u = 1 << (length - 1) | self.raw(length - 1) if length else 0\n"
            "    e = -u if u and self.raw(1) else u",
            "negative = length and self.raw(1)\n"
            "    u = 1 << (length - 1) | self.raw(length - 1) if length else 0\n"
            "    e = -u if negative else u",
        ),
    ),
    mutant(
        "transform-state-by-block",
        "The state of the quantisers begins with each block of MDCT anew.",
        "MDC-003 CNV-001",
        Edit(COEFFICIENTS, "a1 = a2 = near.mean[0]", "a1 = a2 = near.mean[0]; state = 0"),
    ),
    mutant(
        "transform-state-by-level",
        "The next state follows from the level of a coefficient, not from its integer.",
        "MDC-003 CNV-001",
        Edit(COEFFICIENTS, "NEXT[state][u & 1]", "NEXT[state][level_of(u, quantiser) & 1]"),
    ),
    mutant(
        "transform-zero-of-quantiser-1",
        "The integer 0 of quantiser 1 is minus one step.",
        "MDC-003 CNV-001",
        Edit(
            "codecs.transform:level_of",
            "max(2 * magnitude - quantiser, 0)",
            "2 * magnitude - quantiser",
        ),
    ),
    mutant(
        "transform-states-swapped",
        "Two entries of the table of states are swapped.",
        "MDC-003 CNV-001",
        Rebind("codecs.transform:NEXT", "NEXT[:6] + ((1, 3), (6, 4))", (COEFFICIENTS,)),
    ),
    mutant(
        "transform-classes-swapped",
        "Quantiser 0 has the class in the upper bits.",
        "RNG-004 RNG-001",
        Edit(COEFFICIENTS, "classes >> 4 * quantiser & 15", "classes >> 4 * (1 - quantiser) & 15"),
    ),
    mutant(
        "transform-neighbours-begin-at-0",
        "Before the first coefficient of a block there are zeros, not its average.",
        "RNG-001 MDC-002",
        Edit(COEFFICIENTS, "a1 = a2 = near.mean[0]", "a1 = a2 = 0"),
    ),
    mutant(
        "transform-neighbours-end-with-0",
        "Behind the last coefficient that is coded there is a zero.",
        "RNG-001 MDC-002",
        Edit(f"{NEIGHBOURS}.around", "p[min(k + 1, last)]", "(p[k + 1] if k < last else 0)"),
    ),
    mutant(
        "transform-averages-truncate",
        "What the average of a coefficient moves by is rounded towards zero.",
        "RNG-001",
        Edit(f"{NEIGHBOURS}.learn", "(p - e) // 4", "int((p - e) / 4)"),
    ),
    mutant(
        "transform-sum-unchecked",
        "The coefficients of a block may be of any size.",
        "MDC-003",
        Edit(COEFFICIENTS, "if total > SUM_LIMIT:", "if False:"),
    ),
    mutant(
        "transform-mirrored",
        "Where two blocks meet, the signs of the window are swapped.",
        "CNV-001",
        Edit(LAPPED, "w * right - z * left", "w * right + z * left"),
        Edit(LAPPED, "w * left + z * right", "w * left - z * right"),
    ),
    mutant(
        "transform-rounds-down",
        "The sums of a block are rounded down.",
        "CNV-001",
        Edit(LAPPED, "v += 1 << (COSINE_BITS - 1)", "v += 0"),
    ),
    mutant(
        "transform-ends-round-down",
        "The first and the last half block are rounded down.",
        "CNV-001",
        Edit(LAPPED, "x = (v + UNIT // 2) // UNIT", "x = v // UNIT"),
    ),
    mutant(
        "transform-rounds-once",
        "The sums of a block are not rounded before blocks are mixed.",
        "CNV-001",
        Edit(
            LAPPED,
            "v = (coefficients @ waves(size)).astype(np.int64)",
            "u = (coefficients @ waves(size)) / 32768\n"
            "    v = (coefficients @ waves(size)).astype(np.int64)",
        ),
        Edit(
            LAPPED,
            "right, left = v[1:, : size // 2], v[:-1, : size // 2 - 1 : -1]",
            "right, left = u[1:, : size // 2], u[:-1, : size // 2 - 1 : -1]",
        ),
        Edit(
            LAPPED,
            "(w * right - z * left + (1 << 22)) >> 23",
            "np.floor((w * right - z * left + (1 << 22)) / (1 << 23))",
        ),
        Edit(
            LAPPED,
            "(w * left + z * right + (1 << 22)) >> 23",
            "np.floor((w * left + z * right + (1 << 22)) / (1 << 23))",
        ),
    ),
    mutant(
        "cosines-round-down",
        "The table of cosines is rounded down.",
        "CNV-001",
        Edit("codecs.transform:cosines", "(1 << COSINE_BITS) + 0.5", "(1 << COSINE_BITS)"),
    ),
    mutant(
        "weights-round-down",
        "The step of a band is rounded down.",
        "MDC-001 CNV-001",
        Edit(STEPS, "rdiv(self.step * weight, WEIGHT_ONE)", "self.step * weight // WEIGHT_ONE"),
    ),
    mutant(
        "weights-may-be-0",
        "The step of a band may be 0.",
        "MDC-001",
        Edit(
            STEPS,
            "max(1, rdiv(self.step * weight, WEIGHT_ONE))",
            "rdiv(self.step * weight, WEIGHT_ONE)",
        ),
    ),
    mutant(
        "noise-off-centre",
        "The sum of the bytes of the noise is not doubled.",
        "CNV-001",
        Edit(NOISE, "2 * ((w >> 8 & 255)", "1 * ((w >> 8 & 255)"),
    ),
    mutant(
        "noise-pulse-too-many",
        "A pulse also comes where the lowest byte is the density.",
        "CNV-001",
        Edit(NOISE, "w & 255 >= density", "w & 255 > density"),
    ),
    mutant(
        "gain-from-silence",
        "The gain of the first interval rises from 0.",
        "CNV-001",
        Edit(TEXTURE, 'array("q"), gains[0]', 'array("q"), 0'),
    ),
    mutant(
        "gain-in-steps",
        "The gain is that of the interval, without a line from the one before.",
        "CNV-001",
        Edit(TEXTURE, "low + ((high - low) * i >> parameters.shift)", "high"),
    ),
    mutant(
        "silence-keeps-the-state",
        "In silence the filter keeps its state.",
        "CNV-001",
        Edit(TEXTURE, "            g = [0] * model.order\n", ""),
    ),
    mutant(
        "silent-block-of-zeros",
        "After a silent block coefficients differ from zeros, not from the last ones.",
        "NOI-006",
        Edit(
            "codecs.noise:read_blocks",
            "        blocks.append(before)",
            "        before = [0] * model.order if quiet else before\n"
            "        blocks.append(before)",
        ),
    ),
    mutant(
        "lattice-rounds-down",
        "The filter divides without rounding.",
        "CNV-001",
        Edit(LATTICE, "rdiv(ks[j] * g[j], 1 << SINE_SHIFT)", "(ks[j] * g[j] >> SINE_SHIFT)"),
    ),
    mutant(
        "lattice-ties",
        "A product is taken off as its negative is added: ties are rounded the other way.",
        "CNV-001",
        Edit(
            LATTICE,
            "g[j] - rdiv(ks[j] * f, 1 << SINE_SHIFT)",
            "g[j] + rdiv(-ks[j] * f, 1 << SINE_SHIFT)",
        ),
    ),
    mutant(
        "lattice-unclamped",
        "The state of the filter is not clamped.",
        "CNV-001",
        Edit("codecs.noise:within", "return clamp(x, -STATE_MOST - 1, STATE_MOST)", "return x"),
    ),
)
