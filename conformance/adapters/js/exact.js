// The value v of a count, by the rules of LPCX (9.7).

const RULE_QUOTIENT = 0;
const RULE_PRODUCT = 1;
const RULE_BINARY32 = 2;
const RULE_DECIMALS = 3;
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

function decimal(count, { A, B, D }, rule, digits) {
  const n = BigInt(count) * BigInt(A) + BigInt(B);
  if (n === 0n) return 0;
  const d = BigInt(D);
  let k = digits;
  if (rule !== RULE_DECIMALS) k = Math.min(digits - 1 - decimalExponent(n < 0n ? -n : n, d), POWER_BOUND);
  const s = k >= 0 ? roundHalfEven(n * 10n ** BigInt(k), d) : roundHalfEven(n, d * 10n ** BigInt(-k));
  if (s === 0n) return 0;
  if (s >= 1n << 53n || s <= -(1n << 53n)) return (count * A + B) / D;
  return k >= 0 ? Number(s) / Number(10n ** BigInt(k)) : Number(s) * Number(10n ** BigInt(-k));
}

// A function that gives v for a count of the declared range.
export function valueRule(rule, digits, calibration) {
  const { A, B, D } = calibration;
  const quotient = (count) => (count * A + B) / D;
  switch (rule) {
    case RULE_QUOTIENT: return quotient;
    case RULE_PRODUCT: {
      const a = A / D;
      const b = B / D;
      return (count) => count * a + b;
    }
    case RULE_BINARY32: return (count) => Math.fround(quotient(count));
    default: {
      const known = new Map(); // once for each distinct count of a packet (Annex A)
      return (count) => {
        let v = known.get(count);
        if (v === undefined) known.set(count, (v = decimal(count, calibration, rule, digits)));
        return v;
      };
    }
  }
}
