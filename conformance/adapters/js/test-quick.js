// The quick loops of the decoder against plain ones, on random numbers up to the largest ones of level 2.
import { putSvarint, putVarint } from '../../../hapfmt/viewer/decoder/bytes.js';
import { crc32 } from '../../../hapfmt/viewer/decoder/crc32.js';
import { EntropyDecoder, lengthEnds } from '../../../hapfmt/viewer/decoder/entropy.js';
import { EntropyEncoder, startOf } from './entropy-encoder.js';
import { HapfError } from '../../../hapfmt/viewer/decoder/error.js';
import { quickSignificant, significant } from '../../../hapfmt/viewer/decoder/exact.js';
import { clamp, floorDivBig, rdivBig } from '../../../hapfmt/viewer/decoder/integers.js';
import { decodeIndices } from '../../../hapfmt/viewer/decoder/lpcr.js';
import { movePlace } from '../../../hapfmt/viewer/decoder/lpcx.js';
import {
  isQuick, predictExact, predictQuick, predictorOf, sumFour, tapsOf,
} from '../../../hapfmt/viewer/decoder/predictor.js';

let state = 1;

function next() {
  state = (state + 0x6d2b79f5) | 0;
  let x = Math.imul(state ^ (state >>> 15), state | 1);
  x ^= x + Math.imul(x ^ (x >>> 7), x | 61);
  return (x ^ (x >>> 14)) >>> 0;
}

// A random integer, 0 <= v < n <= 2^35, always the same ones in a run.
const random = (n) => Math.floor(((next() + next() / 2 ** 32) / 2 ** 32) * n);

const signed = (n) => random(2 * n + 1) - n;
const chance = (n) => random(n) === 0;

// Integers of one size, with a few of another.
function integersOf(count, bitsMost) {
  const usual = 2 ** random(bitsMost + 1) - 1;
  const rare = 2 ** random(bitsMost + 1) - 1;
  return Float64Array.from({ length: count }, () => signed(chance(20) ? rare : usual));
}

class Encoder extends EntropyEncoder {
  constructor(states) {
    super();
    this.states = states;
  }

  get many() {
    return this.states === 4;
  }
}

// Every block the general way.
class Plain extends EntropyDecoder {
  quickBlocks(from) {
    return from;
  }
}

function outcome(run) {
  try {
    return run();
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    return error.requirement;
  }
}

const same = (a, b) => String(a) === String(b);

function blocks() {
  const count = random(100);
  const e = integersOf(count, 33);
  const [states, number, start] = [chance(2) ? 1 : 4, random(16), chance(2) ? startOf(e) : random(164)];
  const encoder = new Encoder(states);
  encoder.integers(e, number, start);
  const bytes = encoder.finish();
  const hostile = chance(3);
  for (let i = hostile ? 1 + random(4) : 0; i > 0; i--) bytes[random(bytes.length)] = random(256);
  const [quick, plain] = [EntropyDecoder, Plain].map((Decoder) => {
    const out = new Float64Array(count);
    const end = outcome(() => {
      const coder = new Decoder(bytes, 0, states);
      coder.integers(count, number, start, true, out);
      const after = [...coder.states, coder.front, coder.rawBits];
      coder.finish();
      return after;
    });
    return { end, out };
  });
  return same(quick.end, plain.end) && same(quick.out, plain.out) && (hostile || same(quick.out, e));
}

function bits() {
  const signs = chance(2);
  const e = integersOf(random(100), random(34)).map((v) => (signs ? v : Math.abs(v)));
  const encoder = new EntropyEncoder();
  encoder.byBits(e, signs);
  const bytes = encoder.finish();
  const hostile = chance(3);
  for (let i = hostile ? 1 + random(4) : 0; i > 0; i--) bytes[random(bytes.length)] = random(256);
  const out = new Float64Array(e.length);
  const end = outcome(() => {
    const coder = new EntropyDecoder(bytes, 0, 1);
    coder.byBits(e.length, signs, out);
    coder.finish();
    return 'whole';
  });
  return hostile ? ['whole', 'RNG-001', 'RNG-003'].includes(end) : end === 'whole' && same(out, e);
}

// A packet whose indices are known, coded by sums of BigInt.
function packetOf(rows, { g, k, base, references, repeats, states }) {
  const c = Array.from(predictorOf(k), BigInt);
  const difference = (z) => {
    let y = z.map(BigInt);
    for (let i = 0; i < g; i++) y = y.map((v, t) => (t > 0 ? v - y[t - 1] : v));
    return y;
  };
  const residual = (y) => y.map((v, t) => {
    let sum = 4096n;
    for (let j = 1; j <= c.length && j <= t; j++) sum += c[j - 1] * y[t - j];
    return v - floorDivBig(sum, 8192n);
  });
  const index = rows[rows.length - 1];
  let e = residual(difference(Array.from(index, (v) => v - base)));
  if (references.length > 0) {
    const d = references.map(({ a }) => residual(difference(Array.from(rows[a], (v) => v - rows[a][0]))));
    e = e.map((v, t) => {
      let sum = 0n;
      references.forEach(({ w }, i) => w.forEach((weight, j) => { sum += BigInt(weight) * (d[i][t + j - 1] ?? 0n); }));
      return v - rdivBig(sum, 64n);
    });
  }
  const repeated = Array.from(index, (v, t) => (repeats && t > 0 && v === index[t - 1] ? 1 : 0));
  const errors = Float64Array.from(e.filter((_, t) => repeated[t] === 0), Number);
  if (errors.some((v) => Math.abs(v) >= 2 ** 34)) return null;
  const encoder = new Encoder(states);
  if (repeats) {
    encoder.section();
    for (let t = 1; t < index.length; t++) encoder.bit(100, repeated[t]);
  }
  const start = startOf(errors);
  encoder.integers(errors, 7, start);
  const bytes = [g | (repeats ? 8 : 0) | (references.length > 0 ? 64 : 0), k.length, ...k.map((v) => v & 255)];
  if (references.length > 0) bytes.push(references.length);
  for (const { a, w } of references) bytes.push(a, ...w.map((v) => v & 255));
  putSvarint(bytes, base);
  bytes.push(7 | (states === 4 ? 16 : 0), start, ...(repeats ? [100, 100, 100, 100] : []));
  return [...bytes, ...encoder.finish()];
}

// Predictions of numbers as large as there are, from all coefficients that are allowed.
function predictions() {
  const c = Float64Array.from({ length: 1 + random(32) }, () => signed(2 ** random(22)));
  const g = random(2);
  const highest = 2 ** random(33);
  const width = (c.length + 3) & ~3;
  const y = Float64Array.from({ length: 2 * width }, (_, i) => (i < width ? signed(2 * highest * 2 ** g) : 0));
  // Sums just below a multiple of 8192, or of one: the smallest error shows.
  c[0] = 1;
  y[width - 1] = 0;
  const sumOf = () => c.reduce((total, v, j) => total + BigInt(v) * BigInt(y[width - 1 - j]), 4096n);
  const near = Number(BigInt.asUintN(13, -sumOf())) - random(2);
  y[width - 1] = Math.min(near, 2 * highest * 2 ** g);
  const sum = sumOf();
  const { r } = tapsOf(c);
  const ahead = r.subarray(3);
  const exact = predictExact(ahead, width, y, 0);
  const sums = new Float64Array(4);
  sumFour({ r, width }, y, 0, sums);
  const quick = isQuick(c, g, highest) ? [predictQuick(ahead, width, y, 0), Math.floor(sums[0] / 8192)] : [];
  return [exact, ...quick].every((v) => BigInt(v) === floorDivBig(sum, 8192n));
}

function indices() {
  const highest = 2 ** (chance(3) ? 32 : random(33));
  const span = 1 + random(60);
  const rows = [];
  const parts = [];
  const count = 1 + random(3);
  while (parts.length < count) {
    const component = parts.length;
    const slow = signed(highest);
    const near = Math.min(highest, 2 ** random(20));
    const value = () => (chance(4) ? signed(highest) : clamp(slow + signed(near), -highest, highest));
    const row = Float64Array.from({ length: span }, value);
    // Large numbers and large coefficients that predict them well: the sums of products pass 2^53.
    const smooth = chance(3);
    if (smooth) row.forEach((_, t) => { row[t] = Math.round(highest * (2 * Math.sin(t / 20) ** 6 - 1)); });
    else if (chance(2)) row.fill(chance(2) ? highest : -highest, random(span), random(span));
    const m = smooth ? 10 : chance(4) ? 0 : 1 + random(32);
    const steep = chance(2) ? 8 : 127;
    const k = Array.from({ length: m }, (_, i) => (smooth ? (i % 2 === 0 ? 127 : -127) : signed(steep)));
    const references = [];
    for (let a = 0; a < component; a++) if (chance(2)) references.push({ a, w: [0, 0, 0].map(() => signed(127)) });
    const g = random(m > 0 ? 2 : 5);
    const base = !smooth && chance(3) ? signed(highest) : row[0];
    const form = { g, k, base, references, repeats: chance(3), states: chance(2) ? 1 : 4 };
    const part = outcome(() => packetOf([...rows, row], form));
    if (!Array.isArray(part)) continue; // a predictor that is too large, an error that cannot be coded
    rows.push(row);
    parts.push(part);
  }
  const bytes = [];
  parts.slice(0, -1).forEach((part) => putVarint(bytes, part.length));
  parts.forEach((part) => bytes.push(...part));
  const decode = (bound) => outcome(() => {
    const found = [];
    decodeIndices({ highest: bound }, count, Uint8Array.from(bytes), span, 0, (_, index) => found.push([...index]));
    return found;
  });
  const largest = Math.max(...rows.flatMap((row) => [...row].map(Math.abs)));
  return same(decode(highest), rows.map((row) => [...row])) && (largest === 0 || decode(largest - 1) === 'LPC-003');
}

function corrections() {
  const count = random(50);
  const values = Array.from({ length: count }, () => {
    const bits = random(64);
    let u = bits === 0 ? 0n : 1n;
    for (let i = 1; i < bits; i++) u = 2n * u + BigInt(random(2));
    return u !== 0n && chance(2) ? -u : u;
  });
  const ends = lengthEnds(new Array(64).fill(1));
  const states = chance(2) ? 1 : 4;
  const encoder = new Encoder(states);
  encoder.section();
  for (const value of values) {
    const u = value < 0n ? -value : value;
    const l = u === 0n ? 0 : u.toString(2).length;
    encoder.note(l > 0 ? ends[l - 1] : 0, ends[l] - (l > 0 ? ends[l - 1] : 0));
    for (let i = 0; i < l - 1; i++) encoder.raw(Number((u >> BigInt(i)) & 1n), 1);
    if (l > 0) encoder.raw(value < 0n ? 1 : 0, 1);
  }
  const coder = new EntropyDecoder(encoder.finish(), 0, states);
  const lower = new Int32Array(count);
  const upper = new Int32Array(count);
  coder.wide(count, { first: 0, ends }, lower, upper);
  coder.finish();
  const found = values.map((_, i) => BigInt.asIntN(64, (BigInt(upper[i]) << 32n) + BigInt(lower[i] >>> 0)));
  return same(found, values);
}

// Places as the specification has them.
const placeOf = (b) => (b >= 0n ? b : -1n - (b + 2n ** 63n));

function places() {
  const half = () => (chance(3) ? [0, -1, 2 ** 31, 1][random(4)] | 0 : random(2 ** 32) | 0);
  const [low, high, lower, upper, z] = [half(), half(), half(), half(), random(64)];
  const whole = (l, h) => BigInt.asIntN(64, (BigInt(h) << 32n) + BigInt(l >>> 0));
  const bits = new BigInt64Array([whole(low, high)]);
  const place = BigInt.asIntN(64, placeOf(bits[0]) + (whole(lower, upper) << BigInt(z)));
  movePlace(new Int32Array(bits.buffer), 0, lower, upper, z);
  return bits[0] === placeOf(place);
}

function digits() {
  const number = () => 1 + random(2 ** random(31));
  const A = chance(2) ? number() : -number();
  const calibration = { A, B: chance(2) ? 0 : signed(number()), D: chance(3) ? 10 ** random(10) : number() };
  const most = 1 + random(15);
  const count = signed(2 ** random(22));
  const quick = quickSignificant(count, calibration, most);
  digits.known = (digits.known ?? 0) + (Number.isNaN(quick) ? 0 : 1);
  return Number.isNaN(quick) || Object.is(quick, significant(count, calibration, most));
}

function checksum() {
  const bytes = Uint8Array.from({ length: random(100) }, () => random(256));
  const [start, previous] = [random(bytes.length + 1), random(2 ** 32)];
  let c = ~previous;
  for (const byte of bytes.subarray(start)) {
    c ^= byte;
    for (let i = 0; i < 8; i++) c = c & 1 ? (c >>> 1) ^ 0xedb88320 : c >>> 1;
  }
  return crc32(bytes, start, bytes.length, previous) === ~c >>> 0;
}

// Name -> [cases that agree, cases].
export function compareQuick() {
  const checks = { blocks, bits, predictions, indices, corrections, places, digits, checksum };
  const found = new Map();
  for (const [name, check] of Object.entries(checks)) {
    const cases = 2000;
    let agreed = 0;
    for (let i = 0; i < cases; i++) agreed += check() ? 1 : 0;
    found.set(`quick ${name}`, [agreed, cases]);
  }
  // What the quick function leaves to the plain one is the exception.
  found.set('quick digits, most of them', [Number(digits.known > 1000), 1]);
  return found;
}
