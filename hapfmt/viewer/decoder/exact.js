// The value v of a count, by the rules of LPCX (9.7).

const RULE_PRODUCT = 1;
const RULE_SIGNIFICANT = 2;
const DECIMALS = 16; // from here on, digits are counted behind the point
const RULE_CUBIC = 3;
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

export function significant(count, { A, B, D }, digits) {
  const n = BigInt(count) * BigInt(A) + BigInt(B);
  if (n === 0n) return 0;
  const d = BigInt(D);
  const k = digits >= DECIMALS ? digits - DECIMALS : Math.min(digits - 1 - decimalExponent(n < 0n ? -n : n, d), POWER_BOUND);
  const s = k >= 0 ? roundHalfEven(n * 10n ** BigInt(k), d) : roundHalfEven(n, d * 10n ** BigInt(-k));
  if (s >= SAFE || -s >= SAFE) return (count * A + B) / D;
  return k >= 0 ? Number(s) / Number(10n ** BigInt(k)) : Number(s) * Number(10n ** BigInt(-k));
}

const EXACT_BOUND = 2 ** 53;
const SAFE = 2n ** 53n;
const SPLITTER = 2 ** 27 + 1;
const CERTAIN = 1 - 2 ** -20;
const TENS = Float64Array.from({ length: POWER_BOUND + 1 }, (_, k) => Number(10n ** BigInt(k)));

// a * b - product, exactly, where product is a * b rounded (Dekker's product).
function rest(a, b, product) {
  const a1 = a * SPLITTER - (a * SPLITTER - a);
  const b1 = b * SPLITTER - (b * SPLITTER - b);
  const a2 = a - a1;
  const b2 = b - b1;
  return a1 * b1 - product + a1 * b2 + a2 * b1 + a2 * b2;
}

// The same by binary64 numbers; NaN where they may not tell.
export function quickSignificant(count, { A, B, D }, digits) {
  const product = count * A;
  const n = Math.abs(product + B);
  if (n === 0 || n >= EXACT_BOUND || Math.abs(product) >= EXACT_BOUND) return NaN;
  const decimals = digits >= DECIMALS;
  const k = decimals ? digits - DECIMALS : digits - 1 - Math.floor(Math.log10(n / D));
  if (!(k >= 0 && k < POWER_BOUND)) return NaN;
  const scale = TENS[k];
  const whole = n * scale;
  const s = Math.round(whole / D);
  // Strictly between both powers of ten: k is the right one.
  if (decimals ? s === 0 || s >= EXACT_BOUND : s <= TENS[digits - 1] || s >= TENS[digits] - 1) return NaN;
  const back = s * D;
  const off = whole - back + (rest(n, scale, whole) - rest(s, D, back)); // n * 10^k - s * D
  if (Math.abs(2 * off) > CERTAIN * D) return NaN;
  return product + B < 0 ? -s / scale : s / scale;
}

// Puts v of each count of the declared range at its place in `values`; placed: null but for rule 2, which takes the
// distinct counts and where each count is among them.
export function fillValues({ rule, digits, coefficients }, calibration, counts, placed, values) {
  const { A, B, D } = calibration;
  const { length } = counts;
  switch (rule) {
    case RULE_PRODUCT: {
      const a = A / D;
      const b = B / D;
      for (let t = 0; t < length; t++) values[t] = counts[t] * a + b;
      break;
    }
    case RULE_SIGNIFICANT: { // once for each distinct count of a packet (Annex A)
      const { distinct, places } = placed;
      const known = new Float64Array(distinct.length);
      for (let i = 0; i < known.length; i++) {
        const v = quickSignificant(distinct[i], calibration, digits);
        known[i] = Number.isNaN(v) ? significant(distinct[i], calibration, digits) : v;
      }
      for (let t = 0; t < length; t++) values[t] = known[places[t]];
      break;
    }
    case RULE_CUBIC: {
      const [c0, c1, c2, c3] = coefficients;
      for (let t = 0; t < length; t++) {
        const count = counts[t];
        values[t] = ((c3 * count + c2) * count + c1) * count + c0 + 0; // + 0: not -0
      }
      break;
    }
    default: // rule 0, and rule 4 where it has no number
      for (let t = 0; t < length; t++) values[t] = (counts[t] * A + B) / D;
  }
}
