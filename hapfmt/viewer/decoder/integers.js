// Integer arithmetic (clause 2). Numbers where Annex A keeps every step below 2^53, BigInt elsewhere.

// 2^k as a table: the operator ** is slow.
export const POWERS = Float64Array.from({ length: 64 }, (_, k) => 2 ** k);

// floor() of a binary64 quotient is the exact floor while |a| is below 2^53: a quotient that is not an integer is at
// least 1 / b away from the next one, more than half a unit in its last place.
export function floorDiv(a, b) {
  return Math.floor(a / b);
}

export function rdiv(n, d) {
  return Math.floor((2 * n + d) / (2 * d));
}

export function floorDivBig(a, b) {
  const q = a / b;
  return a % b !== 0n && (a < 0n) !== (b < 0n) ? q - 1n : q;
}

export function rdivBig(n, d) {
  return floorDivBig(2n * n + d, 2n * d);
}

export function clamp(x, lo, hi) {
  return x < lo ? lo : x > hi ? hi : x;
}

// The number of bits of a Number v, 0 <= v < 2^53.
export function bitLength(v) {
  return v < 4294967296 ? 32 - Math.clz32(v) : 64 - Math.clz32(v / 4294967296);
}
