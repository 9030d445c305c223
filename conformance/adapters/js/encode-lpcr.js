// An encoder of component packets of LPCR (9.5): it tries orders and keeps what is shortest.
import { putSvarint } from '../../../hapfmt/viewer/decoder/bytes.js';
import { EntropyEncoder, probabilityOf, startOf } from './entropy-encoder.js';
import { HapfError } from '../../../hapfmt/viewer/decoder/error.js';
import { predictExact, predictQuick, predictorOf, quickBound } from '../../../hapfmt/viewer/decoder/predictor.js';

const ERROR_BOUND = 2 ** 34;
const ORDERS = [4, 8, 16];

function differences(index, g) {
  let y = Float64Array.from(index, (v) => v - index[0]);
  for (let i = 0; i < g; i++) y = y.map((v, t) => (t === 0 ? v : v - y[t - 1]));
  return y;
}

// Prediction errors of the tick's difference y by the predictor c; null where one cannot be coded.
function errorsOf(y, c) {
  const m = c.length;
  const r = c.slice().reverse();
  const padded = new Float64Array(y.length + m);
  padded.set(y, m);
  const largest = y.reduce((most, v) => Math.max(most, Math.abs(v)), 0);
  const predict = largest < quickBound(c) ? predictQuick : predictExact;
  const e = m === 0 ? y : y.map((v, t) => v - predict(r, m, padded, t));
  return e.some((v) => Math.abs(v) >= ERROR_BOUND) ? null : e;
}

const costOf = (e) => e.reduce((bits, v) => bits + Math.log2(1 + 2 * Math.abs(v)), 0);

// Reflection coefficients of y, as sines of k / 256 of a half turn.
function reflections(y, order) {
  const r = Array.from({ length: order + 1 }, (_, lag) => {
    let sum = 0;
    for (let t = lag; t < y.length; t++) sum += y[t] * y[t - lag];
    return sum;
  });
  const k = [];
  let a = [];
  let error = r[0] * (1 + 1e-9) + 1e-9;
  for (let n = 1; n <= order; n++) {
    let sum = r[n];
    for (let j = 1; j < n; j++) sum -= a[j - 1] * r[n - j];
    const reflection = Math.max(-0.9999, Math.min(0.9999, sum / error));
    k.push(Math.max(-127, Math.min(127, Math.round((Math.asin(reflection) * 256) / Math.PI))));
    a = [...a.map((v, j) => v - reflection * a[n - 2 - j]), reflection];
    error *= 1 - reflection * reflection;
  }
  return k;
}

function candidates(index) {
  const found = [];
  const add = (g, k, y) => {
    let c;
    try {
      c = predictorOf(k);
    } catch (error) {
      if (error instanceof HapfError) return; // too large (LPC-005)
      throw error;
    }
    const e = errorsOf(y, c);
    if (e !== null) found.push({ g, k, e, cost: costOf(e) + 8 * k.length });
  };
  for (let g = 0; g <= 4; g++) {
    const y = differences(index, g);
    add(g, [], y);
    if (g > 1) continue;
    for (const order of ORDERS) if (index.length >= 8 * order) add(g, reflections(y, order), y);
  }
  return found.sort((a, b) => a.cost - b.cost);
}

const BY_BITS = 64;
const WAYS = [0, 4, 7, BY_BITS]; // classes of light tails, of even ones, of heavy ones

function packetOf(index, { g, k, e }, repeats, number) {
  const coder = new EntropyEncoder();
  const same = Array.from(index, (v, t) => (repeats && t > 0 && v === index[t - 1] ? 1 : 0));
  const p = [];
  if (repeats) {
    const counts = [[0, 0], [0, 0], [0, 0], [0, 0]];
    const contexts = same.map((_, t) => (t > 1 ? 2 * same[t - 1] + same[t - 2] : t > 0 ? 2 * same[0] : 0));
    for (let t = 1; t < index.length; t++) counts[contexts[t]][same[t]]++;
    p.push(...counts.map(([zeros, ones]) => probabilityOf(zeros, ones)));
    coder.section();
    for (let t = 1; t < index.length; t++) coder.bit(p[contexts[t]], same[t]);
  }
  const errors = e.filter((_, t) => same[t] === 0);
  const start = startOf(errors);
  if (number === BY_BITS) coder.byBits(errors, true);
  else coder.integers(errors, number, start);
  const bytes = [g | (repeats ? 8 : 0), k.length, ...k.map((v) => v & 255)];
  putSvarint(bytes, index[0]);
  bytes.push(number | (coder.many ? 16 : 0), ...(number === BY_BITS ? [] : [start]), ...p);
  const coded = coder.finish();
  const packet = new Uint8Array(bytes.length + coded.length);
  packet.set(bytes);
  packet.set(coded, bytes.length);
  return packet;
}

// index: integers on the grid, at least one.
export function encodeComponent(index) {
  if (index.every((v) => v === index[0])) {
    const bytes = [16, 0];
    putSvarint(bytes, index[0]);
    return Uint8Array.from(bytes);
  }
  const [best] = candidates(index);
  const repeating = index.filter((v, t) => t > 0 && v === index[t - 1]).length;
  const ways = 4 * repeating < index.length ? [false] : [false, true];
  const packets = ways.flatMap((repeats) => WAYS.map((number) => packetOf(index, best, repeats, number)));
  return packets.reduce((least, packet) => (packet.length < least.length ? packet : least));
}
