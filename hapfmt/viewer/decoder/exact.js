// The value v of a count, by the rules of LPCX (9.7).

const RULE_QUOTIENT = 0;
const RULE_PRODUCT = 1;
const RULE_CUBIC = 3;
const KNOWN_BOUND = 2 ** 20; // of remembered values
const POWER_BOUND = 22; // 10^22 is the last power of ten that is a binary64 number

// n / d rounded to the nearest integer, ties to even, d > 0.
function roundHalfEven(n, d) {
  const magnitude = n < 0n ? -n : n;
  let q = magnitude / d;
  const rest = 2n * (magnitude % d);
  if (rest > d || (rest === d && q & 1n)) q++;
  return n < 0n ? -q : q;
}

// The integer p with 10^p <= n / d < 10^(p + 1).
function decimalExponent(n, d) {
  let p = n.toString().length - d.toString().length;
  const small = p >= 0 ? n < d * 10n ** BigInt(p) : n * 10n ** BigInt(-p) < d;
  if (small) p--;
  return p;
}

function significant(count, { A, B, D }, digits) {
  const n = BigInt(count) * BigInt(A) + BigInt(B);
  if (n === 0n) return 0;
  const d = BigInt(D);
  const k = Math.min(digits - 1 - decimalExponent(n < 0n ? -n : n, d), POWER_BOUND);
  const s = k >= 0 ? roundHalfEven(n * 10n ** BigInt(k), d) : roundHalfEven(n, d * 10n ** BigInt(-k));
  return k >= 0 ? Number(s) / Number(10n ** BigInt(k)) : Number(s) * Number(10n ** BigInt(-k));
}

// A function that gives v for a count of the declared range.
export function valueRule(rule, digits, calibration, coefficients) {
  const { A, B, D } = calibration;
  const quotient = (count) => (count * A + B) / D;
  switch (rule) {
    case RULE_QUOTIENT: return quotient;
    case RULE_PRODUCT: {
      const a = A / D;
      const b = B / D;
      return (count) => count * a + b;
    }
    case RULE_CUBIC: {
      const [c0, c1, c2, c3] = coefficients;
      return (count) => ((c3 * count + c2) * count + c1) * count + c0 + 0; // + 0: not -0
    }
    default: {
      const known = new Map(); // once for each distinct count of a packet (Annex A)
      return (count) => {
        let v = known.get(count);
        if (v !== undefined) return v;
        if (known.size === KNOWN_BOUND) known.clear();
        v = significant(count, calibration, digits);
        known.set(count, v);
        return v;
      };
    }
  }
}
